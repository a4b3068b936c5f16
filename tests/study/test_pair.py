"""Coaxial pairs in studies: both methods, balances, sweeps that resume, the search, pictures, and the air's mean."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mufly.errors import InputError, MuflyError
from mufly.rotor import (
    OperatingCondition,
    RotorMeasurements,
    RotorSystem,
    compare_measurements,
    compute_shaft_plane_velocity,
    draw_flow_field,
    draw_pair_spanwise_loads,
    draw_wake,
    draw_wake_convergence,
    load_rotor,
    prepare_blading,
    solve_rotor,
    solve_system,
)
from mufly.rotor.wake import WakeSettings
from mufly.study import (
    PAIR_PARAMETERS,
    StudySetup,
    build_rotor_system,
    optimise_pair,
    parse_pair_limit,
    parse_parameter_settings,
    read_study_results,
    solve_case,
    solve_isolated_rotors,
    sweep_parameters,
    write_study_results,
)

RPM = math.pi / 30.0
PITCH = math.radians(14.0)
COARSE = WakeSettings(chord_deg=15.0, turns=2.0, far_turns=6.0, tolerance=0.01)
AT = {"upper_speed": 6000 * RPM, "lower_speed": 6600 * RPM}


@pytest.fixture(scope="module")
def rotor(thin_plate: str):
    blade = load_rotor("naca0012-r60-c20")
    return blade.model_copy(update={"blade": blade.blade.model_copy(update={"airfoils": (thin_plate,)})})


@pytest.fixture(scope="module")
def pair(rotor) -> StudySetup:
    return StudySetup(
        rotor,
        None,
        {"spacing": 0.02, "pitch": PITCH},
        wake_settings=COARSE,
        station_count=10,
        lower_rotor=rotor,
    )


@pytest.fixture(scope="module")
def wake_point(pair: StudySetup):
    return solve_case(replace(pair, method="wake"), AT)


def test_a_given_point_is_what_the_rotor_room_answers(pair: StudySetup) -> None:
    point = solve_case(pair, AT)
    direct = solve_system(build_rotor_system(pair), OperatingCondition(PITCH, (AT["upper_speed"], AT["lower_speed"])))
    assert point.thrust_N == direct.thrust_N
    assert point.yaw_torque_Nm == direct.yaw_torque_Nm
    assert point.figure_of_merit == pytest.approx(direct.figure_of_merit, rel=1e-12)


def test_torques_cancel_by_speed_and_by_pitch(pair: StudySetup) -> None:
    by_speed = solve_case(pair, {"thrust": 0.5})
    assert by_speed.thrust_N == pytest.approx(0.5, rel=1e-6)
    by_pitch = solve_case(replace(pair, balance_by="lower-pitch"), {"thrust": 0.5, "speed_ratio": 1.0})
    assert by_pitch.thrust_N == pytest.approx(0.5, rel=1e-6)
    assert by_pitch.lower.speed_rad_s == pytest.approx(by_pitch.upper.speed_rad_s, rel=1e-12)
    for point in (by_speed, by_pitch):
        assert abs(point.yaw_torque_Nm) < 1e-6 * point.upper.torque_Nm
    # The lower rotor works in the other's downwash: it has to turn faster, or stand steeper.
    assert by_speed.lower.speed_rad_s > by_speed.upper.speed_rad_s
    assert by_pitch.lower.pitch_rad > PITCH


def test_balance_by_pitch_does_not_care_where_speeds_come_from(pair: StudySetup) -> None:
    system = build_rotor_system(pair)
    slow = solve_system(system, OperatingCondition((PITCH, None), (300.0, 330.0), thrust_N=0.4))
    fast = solve_system(system, OperatingCondition((PITCH, None), (900.0, 990.0), thrust_N=0.4))
    assert fast.lower.pitch_rad == pytest.approx(slow.lower.pitch_rad, rel=1e-5)
    assert fast.upper.speed_rad_s == pytest.approx(slow.upper.speed_rad_s, rel=1e-5)


def test_a_pair_far_apart_is_two_rotors(pair: StudySetup) -> None:
    """The upper rotor then feels nothing; the lower one still stands in its stream."""
    far = replace(pair, fixed_parameters={**pair.fixed_parameters, "spacing": 50.0})
    point = solve_case(far, AT)
    single = solve_isolated_rotors(far, point)
    assert point.upper.thrust_N == pytest.approx(single[0].thrust_N, rel=1e-5)
    assert point.lower.thrust_N < 0.8 * single[1].thrust_N


def test_the_wake_puts_the_loss_on_the_lower_rotor(pair: StudySetup, wake_point) -> None:
    setup = replace(pair, method="wake")
    assert wake_point.converged
    single = solve_isolated_rotors(setup, wake_point)
    assert wake_point.lower.thrust_N < 0.8 * single[1].thrust_N
    assert wake_point.upper.thrust_N > 0.85 * single[0].thrust_N
    assert wake_point.power_W / wake_point.thrust_N > sum(r.power_W for r in single) / sum(r.thrust_N for r in single)


def test_mean_air_is_symmetric_about_the_shaft_and_blows_down(wake_point) -> None:
    x = np.array([-0.04, -0.02, 0.02, 0.04])
    u, v, w = compute_shaft_plane_velocity(wake_point, x, np.array([-0.06, 0.03]), phases=24)
    np.testing.assert_allclose(w, w[:, ::-1], rtol=1e-6)
    np.testing.assert_allclose(u, -u[:, ::-1], rtol=1e-6, atol=1e-9)
    assert (w < 0).all()
    assert (w[0] < w[1]).all()  # faster below
    assert (u[1, 2:] < 0).all()  # towards the shaft above
    assert v.shape == u.shape


def test_pictures_are_drawn(wake_point, tmp_path) -> None:
    s = wake_point
    for k, figure in enumerate(
        (
            draw_wake(s), draw_flow_field(s, points=24, phases=2), draw_flow_field(s, mean=False, points=24),
            draw_pair_spanwise_loads(wake_point.upper, wake_point.lower),
            draw_wake_convergence(s.history, residual=0.05),
        )
    ):  # fmt: skip
        figure.savefig(tmp_path / f"{k}.png", dpi=50)
        assert (tmp_path / f"{k}.png").stat().st_size > 5_000
        assert all(axes.get_xlabel() or axes.get_ylabel() for axes in figure.axes)
    with pytest.raises(InputError, match="points"):
        draw_flow_field(s, points=2)


def test_sweep_of_pairs_has_units_faults_and_resumes(pair: StudySetup, tmp_path) -> None:
    vary = parse_parameter_settings(["spacing=4,20mm", "speed_ratio=0.9,1.1"], PAIR_PARAMETERS)
    setup = replace(pair, fixed_parameters={**pair.fixed_parameters, "upper_speed": 600.0})
    data = sweep_parameters(setup, vary, folder=tmp_path)
    assert data.lower_thrust_N.attrs["units"] == "N"
    assert all("overlap" in str(f) for f in data.fault.values[0])
    assert np.isnan(data.power_W.values[0]).all()
    assert (data.fault.values[1] == "").all()
    np.testing.assert_allclose(data.lower_speed_rad_s.values[1], [540.0, 660.0])
    np.testing.assert_allclose(data.power_W, data.upper_power_W + data.lower_power_W)
    assert data.torque_ratio.values[1, 1] > data.torque_ratio.values[1, 0]
    calls: list[tuple[int, int]] = []
    again = sweep_parameters(setup, vary, folder=tmp_path, progress=lambda a, b: calls.append((a, b)))
    assert calls[0] == (4, 4)
    np.testing.assert_array_equal(again.power_W, data.power_W)
    nc, table = write_study_results(again, tmp_path)
    assert read_study_results(nc).attrs["method"] == "bemt"
    assert table.read_text().startswith("spacing_m,speed_ratio,thrust_N")
    with pytest.raises(InputError, match="another sweep"):
        sweep_parameters(
            replace(setup, fixed_parameters={**setup.fixed_parameters, "upper_speed": 500.0}),
            vary,
            folder=tmp_path,
        )


def test_wakes_in_a_sweep_are_kept_one_by_one_and_failures_are_named(pair: StudySetup, tmp_path) -> None:
    setup = replace(pair, method="wake", fixed_parameters={**pair.fixed_parameters, **AT})
    done: list[int] = []

    class Stopped(Exception):
        pass

    def stop(cases: int, _: int) -> None:
        done.append(cases)
        if cases == 1:
            raise Stopped

    vary = parse_parameter_settings(["spacing=20,25mm"], PAIR_PARAMETERS)
    with pytest.raises(Stopped):
        sweep_parameters(setup, vary, folder=tmp_path, progress=stop)
    done.clear()
    data = sweep_parameters(setup, vary, folder=tmp_path, progress=lambda a, _: done.append(a))
    assert done[0] >= 1  # what was there before the stop is not computed again
    afresh = solve_case(setup, {"spacing": 0.025})
    assert float(data.lower_thrust_N[1]) == pytest.approx(afresh.lower.thrust_N, rel=0.03)
    short = replace(setup, wake_settings=replace(COARSE, iterations=12))
    failed = sweep_parameters(short, parse_parameter_settings(["spacing=20mm"], PAIR_PARAMETERS))
    assert "not converged in 12 iterations" in str(failed.fault.values[0])
    assert np.isnan(failed.thrust_N.values).all()


@pytest.mark.parametrize(
    ("fixed", "key"),
    [
        ({"pitch": 0.2, "upper_speed": 600.0}, "spacing"),
        ({"spacing": 0.02, "upper_speed": 600.0}, "pitch"),
        ({"spacing": 0.02, "pitch": 0.2}, "thrust"),
        ({"spacing": 0.02, "pitch": 0.2, "thrust": 0.4, "lower_speed": 500.0}, "lower_speed"),
        (
            {"spacing": 0.02, "pitch": 0.2, "upper_speed": 600.0, "lower_speed": 500.0, "speed_ratio": 1.0},
            "ratio",
        ),
        ({"spacing": 0.02, "pitch": 0.2, "upper_speed": 600.0, "chord": 0.01}, "chord"),
    ],
)
def test_what_makes_no_sense_is_refused(pair: StudySetup, fixed: dict, key: str) -> None:
    with pytest.raises(InputError, match=key):
        solve_case(replace(pair, fixed_parameters=fixed))


def test_the_search_saves_power_and_keeps_thrust_balance_and_limits(pair: StudySetup) -> None:
    setup = replace(pair, fixed_parameters={"spacing": 0.03, "upper_pitch": PITCH, "lower_pitch": PITCH, "thrust": 0.4})
    free = ["upper_pitch", "lower_pitch", "lower_chord"]
    best = optimise_pair(setup, free, limits=[parse_pair_limit("lower_chord<=18mm")], generations=4)
    assert best.optimum_solution.power_W < best.before_at_best_pitch.power_W * (1 + 1e-3)
    assert best.before_at_best_pitch.power_W < best.initial_solution.power_W
    for point in (best.initial_solution, best.before_at_best_pitch, best.optimum_solution):
        assert point.thrust_N == pytest.approx(0.4, rel=1e-6)
        assert abs(point.yaw_torque_Nm) < 1e-6 * point.upper.torque_Nm
    assert best.changes["lower_chord"] <= 0.018 + 1e-12
    again = solve_case(
        replace(
            setup,
            rotor=best.upper,
            lower_rotor=best.lower,
            fixed_parameters={
                **setup.fixed_parameters,
                "upper_pitch": best.pitch_rad[0],
                "lower_pitch": best.pitch_rad[1],
            },
        )
    )
    assert again.power_W == pytest.approx(
        best.optimum_solution.power_W, rel=1e-9
    )  # the rotors returned are those computed
    with pytest.raises(InputError, match="radius"):
        optimise_pair(setup, ["upper_radius"])
    with pytest.raises(InputError, match="limit"):
        parse_pair_limit("lower_chord=3")


def test_single_rotors_by_the_wake_agree_with_asking_for_one(rotor) -> None:
    blading = prepare_blading(rotor, stations=10)
    at = OperatingCondition(PITCH, thrust_N=0.25)
    found = solve_system(RotorSystem.from_single_rotor(blading), at, "wake", settings=COARSE)
    assert found.rotors[0].thrust_N == pytest.approx(0.25, rel=0.0101)
    setup = StudySetup(rotor, None, {"thrust": 0.25}, method="wake", wake_settings=COARSE, station_count=10)
    data = sweep_parameters(setup, {"pitch": [PITCH]})
    assert str(data.fault.values[0]) == ""
    assert float(data.thrust_N[0]) == pytest.approx(0.25, rel=0.0101)
    assert float(data.speed_rad_s[0]) == pytest.approx(found.rotors[0].speed_rad_s, rel=0.02)
    bemt = solve_rotor(blading, pitch_rad=PITCH, speed_rad_s=float(data.speed_rad_s[0]))
    assert float(data.thrust_N[0]) == pytest.approx(bemt.thrust_N, rel=0.25)
    r = found.rotors[0]
    bench = RotorMeasurements(
        np.array([PITCH]), np.array([r.speed_rad_s]), np.array([0.25]), np.array([r.torque_Nm]), "bench"
    )
    beside = compare_measurements(blading, bench, method="wake", settings=COARSE)
    assert beside.prediction_faults == ("",)
    assert abs(beside.thrust_error[0]) < 0.03
    beside = compare_measurements(blading, bench, method="wake", settings=replace(COARSE, iterations=5))
    assert "not converged" in beside.prediction_faults[0]
    assert math.isnan(beside.mean_thrust_error)


def test_a_thrust_out_of_reach_is_named(rotor) -> None:
    with pytest.raises(MuflyError, match="out of reach"):
        solve_system(
            RotorSystem.from_single_rotor(prepare_blading(rotor, stations=10)),
            OperatingCondition(PITCH, thrust_N=1e4),
            "wake",
            settings=COARSE,
        )


def test_the_wake_finds_the_lower_pitch_that_balances(pair: StudySetup) -> None:
    setup = replace(pair, method="wake", balance_by="lower-pitch")
    point = solve_case(setup, {"upper_speed": 600.0, "speed_ratio": 1.0})
    assert point.lower.torque_Nm == pytest.approx(point.upper.torque_Nm, rel=0.0101)
    assert PITCH < point.lower.pitch_rad < PITCH + math.radians(5.0)
    assert point.lower.speed_rad_s == point.upper.speed_rad_s == 600.0
