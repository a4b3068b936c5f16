"""Flights on the vehicle's own sensors: what is recorded, what is done about doubt, what is said of sensors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from mufly.cli import app
from mufly.control import FlightController, design_flight_controller
from mufly.dynamics import standing_attitude, standing_height
from mufly.errors import InputError
from mufly.estimate import ERROR_STATES, AuxiliaryStates, Estimate, Estimator, KalmanEstimator, SensorStatus
from mufly.estimate.filter.measurements.sensor_checks import REASON_DUPLICATED, STATUS_WAITING
from mufly.estimate.sensor_status import _make_status
from mufly.flight import Flight, fly_mission, read_recording, replace_estimates, replay_estimator
from mufly.flight.estimator_health import (
    FAULT_REPORT_DELAY_S,
    RECOVERY_REPORT_DELAY_S,
    CorrectionSmoother,
    HealthMonitor,
    SensorEventReporter,
    describe_missing_position_sensor,
    judge_estimate,
)
from mufly.identify.flight_record import make_flight_record
from mufly.mission import format_mission_toml, parse_mission
from mufly.quantities.quantity_table import FUSION_STATUSES, READINGS_WITH_FUSION_STATUS
from mufly.quantities.sensor_table import READINGS
from mufly.sensors import (
    Reading,
    Readings,
    SensorSet,
    Truth,
    parse_fault,
    randomise_leg_lengths,
)
from mufly.sensors.sonar import max_standing_sonar_range, standing_sonar_range
from mufly.vehicle import Vehicle, load_vehicle, replace_parameters
from mufly.world import World

HOP = parse_mission({"take_off": {"height_m": 0.6, "wait_s": 0.5}, "waypoint": [{"position_m": [0.4, 0.0, -0.6]}]})


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)


def believing(m: Estimate, *, xy: float = 0.04, z: float = 0.01, tilt: float = 0.01, **checks: str) -> Estimate:
    """An estimate with these deviations (m, m, rad), and what is thought of some sensors."""
    sigma = np.array([xy, xy, z, 0.1, 0.1, 0.1, tilt, tilt, 0.02, 0.01, 0.01, 0.01])
    said = tuple(SensorStatus(name, status, reason="so it is") for name, status in checks.items())  # type: ignore[arg-type]
    beliefs = AuxiliaryStates(
        np.zeros(3), np.zeros(3), 0.0, np.zeros(4), np.zeros(2), 1.0, np.ones(len(ERROR_STATES)), said
    )
    return replace(m, covariance=np.diag(sigma**2), auxiliary_states=beliefs)


def still(time_s: float = 1.0) -> Estimate:
    zero = np.zeros(3)
    return Estimate(time_s, np.array([0.0, 0.0, -1.0]), zero, zero, zero, np.full(8, 1.5), 7.4)


class Teller(Estimator):
    """Tells what is true, with doubts that a test sets."""

    def __init__(self) -> None:
        self.flight: Flight
        self.doubt: dict[str, object] = {}

    def update(self, readings: Readings, acting: np.ndarray | None = None) -> Estimate:
        t = self.flight.plant.truth if hasattr(self, "flight") else None
        if t is None:
            return believing(still(readings.time_s))
        ranges, zero = np.full(8, 1.5), {}
        m = Estimate(readings.time_s, t.position, t.velocity, t.attitude, t.rates, ranges, t.battery_voltage_V, **zero)
        return believing(m, **self.doubt)  # type: ignore[arg-type]


@pytest.mark.parametrize("noise_m", [0.003, 0.03])
def test_a_sonar_high_on_the_fuselage_takes_the_floor_for_no_flight(
    vehicle: Vehicle, controller: FlightController, noise_m: float
) -> None:
    """On the floor such a sonar reads more than its least range, and still the vehicle stands (no lift-off)."""
    high = replace_parameters(
        vehicle,
        {"sensors.sonar.position": [[0.0, 0.0, -0.02]], "sensors.sonar.noise": noise_m},
    )
    reads = standing_sonar_range(high)
    assert reads == pytest.approx(standing_height(high) + 0.02)
    assert max_standing_sonar_range(high) == pytest.approx(reads + 3.0 * noise_m)
    assert max_standing_sonar_range(vehicle) == float(
        vehicle.sensors.sonar.min_range
    )  # a low one reads its least range
    told: list[str] = []
    flight = fly_mission(
        high, HOP, controller=controller, sensors="fitted", seed=5, on_event=lambda e: told.append(e.text)
    )
    assert flight.attrs["outcome"] == "succeeded"
    assert not [text for text in told if "is rejected" in text or "gyroscope" in text]


@pytest.mark.parametrize("heading_deg", [40.0, -170.0])
def test_a_start_far_from_the_origin_is_found_by_the_first_fix(
    vehicle: Vehicle, controller: FlightController, heading_deg: float
) -> None:
    """The filter begins at the origin heading north; nothing may be rejected because the vehicle stands elsewhere."""
    far = parse_mission(
        {
            "start_m": [31.0, -24.0], "start_heading_deg": heading_deg, "take_off": {"height_m": 0.6, "wait_s": 0.5},
            "waypoint": [{"position_m": [31.4, -24.0, -0.6]}],
        }
    )  # fmt: skip
    told: list[str] = []
    flight = fly_mission(
        vehicle,
        far,
        controller=controller,
        sensors="fitted",
        seed=5,
        wind=(0.2, 0.2, 0.0),
        on_event=lambda e: told.append(e.text),
    )
    assert flight.attrs["outcome"] == "succeeded"
    assert not [text for text in told if "fix" in text or "rejected" in text], told
    aloft = flight.isel(time=flight.mission_state.values == "hover")
    off = aloft.estimated_position.values - aloft.truth_position.values
    assert np.abs(off[:, :2]).max() < 0.15
    turned = aloft.estimated_attitude.values[:, 2] - aloft.truth_attitude.values[:, 2]
    assert np.abs(np.sin(0.5 * turned)).max() < 0.05


@pytest.fixture
def doubting(vehicle: Vehicle, controller: FlightController):
    """A flight that hovers on its way, with an estimator whose doubts can be set: (flight, estimator, events)."""
    teller = Teller()
    flight = Flight(vehicle, LONG, controller=controller, sensors="fitted", estimator=teller, keep=False)
    teller.flight = flight
    events: list[str] = []
    flight.autopilot.listeners.append(lambda e: events.append(e.text))
    for _ in range(2):  # the first period has the estimate of the flight's construction
        flight.step_period()
    assert flight.autopilot.arm()
    assert flight.autopilot.start_mission()
    while flight.status.state != "waypoint":
        flight.step_period()
    return flight, teller, events


LONG = parse_mission({"take_off": {"height_m": 0.5, "wait_s": 0.1}, "waypoint": [{"position_m": [3.0, 0.0, -0.5]}]})


def run(flight: Flight, seconds: float) -> None:
    until = flight.time_s + seconds
    while flight.time_s < until:
        flight.step_period()


def test_an_uncertain_position_makes_it_wait_and_a_certain_one_go_on(doubting) -> None:
    flight, teller, events = doubting
    teller.doubt = {"xy": 0.3, "position_fix": "missing"}
    run(flight, 1.0)
    assert flight.status.state == "hover"
    assert any("position uncertain by 0.30 m (position fix is missing: so it is)" in e for e in events)
    run(flight, 2.0)
    assert abs(flight.plant.state[3]) < 0.1  # it stands still meanwhile
    teller.doubt = {"xy": 0.2}
    run(flight, 2.0)
    assert flight.status.state == "hover"  # not certain enough
    teller.doubt = {}
    run(flight, 2.0)
    assert flight.status.state == "waypoint"
    assert "position known again" in events
    teller.doubt = {"xy": 0.3}
    run(flight, 11.0)
    assert flight.status.state == "landing"
    assert flight.status.outcome == "failed"
    assert flight.status.reason.startswith("position uncertain by 0.30 m")
    assert flight.status.reason.endswith("for 10 s")


def test_an_attitude_in_doubt_brings_it_down_at_once(doubting) -> None:
    flight, teller, _ = doubting
    teller.doubt = {"tilt": 0.3, "rates": "faulty"}
    run(flight, 0.1)
    assert flight.status.motors == "blind"
    assert flight.status.reason == "attitude uncertain by 17 deg (gyroscope is faulty: so it is)"
    sinks = 0.0
    for _ in range(80):  # the height is known all the same: it keeps to a rate of descent
        run(flight, 0.1)
        sinks = max(sinks, float(flight.plant.state[5]))
    assert 0.5 < sinks < 1.1
    assert flight.status.motors == "off"
    assert not flight.plant.crash_cause


@pytest.mark.parametrize(
    ("doubt", "demand"),
    [
        ({}, ""),
        ({"xy": 0.26}, "hold"),
        ({"xy": 0.7}, "land"),
        ({"z": 0.4}, "land"),
        ({"tilt": 0.2}, "sink"),
        ({"z": 0.4, "tilt": 0.2}, "sink"),
    ],
)
def test_what_is_done_follows_from_the_covariance_alone(doubt: dict[str, float], demand: str) -> None:
    m = believing(still(), **doubt)  # type: ignore[arg-type]
    assert judge_estimate(m).action == demand
    assert (judge_estimate(m).reason == "") == (demand == "")
    assert judge_estimate(replace(m, auxiliary_states=None)).action == ""  # what is told the truth has no doubts


def test_who_stands_he_knows_not_where_may_fly_until_that_grows_worse() -> None:
    lost = HealthMonitor(standing_position_variance_m2=25.0)
    assert lost.decide_failsafe(believing(still(), xy=5.0)).action == ""
    assert lost.decide_failsafe(believing(still(1.02), xy=math.sqrt(25.0 + 0.24**2))).action == ""
    assert lost.decide_failsafe(believing(still(1.04), xy=math.sqrt(25.0 + 0.3**2))).reason.startswith(
        "position uncertain by 0.30 m"
    )


@pytest.mark.parametrize(("spells", "demand"), [((0.28, 0.28), ""), ((0.34,), "land")])
def test_a_height_is_landed_for_once_its_doubt_has_lasted(spells: tuple[float, ...], demand: str) -> None:
    doubts, t = HealthMonitor(), 0.0
    for spell in spells:  # with a moment between in which the sonar has told it
        until = t + spell
        while t < until:
            doubts.decide_failsafe(believing(still(t), z=0.31))
            t += 0.02
        if demand:
            break
        doubts.decide_failsafe(believing(still(t), z=0.29))
        t += 0.02
    assert doubts.verdict.action == demand
    assert doubts.verdict.reason == ("height uncertain by 0.31 m" if demand else "")
    # what else is doubted meanwhile counts at once
    assert HealthMonitor().decide_failsafe(believing(still(), z=0.4, xy=0.3)).action == "hold"


def test_doubts_do_not_chatter() -> None:
    rng, doubts, said = np.random.default_rng(1), HealthMonitor(), []
    for k in range(2000):
        before = doubts.verdict
        doubts.decide_failsafe(believing(still(0.02 * k), xy=0.2 + 0.08 * rng.uniform(-1, 1)))
        said += [doubts.verdict.action] * (doubts.verdict is not before)
    assert said[:1] == ["hold"]
    assert len(said) <= 2  # and at last it lands


def watched(status_at, seconds: float, watch: SensorEventReporter, period_s: float = 0.005) -> list[tuple[float, str]]:
    told = []
    for k in range(round(seconds / period_s)):
        t = k * period_s
        said = watch.collect_new_reports((SensorStatus("ranges", status_at(t), reason="why"),), period_s)
        told += [(t, text) for text, _ in said]
    return told


def test_what_is_said_of_sensors_comes_soon_and_once() -> None:
    told = watched(lambda t: "missing" if 1.0 <= t < 3.0 else "fused", 6.0, SensorEventReporter())
    assert [text for _, text in told] == ["laser ring is missing: why", "laser ring is used again"]
    assert told[0][0] == pytest.approx(1.0 + FAULT_REPORT_DELAY_S / 4, abs=0.02)  # it has been waited for already
    assert told[1][0] == pytest.approx(3.0 + RECOVERY_REPORT_DELAY_S, abs=0.02)
    # one reading of 15 Hz that does not fit, every second, is no event; one in four is, and only one
    assert not watched(lambda t: "rejected" if t % 1.0 < 0.066 else "fused", 60.0, SensorEventReporter())
    told = watched(lambda t: "rejected" if t % 0.266 < 0.066 else "fused", 60.0, SensorEventReporter())
    assert [text for _, text in told] == ["laser ring is rejected: why"]
    watch, odd = (
        SensorEventReporter(),
        (SensorStatus("rates", "fused", reason="has spikes", is_suspicious=True),),
    )
    said = [text for _ in range(100) for text, _ in watch.collect_new_reports(odd, 0.005)]
    assert said == ["gyroscope is used despite a fault: has spikes"]
    assert not watch.has_nothing_to_report(odd)


def test_a_fault_is_reported_of_a_ring_that_sees_no_wall() -> None:
    row = (STATUS_WAITING, REASON_DUPLICATED, 0.0, 0.0, 1.0, 0, 100)
    check = _make_status(READINGS_WITH_FUSION_STATUS.index("ranges"), row, 0.005, 100, 0)
    assert (check.status, check.is_suspicious) == ("waiting", True)
    watch = SensorEventReporter()
    said = [text for _ in range(100) for text, _ in watch.collect_new_reports((check,), 0.005)]
    assert said == ["laser ring has a fault: every reading arrives twice; duplicates are ignored"]


def test_smoothing_lets_motion_through_and_spreads_corrections() -> None:
    smooth, dt = CorrectionSmoother(), 0.005
    moving = np.array([0.5, 0.0, -0.2])
    for k in range(2000):
        t = k * dt
        m = replace(still(t), position=moving * t, velocity=moving)
        out = smooth.smooth_estimate(m)
        assert out.position == pytest.approx(m.position, abs=1e-12)  # no lag
    step = np.array([0.01, 0.0, 0.0])
    before = out.position
    worst = 0.0
    for k in range(2000, 2400):
        t = k * dt
        out = smooth.smooth_estimate(replace(still(t), position=moving * t + step, velocity=moving))
        worst = max(worst, float(np.abs(out.position - before - dt * moving).max()))
        before = out.position
    assert worst < 2e-4  # a fiftieth of the step in a period
    assert out.position == pytest.approx(moving * t + step, abs=1e-4)


def test_before_take_off_it_says_what_will_not_work() -> None:
    m = believing(still(), position_fix="missing", ranges="fused")
    assert "no sensor measures the horizontal position" in describe_missing_position_sensor(m, 1.5)
    assert describe_missing_position_sensor(replace(m, ranges=np.array([1.5, 0.8])), 1.5) == ""
    assert describe_missing_position_sensor(believing(still(), position_fix="fused", ranges="fused"), 1.5) == ""
    assert describe_missing_position_sensor(still(), 1.5) == ""


def test_statuses_and_readings_have_one_list() -> None:
    import typing

    from mufly.estimate import FusionStatus

    assert set(typing.get_args(FusionStatus)) == set(FUSION_STATUSES)
    assert set(READINGS_WITH_FUSION_STATUS) <= set(READINGS)


def test_gyroscopes_that_are_gone_and_aids_that_contradict_bring_it_down(doubting) -> None:
    flight, teller, _ = doubting
    teller.doubt = {"position_fix": "rejected"}  # one alone may be wrong itself
    run(flight, 0.5)
    assert flight.status.motors == "fly"
    teller.doubt = {"position_fix": "rejected", "magnetic_field": "rejected"}
    run(flight, 0.1)
    assert flight.status.motors == "fly"
    run(flight, 0.1)
    assert flight.status.motors == "blind"
    said = "attitude contradicted by magnetometer and position fix: gyroscopes, rotor model or both aids are wrong"
    assert flight.status.reason == said
    doubts = HealthMonitor()
    for k in range(8):
        doubts.decide_failsafe(believing(still(0.02 * k), rates="missing"))
    assert doubts.verdict == ("land", "gyroscope is missing: so it is")
    doubts.decide_failsafe(believing(still(0.2), rates="missing", tilt=0.3))
    assert doubts.verdict.action == "sink"


def test_a_rejected_sensor_is_accused_alone_only_while_nothing_else_contradicts_the_estimate() -> None:
    def said(**statuses: str) -> list[str]:
        checks = [SensorStatus(name, status, reason="why") for name, status in statuses.items()]  # type: ignore[arg-type]
        return [text for text, _ in SensorEventReporter().collect_new_reports(checks, 2.0 * FAULT_REPORT_DELAY_S)]

    assert said(position_fix="rejected", rates="fused", magnetic_field="fused") == ["position fix is rejected: why"]
    assert said(ranges="rejected", position_fix="rejected")[1] == "position fix is rejected: why"  # no attitude aid
    assert said(magnetic_field="rejected", position_fix="rejected") == [
        "magnetometer, inertial unit or rotor model: why",
        "position fix, inertial unit or rotor model: why",
    ]
    assert said(acceleration="faulty", ground_distance="rejected") == [
        "accelerometer is faulty: why",
        "sonar, inertial unit or rotor model: why",
    ]
    assert said(rates="rejected", position_fix="rejected")[0] == "gyroscope is rejected: why"
    assert said(acceleration="faulty", rates="rejected")[1] == "gyroscope or rotor model: why"


def test_without_gyroscopes_it_lands_and_lets_go_above_the_floor(doubting) -> None:
    flight, teller, _ = doubting
    teller.doubt = {"rates": "missing"}
    run(flight, 0.2)
    assert (flight.status.state, flight.status.motors) == ("landing", "fly")
    stands = flight.autopilot.software.mission_state.home_position[2]
    while flight.status.motors == "fly" and flight.time_s < 30.0:
        flight.step_period()
    assert flight.status.motors == "blind"
    assert 0.0 < stands - flight.plant.state[2] < 0.035
    assert flight.plant.truth.velocity[2] < 0.5
    run(flight, 1.0)  # on legs that stand nothing lifts any more
    assert flight.status.motors == "off"
    assert not flight.plant.crash_cause
    assert abs(flight.plant.truth.attitude[:2]).max() < 0.02


@pytest.fixture(scope="module")
def sensed(tmp_path_factory):
    """A hop on the vehicle's own sensors, as the command flies it, with a sonar that is not there for a while."""
    out = tmp_path_factory.mktemp("sensed")
    (out / "hop.toml").write_text(format_mission_toml(HOP))
    words = ["fly", str(out / "hop.toml"), "--headless", "--out", str(out / "flown"), "--seed", "10000"]
    result = CliRunner().invoke(app, [*words, "--fault", "sonar.dropout@9s+1s"])
    assert result.exit_code == 0, result.output
    return out / "flown", read_recording(out / "flown" / "flight.mcap"), result.output


def test_a_hop_on_sensors_succeeds_and_shows_what_it_believed(sensed) -> None:
    folder, data, said = sensed
    assert "Flies on its sensors: imu, sonar" in said
    assert data.attrs["outcome"] == "succeeded"
    assert data.attrs["faults"] == ["sonar.dropout@9s+1s"]
    off = (data.estimated_position - data.truth_position).values
    assert np.abs(off).max() < 0.25
    lean = standing_attitude(randomise_leg_lengths(load_vehicle("mufly-1.1"), seed=10_000))
    for row in (0, -1):  # as its legs hold it, before the flight and after
        np.testing.assert_allclose(data.truth_attitude.values[row, :2], lean, atol=3e-4)
    texts = [str(t) for t in data.event_text.values]
    assert texts.count("sonar is used again") == 1
    noticed = next(e for e, t in zip(data.event_time.values, texts, strict=True) if t.startswith("sonar is missing"))
    assert 9.0 < noticed < 9.5
    assert {"estimate.png", "sensors.png", "way.png", "history.png"} <= {p.name for p in folder.iterdir()}


def test_readings_are_in_the_rows_in_which_they_came(sensed) -> None:
    _, data, _ = sensed
    time = data.time.values
    assert np.diff(time).max() == pytest.approx(0.005, abs=1e-9)
    when = data.measured_position_fix_time.values
    came = np.isfinite(when)
    assert 0.15 < (time - when)[came].min() < 0.25
    assert came.sum() == pytest.approx(15.0 * time[-1], rel=0.1)
    assert np.isnan(data.measured_position_fix.values[~came]).all()
    quiet = (time > 9.1) & (time < 9.9)
    assert not np.isfinite(data.measured_ground_distance_time.values[quiet]).any()
    status = data.status_ground_distance.values[(time > 9.5) & (time < 9.9)]
    assert (status == FUSION_STATUSES.index("missing")).all()


def test_the_estimate_can_be_made_again_from_the_recording_to_the_bit(sensed, vehicle) -> None:
    folder, data, _ = sensed
    again = replace_estimates(data, replay_estimator(data, KalmanEstimator(vehicle, World(), 200.0)))
    for name in ("position", "velocity", "attitude", "rates", "position_sigma", "gyro_bias"):
        assert np.array_equal(again[f"estimated_{name}"], data[f"estimated_{name}"], equal_nan=True), name
    result = CliRunner().invoke(app, ["estimate", "run", str(folder / "flight.mcap"), "--out", str(folder / "again")])
    assert result.exit_code == 0, result.output
    assert "NEES / n" in result.output
    assert {"estimate.png", "sensors.png", "way.png", "estimate.mcap"} == {p.name for p in (folder / "again").iterdir()}


def test_identification_takes_what_was_estimated_where_no_sensor_tells_it(sensed) -> None:
    _, data, _ = sensed
    record = make_flight_record(data, "flight.mcap")
    assert {"north", "height", "roll", "yaw", "p", "r", "speed_up"} <= set(record.output_names)
    told = dict(zip(record.output_names, record.measured.T, strict=True))
    flown = data.estimated_valid.values > 0.5
    assert np.array_equal(told["roll"][flown], data.estimated_attitude.values[flown, 0])
    assert np.isnan(told["roll"][~flown]).all()
    assert np.array_equal(told["p"], data.measured_rates.values[:, 0])  # sensors come first


class Spoilt(SensorSet):
    """Sensors of which now and then one says something else, or nothing."""

    def __init__(self, sensors: SensorSet, evils: list[tuple[float, float, str, str]]) -> None:
        super().__init__()
        self._sensors, self._evils, self._first = sensors, evils, {}

    def read(self, truth: Truth) -> Readings:
        said = self._sensors.read(truth)
        latest, now = dict(said.latest), truth.time_s
        for start, span, evil, name in self._evils:
            if start <= now < start + span and name in latest:
                r = latest.pop(name)
                first = self._first.setdefault((start, evil, name), r)
                if evil != "missing":
                    latest[name] = worse(r, evil, now, first)
        return Readings(now, latest)

    def reset(self) -> None:
        self._sensors.reset()


def worse(r: Reading, evil: str, now: float, first: Reading) -> Reading:
    """What is said instead."""
    value = np.asarray(r.value, dtype=float)
    return {
        "nan": Reading(value * math.nan, now),
        "huge": Reading(value * 0.0 - 1e30, now),
        "off": Reading(value * 1.3 + 0.2, r.time_s),
        "late": Reading(r.value, now - 3.0),
        "early": Reading(r.value, now + 3.0),
        "twice": Reading(r.value, now),
        "frozen": Reading(first.value, now),
    }[evil]


EVIL = st.sampled_from(["missing", "nan", "huge", "off", "late", "early", "twice", "frozen"])


@settings(
    max_examples=8,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@example([(3.0, 1.0, "off", "battery_voltage")])
@given(
    st.lists(
        st.tuples(st.floats(2.5, 7.0), st.floats(0.01, 2.0), EVIL, st.sampled_from(READINGS_WITH_FUSION_STATUS)),
        min_size=1,
        max_size=4,
    )
)
def test_nothing_that_sensors_say_brings_a_nan_or_a_jump_into_the_actuators(vehicle, controller, evils) -> None:
    """Through sensors, filter, trust, controllers: docs/reference/filter.md says what an input moves by in a period."""
    with Flight(vehicle, HOP, controller=controller, seed=4, sensors="fitted", keep=False) as flight:
        flight.sensors = Spoilt(flight.sensors, evils)
        last = None
        while flight.time_s < 8.0:
            if flight.status.motors == "off" and flight.time_s > 1.0 and not flight.autopilot.list_arming_faults():
                flight.autopilot.arm()
                flight.autopilot.start_mission()
            flight.step_period()
            now = flight.status.actuators.input_array
            assert np.isfinite(now).all()
            if last is not None and now[0] > 0.0 and last[0] > 0.0:
                assert np.abs(now - last)[:2].max() < 0.101
                assert np.abs(now - last)[2:].max() < 0.201
            last = now.copy()


def test_a_fault_may_be_injected_and_cleared_in_flight(vehicle, controller) -> None:
    with Flight(vehicle, HOP, controller=controller, sensors="fitted", keep=False) as flight:
        for _ in range(20):
            flight.step_period()
        flight.inject_fault(parse_fault("sonar.stuck=2@0s+5s"))
        assert [str(f) for f in flight.status.faults] == ["sonar.stuck@0.095s+5s"]
        for _ in range(20):
            flight.step_period()
        assert flight.status.readings["ground_distance"].value == 2.0
        flight.clear_faults()
        for _ in range(20):
            flight.step_period()
        assert flight.status.readings["ground_distance"].value < 0.2
        assert flight.faults == ()
        with pytest.raises(InputError, match="no sensors"):
            Flight(
                vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update={"sonar": None})}),
                HOP, controller=controller, sensors="fitted",
            ).inject_fault(parse_fault("sonar.jump"))  # fmt: skip


def test_a_vehicle_without_sensors_says_so_and_flies_on_what_is_true(vehicle, controller) -> None:
    bare = vehicle.model_copy(update={"sensors": None})
    told: list[str] = []
    flight = fly_mission(bare, HOP, controller=controller, sensors="fitted", on_event=lambda e: told.append(e.text))
    assert flight.attrs["outcome"] == "succeeded"
    assert told[0] == "mufly-1.1 has no table [sensors]: the vehicle flies on the true state, without filter"
    with pytest.raises(InputError, match="no table"):
        Flight(bare, HOP, controller=controller, sensors="fitted", faults=[parse_fault("sonar.jump")])
    with pytest.raises(InputError, match="flies on the true state"):
        Flight(vehicle, HOP, controller=controller, faults=[parse_fault("sonar.jump")])
