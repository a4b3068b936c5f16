"""Sources of fixes that contradict the inertial unit are named; sources that only drift are not."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from mufly.dynamics import GRAVITY
from mufly.estimate import Estimate
from mufly.flight import Flight
from mufly.flight.fixes.camera_sensor import CameraSensor, judge_camera_path_ratio
from mufly.flight.fixes.external_fixes import ExternalFixes
from mufly.flight.fixes.fix_monitor import FixMonitor
from mufly.flight.mission_flight import await_estimate_and_start
from mufly.mission import load_mission
from mufly.sensors import Reading, Readings
from mufly.slam import TrackingResult
from mufly.vehicle import load_vehicle

RATE_HZ, REST_S, DRIFT_M = 100, 4.0, 0.03
BIAS = np.array([0.08, -0.05, 0.02])
Change = Callable[[np.ndarray, float], np.ndarray]
Check = Callable[[float, np.ndarray], str]


def path_at(t: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return position, acceleration and heading of a flight that rests, then sways and turns its nose."""
    u = max(0.0, t - REST_S)
    w, size, start = np.array([1.3, 0.9]), np.array([0.5, 0.7]), 1.0 - math.exp(-u)
    place = size * (1.0 - np.cos(w * u)) * start
    step = 1e-3

    def at(v: float) -> np.ndarray:
        v = max(v, 0.0)
        return size * (1.0 - np.cos(w * v)) * (1.0 - math.exp(-v))

    acceleration = (at(u + step) - 2 * at(u) + at(u - step)) / step**2 if u > step else np.zeros(2)
    return place, acceleration, 0.4 * u


def rotate(angle: float) -> Change:
    c, s = math.cos(angle), math.sin(angle)
    return lambda p, t: np.array([c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]])


def run_source(
    change: Change, until_s: float = 12.0, late_s: float = 0.0, seed: int = 1, check: Check | None = None,
    monitor: FixMonitor | None = None,
) -> list[tuple[float, str]]:  # fmt: skip
    """Return time and reason of each fix of a source that sees the path through a change."""
    monitor, rng, out = monitor or FixMonitor(DRIFT_M), np.random.default_rng(seed), []
    check = check or monitor.find_fix_refusal
    drift, zero = np.zeros(2), np.zeros(3)
    for k in range(round(until_s * RATE_HZ)):
        t = k / RATE_HZ
        _, acceleration, heading = path_at(t)
        c, s = math.cos(heading), math.sin(heading)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        force = turn.T @ np.array([*acceleration, -GRAVITY]) + BIAS + 0.02 * rng.standard_normal(3)
        rates = np.array([0.01, -0.01, 0.005 + (0.4 if t > REST_S else 0.0)])
        readings = Readings(t, {"acceleration": Reading(force, t), "rates": Reading(rates, t)})
        estimate = Estimate(t, zero, zero, np.array([0.0, 0.0, heading]), zero)
        monitor.propagate_inertial_path(readings, estimate, t < REST_S)
        if k % 6 == 5:
            keep = math.exp(-6 / RATE_HZ / 3.0)
            drift = keep * drift + 0.5 * DRIFT_M * math.sqrt(1 - keep**2) * rng.standard_normal(2)
            place, _, seen = path_at(t - late_s)
            fix = change(np.append(place, seen), t)
            fix[:2] += drift + 0.005 * rng.standard_normal(2)
            out.append((t, check(t, np.array([fix[0], fix[1], -1.0, fix[2]]))))
    return out


def shift(p: np.ndarray, axis: int, length: float) -> np.ndarray:
    out = p.copy()
    out[axis] += length
    return out


def same(p: np.ndarray, t: float) -> np.ndarray:
    return p.copy()


@pytest.mark.parametrize("seed", [1, 2])
def test_a_source_that_only_drifts_is_accepted(seed: int) -> None:
    """With a bias of the accelerometers and a nose that turns."""
    assert {why for _, why in run_source(same, 20.0, seed=seed)} == {""}


@pytest.mark.parametrize(
    ("change", "late_s", "named"),
    [
        (rotate(math.pi / 2), 0.0, "turned"),
        (rotate(-math.pi / 4), 0.0, "turned"),
        (lambda p, t: p * [1.0, -1.0, 1.0], 0.0, "mirrored"),
        (lambda p, t: p[[1, 0, 2]], 0.0, "mirrored"),
        (lambda p, t: p * [1.5, 1.5, 1.0], 0.0, "times as far"),
        (lambda p, t: p * [0.4, 0.4, 1.0], 0.0, "times as far"),
        (same, 0.5, "later than its times"),
        (lambda p, t: shift(p, 2, 0.6 if t > 8.0 else 0.0), 0.0, "heading turns by 34 degrees"),
        (lambda p, t: shift(p, 0, 0.05 * t), 0.0, "cm/s while the vehicle stands"),
        (lambda p, t: shift(p, 0, 1.0 if t > 9.0 else 0.0), 0.0, "it has jumped"),
    ],
)
def test_a_source_with_an_error_is_named(change: Change, late_s: float, named: str) -> None:
    reasons = run_source(change, late_s=late_s)
    first = next((t, why) for t, why in reasons if why and not (why.startswith("it is withheld") and "jump" not in why))
    assert named in first[1]
    assert first[0] < (REST_S if "stands" in named else 10.0)


def run_hover(
    until_s: float, late_s: float = 0.0, scale: float = 1.0, sway_m: float = 0.0, turn_rad: float = 0.0
) -> list[tuple[float, str]]:
    """Return time and reason of each fix over a hover that sways and turns its nose to and fro."""
    monitor, rng, out, zero = FixMonitor(DRIFT_M), np.random.default_rng(4), [], np.zeros(3)
    w = np.array([1.3, 0.9])

    def heading_at(t: float) -> float:
        return turn_rad * (1.0 - math.cos(0.8 * max(0.0, t - REST_S - 3.0)))

    for k in range(round(until_s * RATE_HZ)):
        t = k / RATE_HZ
        u, heading = max(0.0, t - REST_S), heading_at(t)
        rate = (heading_at(t + 0.005) - heading_at(t - 0.005)) / 0.01
        accel = sway_m * w * w * np.cos(w * u) * (t > REST_S)
        c, s = math.cos(heading), math.sin(heading)
        force = np.array([c * accel[0] + s * accel[1], c * accel[1] - s * accel[0], -GRAVITY])
        noisy = Reading(force + 0.02 * rng.standard_normal(3), t), Reading(np.array([0.0, 0.0, rate]), t)
        readings = Readings(t, {"acceleration": noisy[0], "rates": noisy[1]})
        monitor.propagate_inertial_path(
            readings, Estimate(t, zero, zero, np.array([0.0, 0.0, heading]), zero), t < REST_S
        )
        if k % 6 == 5:
            v = max(0.0, t - late_s - REST_S)
            north, east = scale * sway_m * (1.0 - np.cos(w * v)) + 0.01 * rng.standard_normal(2)
            out.append((t, monitor.find_fix_refusal(t, np.array([north, east, -1.0, heading_at(t - late_s)]))))
    return out


def test_a_late_heading_shows_the_delay_when_the_nose_turns() -> None:
    """Within a second of the turn, and fixes are withheld before; without a delay none is."""
    assert {why for _, why in run_hover(12.0, turn_rad=0.6)} == {""}
    reasons = [(t, why) for t, why in run_hover(12.0, late_s=0.5, turn_rad=0.6) if why]
    assert "does not follow the measured turn rate" in reasons[0][1]
    told = next(t for t, why in reasons if "ms later than its times" in why and "withheld" not in why)
    assert told < REST_S + 3.0 + 2.0


def test_a_small_error_of_scale_is_named_after_a_while() -> None:
    assert {why for _, why in run_hover(40.0, sway_m=0.08)} == {""}
    reasons = [why for _, why in run_hover(40.0, sway_m=0.08, scale=1.3) if why]
    assert "times as far" in reasons[-1]
    assert float(reasons[-1].split()[2]) == pytest.approx(1.3, abs=0.1)


@pytest.mark.parametrize(
    ("change", "fault"),
    [(same, ""), (rotate(math.radians(-12.0)), "is turned"), (lambda p, t: p * [1.2, 1.2, 1.0], "is longer")],
)
def test_a_camera_that_is_turned_or_scaled_shows_in_the_long_fit(change: Change, fault: str) -> None:
    monitor = FixMonitor(DRIFT_M)
    run_source(change, 16.0, monitor=monitor)
    assert fault in judge_camera_path_ratio(*monitor.long_fit)
    assert fault or not judge_camera_path_ratio(*monitor.long_fit)


@pytest.mark.parametrize("change", [rotate(math.radians(-20.0)), lambda p, t: p * [1.3, 1.3, 1.0]])
def test_a_wrong_camera_is_followed_on_its_corrected_path(change: Change) -> None:
    """Until touchdown positions move as the vehicle does; a jump of the map is not followed."""
    camera, monitor, found = object.__new__(CameraSensor), FixMonitor(DRIFT_M), []
    camera._monitor, camera._compared_s, camera._corrected_path = monitor, -math.inf, None

    def check(time_s: float, place: np.ndarray) -> str:
        jump = np.array([1.0, 0.0, 0.0]) * (time_s > 22.0)
        known = TrackingResult(time_s, True, position=place[:3] + jump, heading=place[3], covariance=1e-4 * np.eye(4))
        known = camera._compare_with_accelerometers(known)
        if known.camera_fault:
            found.append((time_s, *known.position[:2], known.covariance[0, 0]))
            assert known.trusted
        return ""

    run_source(change, 26.0, monitor=monitor, check=check)
    late = np.array([f for f in found if 18.0 < f[0] < 22.0])
    true = np.array([path_at(t)[0] for t in late[:, 0]])
    moved, ought = late[:, 1:3] - late[0, 1:3], true - true[0]
    assert np.abs(ought).max() > 0.5
    assert np.abs(moved - ought).max() < 0.1
    assert late[:, 3].min() > 0.01
    begin = next(f for f in found if f[0] > 22.0)
    assert np.abs(begin[1:3]).max() < 0.05  # the estimate of the test


def test_a_refused_source_returns_when_it_agrees_for_long() -> None:
    """Not at once, and after a jump without another error, soon."""
    turned = rotate(math.pi / 2)
    reasons = run_source(lambda p, t: turned(p, t) if t < 11.0 else p.copy(), 36.0)
    refused = [t for t, why in reasons if why]
    assert 21.0 < refused[-1] < 34.0
    assert all(why for t, why in reasons if 11.0 < t < 21.0)
    jumped = [t for t, why in run_source(lambda p, t: shift(p, 0, 1.0 if t > 9.0 else 0.0), 16.0) if why]
    assert (jumped[0], jumped[-1]) == pytest.approx((9.0, 13.0), abs=0.2)


@pytest.mark.parametrize(
    "change",
    [
        rotate(math.pi / 2),
        lambda p, t: p * [1.0, -1.0, 1.0],
        lambda p, t: p * [1.6, 1.6, 1.0],
    ],
)
def test_the_motion_of_a_refused_source_is_corrected_for_the_landing(change: Change) -> None:
    monitor, corrected = FixMonitor(DRIFT_M), []

    def keep(t: float, place: np.ndarray) -> str:
        why = FixMonitor.find_fix_refusal(monitor, t, place)
        if (fix := monitor.correct_fix(t, place)) is not None:
            corrected.append((t, *fix[1][:2]))
        return why

    run_source(change, 14.0, check=keep, monitor=monitor)
    t, *place = np.array(corrected).T
    assert t[0] < 10.0
    late = t > t[0] + 2.0  # motion in two directions distinguishes a turn from a mirror
    true = np.array([path_at(s)[0] for s in t[late]])
    off = np.array(place).T[late] - true
    assert np.ptp(true, axis=0).min() > 0.5
    assert np.ptp(off, axis=0).max() < 0.2


def test_a_flight_on_a_turned_source_lands_upright_and_blames_no_sensor() -> None:
    events = []
    mission = load_mission("demonstration")
    with Flight("mufly-1.1", mission, sensors="fitted", seed=2, outside=True, brief=True, keep=False) as flight:
        flight.autopilot.listeners.append(lambda e: events.append(e.text))
        source, rng, queue = flight.outside_fixes, np.random.default_rng(2), []
        assert source is not None

        def step() -> None:
            Flight.step_period(flight)
            truth, t = flight.truth, flight.time_s
            if flight.plant.period_count % 13 == 0:
                n, e, d = truth.position + 0.01 * rng.standard_normal(3)
                queue.append((t, np.array([-e, n, d, truth.attitude[2]])))
            while queue and queue[0][0] <= t - 0.2:
                source.submit_fix(t, *queue.pop(0), None)

        flight.step_period = flight.advance_until = lambda *_, **__: step()  # type: ignore[method-assign]
        assert await_estimate_and_start(flight) == ""
        while not flight.autopilot.software.finished and not flight.plant.crash_cause and flight.time_s < 40.0:
            step()
        outcome, reason = flight.judge_outcome()
        assert outcome == "failed"
        assert "position by link refused: it moves turned" in reason
        assert math.hypot(*flight.truth.velocity[:2]) < 0.05
        assert math.hypot(*flight.truth.attitude[:2]) < math.radians(5.0)
        assert flight.autopilot.list_arming_faults()
    assert not [text for text in events if "gyro" in text or "magnetometer" in text or "accelerom" in text[:20]]


def test_fixes_that_move_before_take_off_do_not_reach_the_filter() -> None:
    vehicle = load_vehicle("mufly-1.1")
    fixes, zero = ExternalFixes(vehicle), np.zeros(3)
    answers = []
    for k in range(90):
        t = k / 15
        still = {"acceleration": Reading(np.array([0.0, 0.0, -GRAVITY]), t), "rates": Reading(zero, t)}
        fixes.update_fix_monitor(Readings(t, still), Estimate(t, zero, zero, zero, zero), True)
        answers.append(fixes.submit_fix(t, t, np.array([0.06 * t, 0.0, 0.0, 0.0]), None))
    assert answers[0] == ""
    assert "while the vehicle stands" in answers[-1]
    fixes.reset()
    assert fixes.submit_fix(7.0, 7.0, np.zeros(4), None) == ""
