"""Failsafe actions on an uncertain estimate, smoothing of its corrections, and reports of sensor faults.

An estimator reports its uncertainty (covariance), whether its estimate is valid, and a status of each sensor. Failsafe
actions follow from uncertainty and validity; the statuses explain them:

================================================= ===================================================================
horizontal position uncertain by more than 0.25 m the mission waits in a hover; it resumes after 1 s below 0.15 m
horizontal position uncertain by more than 0.6 m, the vehicle lands at its position
or waiting for 10 s
height uncertain by more than 0.3 m for 0.3 s     the vehicle lands
roll or pitch uncertain by more than 8 degrees,   the vehicle descends with its servos at trim, where the stabiliser
or two independent attitude aids rejected         bar keeps a level attitude
for 0.15 s at once
heading uncertain by more than 30 degrees, or     the vehicle lands; without gyroscopes it uses the angular rates of
an impossible bias of the gyroscopes,             the rotor model, and from 3 cm above the floor its servos are at
or no gyroscopes for 0.1 s                        trim and its motors ramp down
================================================= ===================================================================

Uncertainties are standard deviations; that of the position is its growth since the vehicle left the floor. Sensor
statuses cause an action in two cases only: lost gyroscopes, because the attitude then depends on the rotor model; and
two independent aids that contradict the attitude, because the attitude is then wrong. Actions apply in the air. In
manual flight the pilot is informed and decides.

The controllers receive smoothed corrections (:class:`CorrectionSmoother`). Every measurement corrects the estimate by
a few millimetres, and heave control would answer a step of 1 cm with a fifth of the motors' range.

A sensor's fault is reported after about 0.2 s of missing, rejected or faulty readings, and its recovery after a second
of fusion. Single rejected readings are not reported: a counter rises with the time of a fault, and falls ten times as
slowly without one.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import sine_cosine
from mufly.estimate import Estimate, SensorStatus
from mufly.estimate.filter.filter_records import ERROR_ATTITUDE, ERROR_POSITION
from mufly.estimate.sensor_status import REASON_CAUSE_PREFIXES
from mufly.mission.machine.log_messages import LogTemplate
from mufly.quantities.sensor_table import CHECKED

_Array = NDArray[np.float64]

HOLD_POSITION_SIGMA_M, RESUME_POSITION_SIGMA_M, LAND_POSITION_SIGMA_M = 0.25, 0.15, 0.6
"""Horizontal standard deviations to hold, to resume (below) and to land (m)."""
RESUME_DELAY_S, MAX_HOLD_S = 1.0, 10.0
"""Time below ``RESUME_POSITION_SIGMA_M`` until the mission resumes, and longest hold (s)."""
MAX_HEIGHT_SIGMA_M, HEIGHT_UNCERTAIN_DELAY_S = 0.3, 0.3
"""Standard deviation of the height (m) that causes a landing, and its least duration (s).

At lift-off, vibration may clip the accelerometers; the height is then uncertain until the next reading of the sonar."""
GYRO_LOSS_DELAY_S, ATTITUDE_CONTRADICTION_DELAY_S = 0.1, 0.15
"""Longest loss of the gyroscopes, and longest contradiction of two attitude aids (s)."""
MAX_TILT_SIGMA_RAD, MAX_HEADING_SIGMA_RAD = math.radians(8.0), math.radians(30.0)

FAULT_REPORT_DELAY_S, RECOVERY_REPORT_DELAY_S = 0.2, 1.0
"""Time of a fault until its report, and time of fusion until the report of the recovery (s)."""
_FAULT_DECAY_RATE = 0.1

FailsafeAction = Literal["", "hold", "land", "sink"]


class HealthDecision(NamedTuple):
    """Failsafe action on an estimate ("": none), and its reason."""

    action: FailsafeAction = ""
    reason: str = ""


HEALTHY_DECISION = HealthDecision()

_SENSOR_BY_READING = {row.name: row.source for row in CHECKED}
_POSITION_READINGS, _HEIGHT_READINGS, _TILT_READINGS, _HEADING_READINGS = (
    tuple(row.name for row in CHECKED if estimate in row.supports)
    for estimate in ("position", "height", "tilt", "heading")
)
_INERTIAL_READINGS = ("acceleration", "rates")
_ATTITUDE_AIDS = tuple(row.name for row in CHECKED if row.is_attitude_aid)


def find_sensor_name(reading: str) -> str:
    """Return the name of the sensor that supplies a reading."""
    return _SENSOR_BY_READING.get(reading, reading.replace("_", " "))


def list_sensor_statuses(m: Estimate) -> Sequence[SensorStatus]:
    """Return the estimator's status of each sensor; empty for an ideal estimator."""
    return () if m.auxiliary_states is None else m.auxiliary_states.checks


def compute_added_position_std(m: Estimate, stood: float = 0.0) -> float:
    """Return the square root (m) of the growth of the position's variance since the vehicle stood on the floor.

    ``stood`` is the variance on the floor (m2).
    """
    variance = m.covariance.diagonal()
    return math.sqrt(max(float(variance[0]), float(variance[1]), stood) - stood)


def is_estimate_doubted(check: SensorStatus, checks: Sequence[SensorStatus]) -> bool:
    """Return whether the estimate itself may be wrong when a sensor is rejected.

    The estimate is based on the inertial unit and the rotor model. A rejected reading differs from the estimate, but
    the sensor is not the only possible cause while another attitude aid is rejected too, or while the inertial unit has
    a fault or differs from the rotor model.
    """
    return check.status == "rejected" and any(
        c.is_suspicious or c.status in ("rejected", "missing", "faulty")
        if c.name in _INERTIAL_READINGS
        else c.status == "rejected" and c.name in _ATTITUDE_AIDS and check.name not in _INERTIAL_READINGS
        for c in checks
        if c.name != check.name
    )


def describe_sensor_status(check: SensorStatus, checks: Sequence[SensorStatus] = ()) -> str:
    """Return a sensor's name, status and reason as text, or the possible causes if no single sensor is at fault.

    ``checks`` are the statuses of all sensors at that time.
    """
    if check.reason.startswith(REASON_CAUSE_PREFIXES):
        return check.reason
    if is_estimate_doubted(check, checks):
        others = "rotor model" if check.name in _INERTIAL_READINGS else "inertial unit or rotor model"
        joint = " or " if check.name in _INERTIAL_READINGS else ", "
        return f"{find_sensor_name(check.name)}{joint}{others}: {check.reason}"
    state = {"missing": "is missing", "rejected": "is rejected", "faulty": "is faulty"}
    if check.is_suspicious:
        state |= {"fused": "is used despite a fault", "waiting": "has a fault"}
    return f"{find_sensor_name(check.name)} {state.get(check.status, check.status)}" + (
        f": {check.reason}" if check.reason else ""
    )


def _format_fault_note(m: Estimate, sources: tuple[str, ...]) -> str:
    """Return a note in brackets on the faults of the readings named in ``sources``; "" without a fault."""
    wrong = [
        describe_sensor_status(c)
        for c in list_sensor_statuses(m)
        if c.name in sources and c.status in ("missing", "rejected", "faulty")
    ]
    return f" ({'; '.join(wrong)})" if wrong else ""


def judge_estimate(m: Estimate, stood: float = 0.0, *, height_counts: bool = True) -> HealthDecision:
    """Return the failsafe action for one estimate, without hysteresis.

    Parameters
    ----------
    m : Estimate
    stood : float
        Greatest variance of the horizontal position on the floor (m2). A vehicle without position sensors takes off
        with this uncertainty, and only its growth counts.
    height_counts : bool
        Whether an uncertain height has lasted for long enough to cause a landing.
    """
    if m.auxiliary_states is None:
        return HEALTHY_DECISION
    variance = m.covariance.diagonal()
    place, height = compute_added_position_std(m, stood), math.sqrt(variance[ERROR_POSITION + 2])
    tilt = math.sqrt(max(variance[ERROR_ATTITUDE], variance[ERROR_ATTITUDE + 1]))
    heading = math.sqrt(variance[ERROR_ATTITUDE + 2])
    if tilt > MAX_TILT_SIGMA_RAD:
        return HealthDecision(
            "sink", f"attitude uncertain by {math.degrees(tilt):.0f} deg{_format_fault_note(m, _TILT_READINGS)}"
        )
    if heading > MAX_HEADING_SIGMA_RAD:
        return HealthDecision(
            "land", f"heading uncertain by {math.degrees(heading):.0f} deg{_format_fault_note(m, _HEADING_READINGS)}"
        )
    rates = next((c for c in list_sensor_statuses(m) if c.name == "rates"), None)
    if rates is not None and rates.status == "rejected":
        return HealthDecision("land", describe_sensor_status(rates))
    if height > MAX_HEIGHT_SIGMA_M and height_counts:
        return HealthDecision("land", f"height uncertain by {height:.2f} m{_format_fault_note(m, _HEIGHT_READINGS)}")
    if place > HOLD_POSITION_SIGMA_M:
        why = f"position uncertain by {place:.2f} m{_format_fault_note(m, _POSITION_READINGS)}"
        return HealthDecision("land" if place > LAND_POSITION_SIGMA_M else "hold", why)
    return HEALTHY_DECISION


def is_gyro_unavailable(m: Estimate) -> bool:
    """Whether the gyroscopes are unusable, so that the angular rates come from the rotor model."""
    return any(c.name == "rates" and c.status in ("missing", "faulty", "rejected") for c in list_sensor_statuses(m))


@dataclass
class HealthMonitor:
    """Failsafe action with hysteresis, from a sequence of estimates.

    Attributes
    ----------
    verdict : HealthDecision
        Latest action.
    standing_position_variance_m2 : float
        Variance of the horizontal position on the floor (m2).
    """

    verdict: HealthDecision = HEALTHY_DECISION
    standing_position_variance_m2: float = 0.0
    _fault_since_s: dict[str, float] = field(default_factory=dict)
    _hold_since_s: float = math.nan
    _position_certain_since_s: float = math.nan
    _height_uncertain_since_s: float = math.nan

    def decide_failsafe(self, m: Estimate) -> HealthDecision:
        """Return the failsafe action for an estimate in the air; a hold ends when the position is certain again."""
        t = m.time_s
        if not math.sqrt(m.covariance[2, 2]) > MAX_HEIGHT_SIGMA_M:
            self._height_uncertain_since_s = math.nan
        elif math.isnan(self._height_uncertain_since_s):
            self._height_uncertain_since_s = t
        found = judge_estimate(
            m,
            self.standing_position_variance_m2,
            height_counts=t - self._height_uncertain_since_s >= HEIGHT_UNCERTAIN_DELAY_S,
        )
        apart = self._judge_attitude_sensors(m)
        if apart.action and found.action != "sink":
            found = apart
        if self.verdict.action in ("land", "sink"):
            return self.verdict if found.action != "sink" else self._set_decision(found)
        if found.action in ("land", "sink"):
            return self._set_decision(found)
        if found.action == "hold":
            self._position_certain_since_s = math.nan
            if self.verdict.action != "hold":
                self._hold_since_s = t
                return self._set_decision(found)
        elif self.verdict.action == "hold":
            if compute_added_position_std(m, self.standing_position_variance_m2) >= RESUME_POSITION_SIGMA_M:
                self._position_certain_since_s = math.nan
            elif math.isnan(self._position_certain_since_s):
                self._position_certain_since_s = t
            elif t - self._position_certain_since_s >= RESUME_DELAY_S:
                return self._set_decision(HEALTHY_DECISION)
        if self.verdict.action == "hold" and t - self._hold_since_s > MAX_HOLD_S:
            return self._set_decision(
                HealthDecision("land", f"{found.reason or self.verdict.reason}, for {MAX_HOLD_S:g} s")
            )
        return self.verdict

    def _judge_attitude_sensors(self, m: Estimate) -> HealthDecision:
        """Return the failsafe action on lost gyroscopes, or on attitude aids that contradict the estimate."""
        for c in list_sensor_statuses(m):
            bad = c.status in (("missing", "faulty") if c.name == "rates" else ("rejected",))
            if not bad:
                self._fault_since_s.pop(c.name, None)
            elif c.name == "rates" or c.name in _ATTITUDE_AIDS:
                self._fault_since_s.setdefault(c.name, m.time_s)
        lasting = {n: m.time_s - since for n, since in self._fault_since_s.items()}
        against = [n for n in _ATTITUDE_AIDS if lasting.get(n, 0.0) > ATTITUDE_CONTRADICTION_DELAY_S]
        if len(against) > 1:
            aids = " and ".join(find_sensor_name(n) for n in against)
            return HealthDecision("sink", LogTemplate.ATTITUDE_CONTRADICTED(aids))
        if lasting.get("rates", 0.0) > GYRO_LOSS_DELAY_S:
            return HealthDecision(
                "land", next(describe_sensor_status(c) for c in list_sensor_statuses(m) if c.name == "rates")
            )
        return HEALTHY_DECISION

    def _set_decision(self, found: HealthDecision) -> HealthDecision:
        self.verdict = found
        return found


CORRECTION_TIME_CONSTANT_S = 0.3
"""Time constant with which corrections of position and heading reach the controllers (s)."""
MAX_CORRECTION_SPEED_M_S, MAX_CORRECTION_TURN_RATE_RAD_S = 0.5, 0.5
"""Largest rates of these corrections."""


class CorrectionSmoother:
    """Smoother of position and heading, which removes the steps that the filter's corrections cause.

    Both move with the estimated velocity and yaw rate, and approach the estimate::

        x' = v + clip((x_est - x) / tau, +-v_max)

    Motion has no lag, and corrections take effect within a second.
    """

    def __init__(self) -> None:
        self._last: Estimate | None = None
        self._place = np.zeros(3)
        self._heading = 0.0

    def smooth_estimate(self, m: Estimate, *, anew: bool = False) -> Estimate:
        """Return the smoothed estimate for the controllers; ``anew`` resets it to ``m``."""
        last, self._last = self._last, m
        if anew or last is None or not 0.0 < m.time_s - last.time_s < 0.1:
            self._place, self._heading = m.position.copy(), float(m.attitude[2])
            return m
        self._place, attitude = _propagate_smoothed(
            self._place,
            self._heading,
            last.velocity,
            m.position,
            m.velocity,
            m.attitude,
            m.rates,
            m.time_s - last.time_s,
        )
        self._heading = float(attitude[2])
        return Estimate(
            m.time_s, self._place, m.velocity, attitude, m.rates, m.ranges, m.battery_voltage, m.covariance, m.valid,
            m.auxiliary_states,
        )  # fmt: skip


@cached_njit
def _propagate_smoothed(
    place: _Array,
    heading: float,
    before: _Array,
    position: _Array,
    velocity: _Array,
    attitude: _Array,
    rates: _Array,
    dt: float,
) -> tuple[_Array, _Array]:
    """Return smoothed position and attitude after ``dt`` (s); ``before`` is the velocity at the period's start."""
    moved, turned = np.empty(3), np.empty(3)
    for k in range(3):
        v = 0.5 * (before[k] + velocity[k])
        off = (position[k] - place[k] - dt * v) / CORRECTION_TIME_CONSTANT_S
        moved[k] = place[k] + dt * (v + min(max(off, -MAX_CORRECTION_SPEED_M_S), MAX_CORRECTION_SPEED_M_S))
    roll, pitch = attitude[0], attitude[1]
    sine, cosine = sine_cosine(roll)
    turn = (sine * rates[1] + cosine * rates[2]) / max(sine_cosine(pitch)[1], 0.1)
    away = (attitude[2] - heading - dt * turn) / CORRECTION_TIME_CONSTANT_S
    turned[0], turned[1] = roll, pitch
    turned[2] = heading + dt * (turn + min(max(away, -MAX_CORRECTION_TURN_RATE_RAD_S), MAX_CORRECTION_TURN_RATE_RAD_S))
    return moved, turned


@dataclass
class SensorEventReporter:
    """Converter of sensor statuses into log messages.

    Attributes
    ----------
    reported_status : dict
        Reported status of each reading with a reported fault.
    """

    reported_status: dict[str, str] = field(default_factory=dict)
    _fault_level: dict[str, float] = field(default_factory=dict)
    _fused_duration_s: dict[str, float] = field(default_factory=dict)
    _last_fault: dict[str, SensorStatus] = field(default_factory=dict)

    def has_nothing_to_report(self, checks: Sequence[SensorStatus]) -> bool:
        """Whether a step with these statuses changes nothing: no fault is present, building up or reported."""
        return (
            not self.reported_status
            and all(level <= 0.0 for level in self._fault_level.values())
            and all(c.status in ("fused", "waiting") and not c.is_suspicious for c in checks)
        )

    def collect_new_reports(
        self, checks: Sequence[SensorStatus], period_s: float, excused: Collection[str] = ()
    ) -> list[tuple[str, str]]:
        """Advance by one period; return (text, level) of every new report.

        A missing reading in ``excused`` is not reported.
        """
        said: list[tuple[str, str]] = []
        for check in checks:
            name = check.name
            if check.status == "missing" and name in excused:
                continue
            if check.is_suspicious or check.status in ("rejected", "missing", "faulty"):
                self._last_fault[name] = check
                self._fused_duration_s[name] = 0.0
                # A missing reading has already exceeded its timeout.
                more = 4.0 * period_s if check.status == "missing" else period_s
                level = self._fault_level[name] = min(
                    self._fault_level.get(name, 0.0) + more, FAULT_REPORT_DELAY_S + period_s
                )
                if level >= FAULT_REPORT_DELAY_S and name not in self.reported_status:
                    self.reported_status[name] = check.status
                    said.append((describe_sensor_status(check, checks), "warning"))
            elif check.status == "fused":
                level = self._fault_level.get(name, 0.0)
                if level > 0.0:
                    self._fault_level[name] = level - _FAULT_DECAY_RATE * period_s
                if name in self.reported_status:
                    self._fused_duration_s[name] += period_s
                    if self._fused_duration_s[name] >= RECOVERY_REPORT_DELAY_S:
                        del self.reported_status[name]
                        self._fault_level[name] = 0.0
                        said.append((f"{find_sensor_name(name)} is used again", "info"))
        return said


# Checks before take-off


def describe_missing_position_sensor(m: Estimate, reach_m: float) -> str:
    """Return a warning if no sensor will measure the horizontal position in flight; "" otherwise.

    Parameters
    ----------
    m : Estimate
        Estimate on the floor.
    reach_m : float
        Range of the laser ring (m).
    """
    checks = {c.name: c for c in list_sensor_statuses(m)}
    if not checks:
        return ""
    fix, ring = checks.get("position_fix"), checks.get("ranges")
    fixed = fix is not None and fix.status == "fused"
    walls = ring is not None and bool(np.any(m.ranges < reach_m))
    lines = []
    if not fixed and not walls:
        why = (
            "no position fix on board"
            if fix is None
            else describe_sensor_status(fix)
            if fix.status != "waiting"
            else "no position fix"
        )
        seen = "no laser ring" if ring is None else f"no wall within the {reach_m:g} m of the lasers"
        lines.append(
            f"no sensor measures the horizontal position: {why}, {seen}; in flight drag and rotor model "
            "predict the position until it is too uncertain, then the vehicle lands"
        )
    return "; ".join(lines)
