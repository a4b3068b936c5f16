"""A series on a simulated bench: order, record, resuming, limits, stopping, intervals, and reasons to refuse it."""

import json

import numpy as np
import pytest

from mufly.bench import read_bench_file, read_measurements
from mufly.bench.rig.bench_devices import DeviceError
from mufly.bench.rig.simulated_rig import BenchImperfections, SimulatedFaults, SimulatedRig
from mufly.bench.series.live_page import write_live_page
from mufly.bench.series.series_analysis import analyse_series
from mufly.bench.series.series_files import compare_series, compare_with_theory, write_series_results
from mufly.bench.series.series_plan import BenchLimits, SeriesPlan, StepDurations, make_series_plan, read_series_plan
from mufly.bench.series.series_record import SeriesRecord, read_record, read_valid_lines
from mufly.bench.series.series_runner import LimitError, StopRequested, run_series
from mufly.errors import InputError
from mufly.files.input_files import validate_model
from mufly.quantities.units import RPM

NACA = "naca0012-r60-c20"
TIMES = StepDurations(warm_up_s=120.0, average_s=3.0, longest_s=6.0, tare_s=3.0)


def plan(axis="upper", **more):
    given = {"repetitions": 2, "reference_every": 2, "times": TIMES, "axis": axis} | more
    return make_series_plan(
        "trial", [NACA], [12], [3000, 4000, 5500, 7000], reference=NACA, reference_pitch_deg=10, **given
    )


def truth_of(made, rig):
    def truth(step):
        speeds = {a: rig.speed[a] for a in made.mounting[step.mounting_index].driven_rotors}
        return rig.true_loads(speeds) | {f"nominal_{k}": v for k, v in rig.true_loads(speeds, as_mounted=False).items()}

    return truth


def measured(made, rig=None, record=None, **more):
    rig = rig or SimulatedRig(3)
    return run_series(made, rig, record or SeriesRecord(), truth=truth_of(made, rig), **more)


@pytest.fixture(scope="module")
def single():
    return measured(plan())


@pytest.fixture(scope="module")
def pair():
    return measured(plan("pair", reference_every=1))


def test_a_plan_measures_everything_once_in_random_order_between_references():
    made = make_series_plan(
        "p", [NACA, "naca4412-r60-c20"], [10, 12, 14], [3000, 4000, 5000, 6000, 7000], reference=NACA,
        reference_pitch_deg=12, repetitions=2, reference_every=4,
    )  # fmt: skip
    use = [m.use for m in made.mounting]
    assert (use[0], use[-1]) == ("reference", "reference")
    assert use.count("reference") == 4
    settings = [(m.rotor, m.pitch_deg, m.repetition) for m in made.mounting if m.use == "measure"]
    assert len(settings) == len(set(settings)) == 12
    assert settings != sorted(settings)
    assert all(sorted(m.speeds_rpm) == [3000, 4000, 5000, 6000, 7000] for m in made.mounting)
    kinds = [s.kind for s in made.steps]
    assert kinds[:2] == ["warm-up", "tare"]
    assert kinds[-1] == "tare"
    assert kinds.count("point") == made.point_count == 80


def test_a_plan_is_a_file_that_says_what_is_wrong_with_it(tmp_path):
    made = plan("pair")
    file = tmp_path / "plan.toml"
    file.write_text(made.to_toml(), encoding="utf-8")
    assert read_series_plan(file) == made
    assert read_series_plan(file).compute_plan_hash() == made.compute_plan_hash()
    tables = made.model_dump()
    tables["limits"]["speed_rpm"] = 5000.0
    with pytest.raises(InputError, match=r"mounting\[1\].speeds_rpm.*beyond the limit"):
        validate_model(SeriesPlan, tables, "plan.toml")
    with pytest.raises(InputError, match="no such plan"):
        read_series_plan(tmp_path / "none.toml")


def test_intervals_hold_the_truth_and_are_worth_something(single, pair):
    for record, widest in ((single, 0.05), (pair, 0.08)):
        series = analyse_series(record)
        assert not series.fatal_issues
        held, width = [], []
        for p in series.points:
            for q in ("thrust", "torque_upper", "torque_lower"):
                if (load := getattr(p, q)) is not None:
                    held.append(abs(load.value - p.truth[q]) <= load.expanded)
                    width.append(load.expanded / p.truth[q])
        assert np.mean(held) > 0.85
        assert np.median(width) < widest


def test_an_ideal_bench_gives_the_truth():
    made = plan(repetitions=1)
    rig = SimulatedRig(5, imperfections=BenchImperfections.ideal_bench())
    for p in analyse_series(measured(made, rig)).points:
        assert p.thrust.value == pytest.approx(p.truth["thrust"], rel=2e-3)
        assert p.torque_upper.value == pytest.approx(p.truth["torque_upper"], rel=5e-3)


def test_torques_of_a_pair_add_up_to_what_the_cell_reads(pair):
    series = analyse_series(pair)
    for s in series.settings:
        true = s.truth["nominal_torque_upper"], s.truth["nominal_torque_lower"]
        assert s.torque_upper.value == pytest.approx(true[0], rel=0.05)
        assert s.torque_lower.value == pytest.approx(true[1], rel=0.07)
    assert any("torque constant" in n for n in series.notes)


def test_without_a_torque_cell_the_reference_tells_the_torque(single):
    """The dissertation's way: currents, mapped with blades that are known."""
    made, record = plan(), SeriesRecord()
    for line in single.lines:
        copy = json.loads(json.dumps(line))
        if copy["kind"] == "reading":
            copy["channels"].pop("torque_raw")
        if copy["kind"] == "head":
            cells = copy["facts"]["calibration"]
            cells["channels"], cells["offset"] = ["thrust"], cells["offset"][:1]
            cells["sensitivity"], cells["applied"] = [[cells["sensitivity"][0][0]]], cells["applied"][:1]
            cells["covariance"] = [row[:2] for row in cells["covariance"][:2]]
        record.append_line(copy)
    rig = SimulatedRig(3)
    rig.record_mounting(made.mounting[0])
    speeds = np.linspace(2500, 7500, 11) * RPM
    known = [rig.find_loads_at_map_density({"upper": np.array(w), "lower": np.array(0.0)})[1]["upper"] for w in speeds]
    from mufly.rotor import RotorMeasurements

    torque = RotorMeasurements(0 * speeds, speeds, 0 * speeds, np.array(known, dtype=float), "known")
    series = analyse_series(record, known=torque)
    for s in series.settings:
        assert abs(s.torque_upper.value - s.truth["nominal_torque_upper"]) < 1.5 * s.torque_upper.expanded
        assert s.torque_upper.expanded < 0.12 * s.torque_upper.value
    assert analyse_series(record).settings[0].single_rotor_torque is None


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (SimulatedFaults(reference_moved_deg=0.5, reference_moved_after=1), "reference"),
        (SimulatedFaults(force_cell_saturates=True), "saturated"),
        (SimulatedFaults(spike_share=0.05), "nonsense"),
        (SimulatedFaults(speed_shortfall_fraction=0.04), "speed"),
    ],
)
def test_a_series_that_cannot_be_trusted_is_refused(fault, kind):
    made = plan(repetitions=1, limits=BenchLimits(current_A=9, thrust_N=50, torque_Nm=1))
    record = measured(made, SimulatedRig(1, faults=fault))
    if kind in ("speed", "nonsense"):
        with pytest.raises(InputError, match="contains no usable point"):
            analyse_series(record)
        return
    assert kind in {d.kind for d in analyse_series(record).fatal_issues}
    if kind == "reference":
        assert not analyse_series(record, accept=["reference"]).fatal_issues


def test_zero_that_jumps_and_thrust_of_the_wrong_sign_are_seen(single):
    for change, kind in ((lambda c, k: c + (0.2 if k > 12 else 0.0), "zero"), (lambda c, k: -c, "polarity")):
        record = SeriesRecord()
        for k, line in enumerate(single.lines):
            copy = json.loads(json.dumps(line))
            if copy["kind"] == "reading":
                mean = copy["channels"]["thrust_raw"]
                mean[0] = change(mean[0], k)
            record.append_line(copy)
        assert kind in {d.kind for d in analyse_series(record).fatal_issues}


def test_a_point_that_does_not_lie_with_the_others_is_named(single):
    record = SeriesRecord()
    for line in single.lines:
        copy = json.loads(json.dumps(line))
        if copy["kind"] == "reading" and (copy["mounting"], copy["speed_rpm"]) == (1, 5500):
            copy["channels"]["thrust_raw"][0] += 0.025
        record.append_line(copy)
    found = [d for d in analyse_series(record).doubts if d.kind == "outlier"]
    assert len(found) == 1
    assert "at 5500 rpm is +" in found[0].text
    assert not any(d.kind == "outlier" for d in analyse_series(single).doubts)


@pytest.mark.parametrize("kept", [3, 9, 15])
def test_a_kill_at_any_moment_loses_at_most_the_point_that_was_measured(tmp_path, single, kept):
    """The file ends in the middle of a line, wherever it does; the series goes on, and nothing is measured twice."""
    made, path = plan(), tmp_path / "raw.jsonl"
    record = SeriesRecord(tmp_path)
    for line in single.lines[:kept]:
        record.append_line(line)
    record.close()
    whole = path.read_bytes()
    path.write_bytes(whole[: -len(whole.splitlines()[-1]) // 2])
    again = SeriesRecord(tmp_path)
    assert len(again.lines) == kept - 1
    before = again.completed_steps
    with pytest.raises(StopRequested):
        measured(
            made,
            record=again,
            rig=SimulatedRig(3, time_s=3600.0),
            asked=lambda: len(again.readings) > kept + 4,
        )
    again.close()
    lines, broken = read_valid_lines(path)
    done = [(x["mounting"], x["step"]) for x in lines if x["kind"] == "reading" and x["step"] >= 0]
    assert broken == 1
    assert len(done) == len(set(done))
    assert before <= set(done) | {(0, 0)}
    other = read_record(tmp_path)
    with pytest.raises(InputError, match="not the plan of this record"):
        run_series(plan(seed=9), SimulatedRig(3), other)
    with pytest.raises(InputError, match="calibration: differs from the bench on which this series began"):
        run_series(made, SimulatedRig(4, time_s=3600.0), other)


class Watched(SimulatedRig):
    """Counts what it is told."""

    def __post_init__(self):
        super().__post_init__()
        self.stops = 0

    def stop(self):
        self.stops += 1
        super().stop()


@pytest.mark.parametrize(
    ("limits", "word"),
    [
        ({"current_A": 0.05}, "current_upper"), ({"thrust_N": 0.05}, "thrust"), ({"torque_Nm": 1e-4}, "torque"),
        ({"vibration_m_s2": 1.0}, "vibration"), ({"motor_temperature_degC": 21.0}, "motor_temperature"),
    ],
)  # fmt: skip
def test_a_limit_stops_the_bench(limits, word):
    rig = Watched(0)
    with pytest.raises(LimitError, match=word):
        measured(plan(limits=BenchLimits(**limits)), rig)
    assert rig.stops
    assert not any(rig.commanded_speed.values())


def test_a_request_and_a_fault_of_the_program_stop_the_bench():
    for error, act in ((StopRequested, {"asked": lambda: True}), (ZeroDivisionError, {"told": lambda p: 1 / 0})):
        rig = Watched(0)
        with pytest.raises(error):
            measured(plan(), rig, **act)
        assert rig.stops
        assert not any(rig.commanded_speed.values())


def test_a_device_that_fails_for_a_while_costs_no_point_and_a_dead_one_ends_the_series():
    class Flaky(Watched):
        failures = 0

        def collect_samples(self, duration_s, watch):
            if self.time_s > 500.0 and self.failures < 2:
                self.failures += 1
                raise DeviceError("cells: silent for 0.5 s")
            return super().collect_samples(duration_s, watch)

    rig = Flaky(2)
    series = analyse_series(measured(plan(repetitions=1), rig))
    assert not series.fatal_issues
    assert [d.kind for d in series.doubts] == ["interrupted"] * 2
    assert rig.open_count == 3
    dead, record = Watched(2, faults=SimulatedFaults(silent_from_s=600.0)), SeriesRecord()
    with pytest.raises(DeviceError, match="does not answer"):
        measured(plan(), dead, record)
    assert dead.stops
    assert record.readings


def test_results_are_files_that_the_fits_read(tmp_path, single, pair):
    files = {f.name for f in write_series_results(analyse_series(single), tmp_path)}
    assert files == {f"{NACA}-upper.csv", f"{NACA}-upper-points.csv", "motor-upper.csv", "summary.json"}
    found = read_measurements(tmp_path / f"{NACA}-upper.csv")
    assert found.speed_rad_s / RPM == pytest.approx([3000, 4000, 5500, 7000], rel=1e-3)
    settings = [s for s in analyse_series(single).settings if s.rotor == NACA]
    assert found.density_kg_m3 == pytest.approx(np.mean([s.density_kg_m3 for s in settings]), rel=1e-6)
    last = max(settings, key=lambda s: s.single_rotor_torque.value)
    to_mean = found.density_kg_m3 / last.density_kg_m3
    assert found.torque_Nm[-1] == pytest.approx(last.single_rotor_torque.value * to_mean, rel=1e-6)
    assert found.air.density_kg_m3 == found.density_kg_m3  # which compare and fit_rotor take
    motor = read_bench_file(tmp_path / "motor-upper.csv")
    assert {"voltage", "current", "speed", "torque"} <= set(motor.columns)
    write_series_results(analyse_series(pair), tmp_path / "pair")
    both = read_bench_file(tmp_path / "pair" / f"{NACA}-pair-points.csv")
    assert {"speed_upper", "speed_lower", "thrust", "torque_upper", "torque_lower", "density"} <= set(both.columns)


def test_series_beside_another_and_beside_the_theory_that_made_them(single, pair):
    series = analyse_series(single)
    assert all(d.En_score == 0 for d in compare_series(series, series))
    theory = compare_with_theory(series)
    assert len(theory) == 8
    assert np.mean([abs(d.En_score) < 1 for d in theory]) > 0.7
    other = analyse_series(measured(plan(), SimulatedRig(8)))
    assert np.mean([abs(d.En_score) < 1 for d in compare_series(series, other)]) > 0.7
    with pytest.raises(InputError, match="no setting in common"):
        compare_series(series, analyse_series(pair))


def test_the_page_is_whole_at_any_time(tmp_path, single):
    made = plan()
    for n in (0, 1, 5, len(single.lines)):
        write_live_page(tmp_path, made, single.lines[:n], "<running> & well", n / len(single.lines), over=n > 5)
        text = (tmp_path / "live.html").read_text()
        assert text.endswith("</html>")
        assert "&lt;running&gt; &amp; well" in text
        assert ("http-equiv" in text) == (n <= 5)
    assert text.count("<circle") > 20
