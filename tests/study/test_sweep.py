"""Sweeps: physics of their answers, marked faults, resuming, files, other people's executors."""

import importlib
import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from mufly.drive import find_operating_point, load_drive, make_blade_load
from mufly.errors import InputError, MuflyError
from mufly.rotor import prepare_blading
from mufly.study import (
    BEMT_MODELS,
    StudySetup,
    evaluate_cases,
    read_study_results,
    sweep_parameters,
    write_study_results,
)

MODULE = importlib.import_module("mufly.study.sweeps")
PITCH = [float(p) for p in np.radians([8, 12, 16])]


def test_every_combination_is_there_with_units(setup: StudySetup) -> None:
    data = sweep_parameters(setup, {"chord": [0.015, 0.02], "pitch": PITCH}, chunk=4)
    assert dict(data.sizes) == {"chord": 2, "pitch": 3}
    assert data.chord.attrs["units"] == "m"
    assert data.thrust_per_power_N_W.attrs["units"] == "N/W"
    assert (data.fault == "").all()
    np.testing.assert_allclose(data.thrust_N, 0.4, rtol=1e-9)
    np.testing.assert_allclose(data.power_W, data.torque_Nm * data.speed_rad_s)
    np.testing.assert_allclose(data.efficiency, data.power_W / data.electrical_power_W)
    np.testing.assert_allclose(data.duty, 1.0, rtol=1e-9)


def test_adapted_gear_is_the_operating_point_at_full_duty(setup: StudySetup, thin_plate: str) -> None:
    data = sweep_parameters(setup, {"pitch": PITCH})
    blade = setup.rotor.blade.model_copy(update={"airfoils": (thin_plate,)})
    blading = prepare_blading(setup.rotor.model_copy(update={"blade": blade}))
    for k, pitch in enumerate(PITCH):
        point = find_operating_point(
            load_drive("mufly"),
            make_blade_load(blading, pitch_rad=pitch),
            duty=1.0,
            gear_ratio=float(data.gear_ratio[k]),
        )
        assert float(point.thrust_N) == pytest.approx(0.4, rel=1e-6)
        assert float(point.input_power_W) == pytest.approx(float(data.electrical_power_W[k]), rel=1e-6)


def test_best_gear_is_never_worse_than_the_adapted_one(setup: StudySetup) -> None:
    best = replace(setup, fixed_parameters={**setup.fixed_parameters, "gear": "best"})
    adapted, free = (sweep_parameters(s, {"pitch": PITCH}).electrical_power_W.values for s in (setup, best))
    assert np.all(free <= adapted * (1 + 1e-12))


def test_thrust_speed_and_duty_describe_the_same_point(setup: StudySetup, thin_plate: str) -> None:
    plain = {"airfoil": thin_plate, "gear": 1.2}
    by_thrust = sweep_parameters(replace(setup, fixed_parameters={**plain, "thrust": 0.3}), {"pitch": PITCH})
    for k, pitch in enumerate(PITCH):
        by_speed = replace(setup, fixed_parameters={**plain, "speed": float(by_thrust.speed_rad_s[k])})
        by_duty = replace(setup, fixed_parameters={**plain, "duty": float(by_thrust.duty[k])})
        for other in (by_speed, by_duty):
            one = sweep_parameters(other, {"pitch": [pitch]})
            assert float(one.thrust_N[0]) == pytest.approx(0.3, rel=1e-8)
            assert float(one.electrical_power_W[0]) == pytest.approx(float(by_thrust.electrical_power_W[k]), rel=1e-7)


def test_grouping_changes_nothing(setup: StudySetup) -> None:
    vary = {"radius": [0.05, 0.07], "pitch": PITCH}
    assert sweep_parameters(setup, vary, chunk=1, workers=1).identical(sweep_parameters(setup, vary, chunk=100))


def test_denser_air_needs_less_speed(setup: StudySetup) -> None:
    data = sweep_parameters(setup, {"density": [0.9, 1.2], "pitch": PITCH[:1]})
    # Thrust at constant coefficients: rho Omega^2. The table knows no Reynolds number.
    ratio = float(data.speed_rad_s[0, 0] / data.speed_rad_s[1, 0])
    assert ratio == pytest.approx(np.sqrt(1.2 / 0.9), rel=1e-3)
    assert ratio < np.sqrt(1.2 / 0.9)  # what turns faster, at Mach 0.12, lifts a little more: compressibility


def test_bad_cases_are_marked_and_the_rest_goes_on(setup: StudySetup, thin_plate: str) -> None:
    free = replace(setup, fixed_parameters={"gear": "adapted"})
    data = sweep_parameters(
        free,
        {"airfoil": [thin_plate, "no such airfoil"], "thrust": [0.4, 5.0, 1e4], "pitch": [PITCH[0], -0.3]},
    )
    one = data.sel(airfoil=thin_plate)
    assert str(one.fault[0, 0].item()) == ""
    assert np.isfinite(one.thrust_per_power_N_W[0, 0])
    assert "the motor cannot deliver the" in str(one.fault[1, 0].item())
    assert "out of reach" in str(one.fault[2, 0].item())
    assert "out of reach" in str(one.fault[0, 1].item())  # negative pitch pushes down
    assert all("no such airfoil" in str(x) for x in data.fault.values[1].ravel())
    for name in data.data_vars:
        if name != "fault":
            assert np.isnan(data[name].values[data.fault.values != ""]).all()


def test_impossible_geometry_is_marked(setup: StudySetup) -> None:
    data = sweep_parameters(setup, {"hub_cutout": [0.15, 0.95], "blades": [2.0, 30.0], "pitch": PITCH[:1]})
    assert str(data.fault[0, 0, 0].item()) == ""
    assert "leaves no blade" in str(data.fault[1, 0, 0].item())
    assert "blades" in str(data.fault[0, 1, 0].item())


def test_too_slow_a_motor_says_what_it_needs(setup: StudySetup, thin_plate: str) -> None:
    data = sweep_parameters(
        replace(setup, fixed_parameters={"airfoil": thin_plate, "thrust": 0.4, "gear": 6.0}),
        {"pitch": PITCH[:1]},
    )
    assert "V, the supply gives 7.2 V" in str(data.fault[0].item())


def test_resumes_after_a_stop(setup: StudySetup, tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    vary = {"radius": [0.05, 0.06, 0.07, 0.08], "pitch": PITCH}
    whole = sweep_parameters(setup, vary, chunk=3)

    class Stop(Exception):
        pass

    def stopping(done: int, total: int) -> None:
        if done >= 6:
            raise Stop

    with pytest.raises(Stop):
        sweep_parameters(setup, vary, chunk=3, workers=1, folder=tmp_path, progress=stopping)
    kept = len(list((tmp_path / "chunks").glob("*.npz")))
    assert 2 <= kept < 4
    calls = []
    original = MODULE.evaluate_cases
    monkeypatch.setattr(MODULE, "evaluate_cases", lambda s, c: calls.append(len(c)) or original(s, c))
    seen = []
    again = sweep_parameters(setup, vary, chunk=3, folder=tmp_path, progress=lambda d, t: seen.append((d, t)))
    assert again.identical(whole)
    assert len(calls) == 4 - kept
    assert seen[0] == (3 * kept, 12)
    assert seen[-1] == (12, 12)


def test_broken_chunk_is_computed_again(setup: StudySetup, tmp_path) -> None:
    vary = {"pitch": PITCH}
    whole = sweep_parameters(setup, vary, chunk=2, folder=tmp_path)
    next((tmp_path / "chunks").glob("*.npz")).write_bytes(b"cut off")
    assert sweep_parameters(setup, vary, chunk=2, folder=tmp_path).identical(whole)


def test_folder_of_another_sweep_is_refused(setup: StudySetup, tmp_path) -> None:
    sweep_parameters(setup, {"pitch": PITCH}, folder=tmp_path)
    with pytest.raises(InputError, match="another sweep"):
        sweep_parameters(setup, {"pitch": PITCH[:2]}, folder=tmp_path)
    with pytest.raises(InputError, match="another sweep"):
        sweep_parameters(replace(setup, corrections=BEMT_MODELS["plain"]), {"pitch": PITCH}, folder=tmp_path)


def test_files_give_back_the_results(setup: StudySetup, tmp_path) -> None:
    data = sweep_parameters(setup, {"airfoil": [setup.fixed_parameters["airfoil"], "nonsense"], "pitch": PITCH})
    nc, table = write_study_results(data, tmp_path)
    read = read_study_results(nc)
    for name in data.data_vars:
        np.testing.assert_array_equal(read[name].values, data[name].values)
    assert json.loads(read.attrs["fixed"]) == dict(setup.fixed_parameters)
    lines = table.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("airfoil,pitch_rad,thrust_N,")
    assert len(lines) == 1 + 6
    with pytest.raises(InputError, match="not a result file"):
        read_study_results(table)


@pytest.mark.parametrize(
    ("fixed", "vary", "message"),
    [
        ({"thrust": 0.4}, {"chord": [0.02]}, "pitch: is missing"),
        ({}, {"pitch": [0.1]}, "no operating point"),
        ({"thrust": 0.4, "speed": 500.0}, {"pitch": [0.1]}, "speed and thrust given"),
        ({"thrust": 0.4}, {"pitch": []}, "has no value"),
        ({"thrust": 0.4}, {"pitch": [0.1, 0.1]}, "twice"),
        ({"thrust": 0.4}, {"pitch": [0.1], "colour": [1.0]}, "colour: cannot be varied"),
        ({"speed": 500.0, "gear": "adapted"}, {"pitch": [0.1]}, "only be found for a thrust"),
    ],
)
def test_what_makes_no_sense_is_refused(setup: StudySetup, fixed, vary, message) -> None:
    with pytest.raises(InputError, match=message):
        sweep_parameters(replace(setup, fixed_parameters=fixed), vary)


def test_drive_parameters_need_a_drive(setup: StudySetup) -> None:
    bare = replace(setup, drive=None, fixed_parameters={"thrust": 0.4})
    with pytest.raises(InputError, match="needs a drive"):
        sweep_parameters(bare, {"pitch": PITCH, "gear": [1.0, 2.0]})
    assert "electrical_power_W" not in sweep_parameters(
        bare, {"pitch": PITCH[:1], "airfoil": [setup.fixed_parameters["airfoil"]]}
    )


def test_drive_parameters_change_the_drive_only(setup: StudySetup, thin_plate: str) -> None:
    plain = replace(setup, fixed_parameters={"airfoil": thin_plate, "speed": 600.0})
    data = sweep_parameters(plain, {"resistance": [0.5, 1.5], "gear": [1.0, 2.0], "pitch": PITCH[:1]})
    assert np.ptp(data.thrust_N.values) == 0.0
    assert np.all(data.electrical_power_W.values[0] < data.electrical_power_W.values[1])


def test_unreachable_cluster_is_said(setup: StudySetup, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MODULE, "_SCHEDULER_TIMEOUT", "1s")
    pytest.importorskip("distributed", reason="dask.distributed, an extra, is not installed")
    with pytest.raises(MuflyError, match="no scheduler answers"):
        sweep_parameters(setup, {"pitch": PITCH}, cluster="tcp://127.0.0.1:1")


def test_cluster_gives_the_same_answers(setup: StudySetup) -> None:
    distributed = pytest.importorskip("distributed", reason="dask.distributed, an extra, is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        vary = {"radius": [0.05, 0.06], "pitch": PITCH}
        there = sweep_parameters(setup, vary, chunk=2, cluster=cluster.scheduler_address)
    assert there.identical(sweep_parameters(setup, vary, chunk=2))


def test_evaluate_answers_in_the_order_asked(setup: StudySetup) -> None:
    cases = [{"pitch": p, "radius": r} for p, r in itertools.product(PITCH, (0.07, 0.05))]
    forward = evaluate_cases(setup, cases).values["speed_rad_s"]
    np.testing.assert_array_equal(evaluate_cases(setup, cases[::-1]).values["speed_rad_s"][::-1], forward)
