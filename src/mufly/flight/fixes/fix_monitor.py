r"""Checks of external position fixes against the inertial unit, before they reach the filter.

The inertial unit alone gives the path over some seconds up to an unknown parabola in time: errors of tilt, bias and
start are constant over that time. With N + i E as complex numbers, A the second integral of the measured acceleration
and V its first, fixes P at the times t follow over a window of :data:`PATH_WINDOW_S`

    P = c0 + c1 t + c2 t^2 + b B + m A + n conj(A) - d V.

B is the second integral of e^(i psi), the direction of the nose: an error of the accelerometers turns with the vehicle.
For a mirrored source conj(B) replaces it.

| source | m | n | d |
|---|---|---|---|
| correct | 1 | 0 | 0 |
| axes turned by a against its heading | e^(i a) | 0 | 0 |
| scaled by s | s | 0 | 0 |
| mirrored, or north and east exchanged | 0 | of size 1 | 0 |
| late by d | 1 | 0 | d |

Each row is fitted alone. The best fit names the fault under two conditions: the residual of a correct source exceeds
:data:`_REPORT_RESIDUAL_RATIO` times the usual drift, and that of the fault is at most the share
:data:`_MAX_UNEXPLAINED_FRACTION` of it. The controller follows the drift of a source, and the drift then looks like a
lag, so the residual for a lag must be :data:`_LAG_RESIDUAL_FACTOR` times as large. An error of scale whose effect in
one window is below the drift is found by a long fit over :data:`_LONG_FIT_MEMORY_S`. A steady drift of a source in
flight is not found: it is a part of the parabola.

The heading is checked against the integrated gyroscopes, whose offset is adapted slowly. In a turn a lagging heading
shows the delay d long before the path does: psi(t) = psi_gyro(t - d) is fitted over d. While the motors are off, the
source must not move; the tilt and the bias of the gyroscopes are measured then.

A fault must last :data:`_FAULT_CONFIRMING_FIXES` fixes. Fixes are withheld from a residual of
:data:`_WITHHOLD_RESIDUAL_RATIO` times the drift, so that the filter does not follow a source that is about to be
refused, and for :data:`_WITHHOLD_AFTER_JUMP_S` after a jump. A refused source is accepted again after
:data:`REACCEPTANCE_TIME_S` of flight in which it agrees, or of rest if it moved at rest. When a source is refused, the
filter's velocity is already wrong and would stay so until touchdown. The motion of a refused source is therefore
corrected for the landing (:meth:`FixMonitor.correct_fix`). The specific force contains drag and wind, so the checks
need no rotor model. Own derivation.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import body_to_ned_matrix
from mufly.estimate import Estimate
from mufly.rotations import quaternion_from_euler
from mufly.sensors import Readings

_Array = NDArray[np.float64]
PATH_WINDOW_S, REACCEPTANCE_TIME_S = 5.0, 10.0
_MIN_FIT_SPAN_S, _MIN_FIT_FIX_COUNT = 1.2, 12
"""Least span (s) and number of fixes for a fit."""
_WITHHOLD_RESIDUAL_RATIO, _REPORT_RESIDUAL_RATIO, _LAG_RESIDUAL_FACTOR = 0.8, 1.2, 1.5
_MAX_UNEXPLAINED_FRACTION, _FAULT_CONFIRMING_FIXES = 0.45, 6
_SMALL_MOTION_RATIO, _SMALL_MOTION_RESIDUAL_FACTOR = 0.6, 4.0
"""Residuals over the usual drift from which fixes are withheld and the fault is reported. For sources that lag or move
less than :data:`_SMALL_MOTION_RATIO` times as far, both are larger by a factor. Largest share of the residual that the
fault leaves; number of fixes that confirm a fault."""
_MAX_HEADING_DIFFERENCE_RAD, _HEADING_DRIFT_TIME_S = math.radians(20.0), 30.0
"""Largest difference of heading and integrated gyroscopes (rad), and time constant of their slow drift (s)."""
_MAX_TRIED_HEADING_DELAY_S, _MIN_REPORTED_DELAY_S, _HEADING_WINDOW_S, _MIN_HEADING_LAG_RAD = (
    0.8,
    0.12,
    3.0,
    math.radians(2.5),
)
_TRIED_HEADING_DELAYS_S = np.arange(0.0, _MAX_TRIED_HEADING_DELAY_S, 0.04)
"""Fit of the heading's delay: largest delay tried, least delay reported, window (s), and least rms difference from the
gyroscopes (rad)."""
_WITHHOLD_HEADING_CHANGE_RAD = math.radians(3.0)
"""Change of the heading against the gyroscopes within a second from which fixes are withheld (rad)."""
_LONG_FIT_WINDOW_STEP_S, _LONG_FIT_MEMORY_S, _LONG_FIT_CORRELATED_FIXES, _LONG_FIT_REPORT_SIGMAS = 2.5, 60.0, 30.0, 3.5
"""Long fit: step between windows and memory (s), number of fixes with correlated errors, deviations until a report."""
_LONG_FIT_MIN_RMS_RATIO = 0.15  # least rms residual of the long fit, over the usual drift
_LONG_FIT_MIN_SCALE_ERROR, _LONG_FIT_MAX_AXIS_TURN_RAD = 0.2, math.radians(20.0)
"""Least error of scale that the long fit reports, and largest turn of the axes (rad) at which the fault is a scale."""
_REST_CHECK_WINDOW_S, _MAX_REST_SPEED_M_S = 4.0, 0.04
_MIN_JUMP_M, _MAX_SPEED_M_S, _WITHHOLD_AFTER_JUMP_S = 0.3, 2.0, 4.0
"""Change between two fixes that counts as a jump: a length (m), and a speed (m/s) that no flight has; time for which
fixes are withheld after a jump (s)."""
_MIN_TURN_EFFECT_S2 = 0.005  # rms of B beside a parabola, below which the nose did not turn (s^2)
_WITHHELD_TEXT = "it is withheld: "
_HEADING_LAG_TEXT = "its heading does not follow the measured turn rate"
_TILT_CORRECTION_TIME_S, _REST_AVERAGE_S = 20.0, 1.0


@dataclass(frozen=True)
class PathFit:
    """Comparison of the fixes in a window with the path of the inertial unit, for each kind of fault.

    A parabola in time is removed from both.

    Attributes
    ----------
    healthy_rms_m : float
        Root mean square of the differences for a correct source (m).
    motion_rms_m : float
        Root mean square of the path itself (m).
    rms_m : dict
        Root mean squares of the differences for a source "turned", "mirrored", "scaled" or "late" (m).
    rotation_factor : complex
        m of a turned source; its real part is that of a scaled one.
    mirror_factor : complex
        n of a mirrored source.
    delay_s : float
        d of a late source.
    """

    healthy_rms_m: float
    motion_rms_m: float
    rms_m: dict[str, float]
    rotation_factor: complex
    mirror_factor: complex
    delay_s: float


@dataclass(frozen=True)
class FixCorrection:
    """Correction of a faulty source's fixes, so that they show the true motion.

    Attributes
    ----------
    factor : complex
        Correct over measured motion.
    is_mirrored : bool
        Whether the corrected motion is conjugated.
    delay_s : float
        Delay to subtract from the times of the fixes.
    """

    factor: complex
    is_mirrored: bool = False
    delay_s: float = 0.0


class CorrectedPath:
    """Path of a source's fixes with its fault removed, from a known position on.

    Parameters
    ----------
    measured, begin : complex
        Fix and true position at the beginning, N + i E (m).
    """

    def __init__(self, measured: complex, begin: complex) -> None:
        self.measured, self.position = measured, begin

    def correct_next_fix(self, measured: complex, correction: FixCorrection) -> complex:
        """Return the corrected position (N + i E, m) of the next fix."""
        moved = correction.factor * (measured - self.measured)
        self.measured = measured
        self.position += moved.conjugate() if correction.is_mirrored else moved
        return self.position


_PATH_FIT_WITHOUT_DATA = PathFit(0.0, 0.0, {"turned": 0.0}, 1.0 + 0.0j, 0j, 0.0)


class FixMonitor:
    """Checks of one source of fixes.

    Parameters
    ----------
    drift_m : float
        Standard deviation of the source's usual drift (m).

    Attributes
    ----------
    path_fit : PathFit
        Fit of the latest window.
    long_fit : (complex, float) tuple
        m over many windows, and its standard deviation along one axis.
    fault : str
        Fault for which the source is refused, or "".
    """

    def __init__(self, drift_m: float) -> None:
        self._withhold_m, self._report_m = _WITHHOLD_RESIDUAL_RATIO * drift_m, _REPORT_RESIDUAL_RATIO * drift_m
        self._least_variance_m2 = (_LONG_FIT_MIN_RMS_RATIO * drift_m) ** 2
        self.reset()

    def reset(self) -> None:
        """Discard all fixes, fits and faults."""
        self._time_s = math.nan
        self._turn: _Array = np.eye(3)  # body to N-E-D
        self._rest_force, self._rest_rates, self._rest_weight = np.zeros(3), np.zeros(3), 0.0
        self._is_resting = True
        self._speed = self._path = 0j
        self._bias_speed = self._bias_path = 0j
        self._history: deque[tuple[float, complex, complex, complex, float]] = deque()  # time, A, V, B, heading
        self._fixes: deque[tuple[float, complex, complex, complex, complex]] = deque()  # time, P, A, V, B
        self._rest_fixes: deque[tuple[float, complex]] = deque()
        self._heading_offset = math.nan
        self._headings: deque[tuple[float, float, float]] = deque()  # time, heading, that of the gyroscopes
        self.heading_fit = (0.0, 0.0, 0.0)
        self._candidate, self._count, self._sure_count = "", 0, 0
        self._settled_s = -math.inf
        self.fault, self._agreed_s, self._last_s = "", 0.0, math.nan
        self.path_fit = _PATH_FIT_WITHOUT_DATA
        self._long_s, self._long_sums, self.long_fit = -math.inf, np.zeros(4, complex), (1.0 + 0j, math.inf)
        self._correction: FixCorrection | None = None
        self._corrected_path = CorrectedPath(0j, 0j)  # of a refused source
        self._estimate: tuple[complex, complex] = 0j, 0j  # place and velocity

    def propagate_inertial_path(self, readings: Readings, estimate: Estimate, is_resting: bool) -> None:
        """Propagate the path of the inertial unit by its latest readings.

        Parameters
        ----------
        readings : Readings
        estimate : Estimate
            The filter's latest estimate. Its heading is used at rest; its tilt corrects the monitor's tilt slowly,
            while the source is accepted.
        is_resting : bool
            Whether the motors are off.
        """
        t, latest = readings.time_s, readings.latest
        dt = t - self._time_s
        self._time_s = t
        self._estimate = complex(*estimate.position[:2]), complex(*estimate.velocity[:2])
        force, rates = latest.get("acceleration"), latest.get("rates")
        if force is None or rates is None or not (force.valid and rates.valid) or not 0.0 < dt < 0.1:
            return
        if is_resting:
            if not self._is_resting:
                self._fixes.clear()
            self._average_readings_at_rest(force.value, rates.value, dt, float(estimate.attitude[2]))
        else:
            w = (rates.value - self._rest_rates) * dt
            cross = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
            self._turn = self._turn @ (np.eye(3) + cross + 0.5 * cross @ cross)
            if estimate.valid and not self.fault and not self._candidate:
                self._correct_integrated_tilt(estimate, dt / _TILT_CORRECTION_TIME_S)
            n, e, _ = self._turn @ force.value
            acceleration = complex(n, e)
            self._path += dt * (self._speed + 0.5 * dt * acceleration)
            self._speed += dt * acceleration
            forward = complex(self._turn[0, 0], self._turn[1, 0])
            self._bias_path += dt * self._bias_speed
            self._bias_speed += dt * forward / abs(forward)
        self._is_resting = is_resting
        heading = math.atan2(self._turn[1, 0], self._turn[0, 0])
        self._history.append((t, self._path, self._speed, self._bias_path, heading))
        while self._history[0][0] < t - 1.5:
            self._history.popleft()

    def _average_readings_at_rest(self, force: _Array, rates: _Array, dt: float, heading: float) -> None:
        """Average the readings at rest; they give the tilt and the gyroscopes' bias."""
        share = dt / _REST_AVERAGE_S
        self._rest_weight += share * (1.0 - self._rest_weight)
        share /= self._rest_weight
        self._rest_force = self._rest_force + share * (force - self._rest_force)
        self._rest_rates = self._rest_rates + share * (rates - self._rest_rates)
        x, y, z = self._rest_force
        roll, pitch = math.atan2(-y, -z), math.atan2(x, math.hypot(y, z))
        self._turn = body_to_ned_matrix(quaternion_from_euler(roll, pitch, heading))
        self._speed = self._path = self._bias_speed = self._bias_path = 0j

    def _correct_integrated_tilt(self, estimate: Estimate, share: float) -> None:
        """Correct the integrated tilt by ``share`` towards that of the filter, and make the rotation matrix
        orthogonal.
        """
        roll, pitch, _ = estimate.attitude
        down = np.array([-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)])
        third = self._turn[2] + share * (down - self._turn[2])
        third = third / math.sqrt(float(third @ third))
        first = self._turn[0] - (self._turn[0] @ third) * third
        first = first / math.sqrt(float(first @ first))
        self._turn = np.stack([first, np.cross(third, first), third])

    def find_fix_refusal(self, time_s: float, place: _Array) -> str:
        """Return the reason for which a fix is refused; "" if it is accepted.

        Parameters
        ----------
        time_s : float
            Time of the fix (s).
        place : (4,) array
            N, E, D (m), heading (rad).
        """
        fault, is_sure, is_known = self._assess_fix(time_s, place)
        gap = time_s - self._last_s
        self._last_s = time_s
        if fault:
            self._count += 1
            self._sure_count = self._sure_count + 1 if is_sure else 0
            self._candidate, self._agreed_s = fault, 0.0
            if self._sure_count >= _FAULT_CONFIRMING_FIXES:
                self._refuse_source(time_s, complex(*place[:2]), fault)
        else:
            self._candidate, self._count, self._sure_count = "", 0, 0
            if self.fault and is_known and 0.0 < gap < 0.5:
                self._agreed_s += gap
                self._correction = None
                if self._agreed_s >= REACCEPTANCE_TIME_S:
                    self.fault = ""
        if self.fault:
            return self.fault
        if time_s < self._settled_s:
            return f"{_WITHHELD_TEXT}it has jumped"
        return f"{_WITHHELD_TEXT}{self._candidate}" if self._count > 2 or fault == _HEADING_LAG_TEXT else ""

    def _refuse_source(self, time_s: float, place: complex, fault: str) -> None:
        """Refuse the source because of ``fault``; :meth:`correct_fix` then corrects its motion, if the fault allows it.

        The corrected path begins at the filter's present position.
        """
        if self._correction is None:
            self._corrected_path = self.begin_corrected_path(time_s, place)
        self.fault = fault
        self._correction = self._find_correction() or self._correction

    def begin_corrected_path(self, time_s: float, place: complex) -> CorrectedPath:
        """Return a path that begins at the filter's position at the time (s) of a fix ``place`` (N + i E, m)."""
        now, velocity = self._estimate
        return CorrectedPath(place, now - (self._time_s - time_s) * velocity)

    def _find_correction(self) -> FixCorrection | None:
        """Return the correction of the fault that the path shows; None without a fault that can be corrected."""
        fit = self.path_fit
        match self._classify_path_fault(self._report_m):
            case "turned":
                return FixCorrection(1.0 / fit.rotation_factor)
            case "mirrored":
                return FixCorrection(1.0 / fit.mirror_factor, is_mirrored=True)
            case "scaled":
                return FixCorrection(1.0 / complex(fit.rotation_factor.real))
            case "late":
                return FixCorrection(1.0 + 0j, delay_s=fit.delay_s)
        return FixCorrection(1.0 / abs(self.long_fit[0]) + 0j) if self._find_long_fit_scale_fault() else None

    def correct_fix(self, time_s: float, place: _Array) -> tuple[float, _Array] | None:
        """Return time and position of a refused source's fix with the fault removed; None for an unknown fault.

        The first corrected position equals the filter's estimate at the refusal; later ones add the corrected motion.
        """
        if not self.fault or self._correction is None or self._is_resting:
            return None
        here = self._corrected_path.correct_next_fix(complex(*place[:2]), self._correction)
        return time_s - max(self._correction.delay_s, 0.0), np.array([here.real, here.imag, *place[2:]])

    @staticmethod
    def _fault_kind(fault: str) -> str:
        return "".join(c for c in fault if c.isalpha())

    def _assess_fix(self, time_s: float, place: _Array) -> tuple[str, bool, bool]:
        """Return the fault of a fix ("" if none), whether it is certain, and whether the fix counts for
        re-acceptance.
        """
        if not self._history or time_s < self._history[0][0]:
            return "", False, False
        north, east, _, heading = place
        if self._is_resting:
            fault = self._check_motion_at_rest(time_s, complex(north, east))
            *_, own_heading = self._history[-1]
            self._heading_offset = heading - own_heading
            return (
                fault,
                True,
                bool(self._rest_fixes) and self._fault_kind(self.fault) == self._fault_kind(_motion_at_rest_text(0.0)),
            )
        self._rest_fixes.clear()
        k = len(self._history) - 1
        while k > 0 and self._history[k][0] > time_s:
            k -= 1
        _, path, speed, bias, yaw = self._history[k]
        fix = time_s, complex(north, east), path, speed, bias
        if self._fixes and self._is_jump(fix):
            self._fixes.clear()
            self._settled_s = time_s + _WITHHOLD_AFTER_JUMP_S
        self._fixes.append(fix)
        while self._fixes[0][0] < time_s - PATH_WINDOW_S:
            self._fixes.popleft()
        self._fit_heading_delay(time_s, heading, yaw)
        if fault := self._find_heading_delay_fault() or self._check_heading_drift(heading - yaw):
            return fault, True, False
        if self._contradicts_gyroscopes(time_s):
            return _HEADING_LAG_TEXT, False, False
        self._fit_path()
        fit, fault = self.path_fit, self._judge_path(self._report_m) or self._find_long_fit_scale_fault()
        agrees = fit.motion_rms_m > self._report_m and fit.healthy_rms_m < _MAX_UNEXPLAINED_FRACTION * fit.motion_rms_m
        return fault or self._judge_path(self._withhold_m), bool(fault), agrees

    def _is_jump(self, fix: tuple[float, complex, complex, complex, complex]) -> bool:
        """Return whether a fix is farther from the last one than the vehicle can fly."""
        last = self._fixes[-1]
        return abs(fix[1] - last[1]) > _MIN_JUMP_M + _MAX_SPEED_M_S * (fix[0] - last[0])

    def _check_motion_at_rest(self, time_s: float, place: complex) -> str:
        """Return the fault of a source that moves while the vehicle stands."""
        self._rest_fixes.append((time_s, place))
        while self._rest_fixes[0][0] < time_s - _REST_CHECK_WINDOW_S:
            self._rest_fixes.popleft()
        t = np.array([f[0] for f in self._rest_fixes])
        if len(t) < _MIN_FIT_FIX_COUNT or t[-1] - t[0] < 0.8 * _REST_CHECK_WINDOW_S:
            return ""
        t = t - t.mean()
        speed = abs(complex(t @ np.array([f[1] for f in self._rest_fixes]))) / float(t @ t)
        return _motion_at_rest_text(speed) if speed > _MAX_REST_SPEED_M_S else ""

    def _check_heading_drift(self, offset: float) -> str:
        if math.isnan(self._heading_offset):
            self._heading_offset = offset
        off = math.remainder(offset - self._heading_offset, 2 * math.pi)
        if abs(off) > _MAX_HEADING_DIFFERENCE_RAD:
            return f"its heading turns by {math.degrees(off):.0f} degrees against the gyroscopes"
        step = off / (15.0 * _HEADING_DRIFT_TIME_S)  # the gyroscopes drift: follow the source's heading slowly
        c, s = math.cos(step), math.sin(step)
        self._turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ self._turn
        return ""

    def _fit_heading_delay(self, time_s: float, heading: float, yaw: float) -> None:
        """Fit the delay of the source by its heading, against the integrated turn rate of the inertial unit."""
        if self._headings:
            *_, last, last_yaw = self._headings[-1]
            heading = last + math.remainder(heading - last, 2 * math.pi)
            yaw = last_yaw + math.remainder(yaw - last_yaw, 2 * math.pi)
        self._headings.append((time_s, heading, yaw))
        while self._headings[0][0] < time_s - PATH_WINDOW_S:
            self._headings.popleft()
        t, y, own = (np.array(c) for c in zip(*self._headings, strict=True))
        self.heading_fit = (0.0, 0.0, 0.0)
        if len(t) >= _MIN_FIT_FIX_COUNT and t[-1] - t[0] > _MIN_FIT_SPAN_S + _MAX_TRIED_HEADING_DELAY_S:
            used = (t > t[0] + _MAX_TRIED_HEADING_DELAY_S) & (t > t[-1] - _HEADING_WINDOW_S)
            rms = [float(np.std(y[used] - np.interp(t[used] - d, t, own))) for d in _TRIED_HEADING_DELAYS_S]
            best = int(np.argmin(rms))
            self.heading_fit = rms[0], rms[best], float(_TRIED_HEADING_DELAYS_S[best])

    def _find_heading_delay_fault(self) -> str:
        """Return the delay fault of a source whose heading lags behind the gyroscopes; "" without one."""
        off, left, delay = self.heading_fit
        explains = (
            off > _MIN_HEADING_LAG_RAD and left < _MAX_UNEXPLAINED_FRACTION * off and delay > _MIN_REPORTED_DELAY_S
        )
        return _delay_fault_text(delay) if explains else ""

    def _contradicts_gyroscopes(self, time_s: float) -> bool:
        """Return whether the fixes' heading has changed within a second differently from the integrated gyroscopes."""
        recent = [heading - own for t, heading, own in self._headings if t > time_s - 1.0]
        return abs(recent[-1] - float(np.median(recent))) > _WITHHOLD_HEADING_CHANGE_RAD

    def _fit_path(self) -> None:
        """Compare the fixes in the window with the inertial path for each kind of fault, and set ``path_fit``.

        The kinds are the rows of the table in the module's docstring.
        """
        self.path_fit = _PATH_FIT_WITHOUT_DATA
        t, place, path, speed, bias = (np.array(c) for c in zip(*self._fixes, strict=True))
        span = float(t[-1] - t[0])
        if len(t) < _MIN_FIT_FIX_COUNT or span < _MIN_FIT_SPAN_S:
            return
        u = (t - t.mean()) / span
        q, _ = np.linalg.qr(np.stack([np.ones_like(u), u, u * u], axis=1))
        y, a, v, b = (c - q @ (q.T @ c) for c in (place, path, speed, bias))
        mirror_y = y
        if (size := float(np.vdot(b, b).real)) > len(t) * _MIN_TURN_EFFECT_S2**2:
            mirror_y = y - b.conj() * (np.vdot(b.conj(), y) / size)
            y, a, v = (c - b * (np.vdot(b, c) / size) for c in (y, a, v))
        if t[-1] > self._long_s + _LONG_FIT_WINDOW_STEP_S and span > 0.9 * PATH_WINDOW_S:
            self._long_s = float(t[-1])
            self._add_window_to_long_fit(y, a)
        off = y - a
        square = float(np.vdot(a, a).real) + 1e-9
        turn, mirror = complex(np.vdot(a, y)) / square, complex(np.vdot(a.conj(), mirror_y)) / square
        delay = -float(np.vdot(v, off).real) / (float(np.vdot(v, v).real) + 1e-9)
        each = {
            "turned": y - turn * a,
            "mirrored": mirror_y - mirror * a.conj(),
            "scaled": y - turn.real * a,
            "late": off + delay * v,
        }
        rms = {name: _root_mean_square(r) for name, r in each.items()}
        self.path_fit = PathFit(_root_mean_square(off), _root_mean_square(a), rms, turn, mirror, delay)

    def _add_window_to_long_fit(self, y: NDArray[np.complexfloating], a: NDArray[np.complexfloating]) -> None:
        """Add a window to the long-term fit ``y = m a`` of fixes to the inertial path; update m and its standard
        deviation.
        """
        self._long_sums *= math.exp(-_LONG_FIT_WINDOW_STEP_S / _LONG_FIT_MEMORY_S)
        self._long_sums += [np.vdot(a, a), np.vdot(a, y), np.vdot(y, y), len(a)]
        square, product, total, count = self._long_sums
        m = complex(product / square)
        noise = max(self._least_variance_m2, float((total - abs(product) ** 2 / square).real) / float(count.real))
        self.long_fit = m, math.sqrt(_LONG_FIT_CORRELATED_FIXES * noise / (2.0 * float(square.real)))

    def _find_long_fit_scale_fault(self) -> str:
        """Return the scale fault of a source whose error of scale is too small for a single window; "" without one."""
        m, sigma = self.long_fit
        off = abs(abs(m) - 1.0)
        is_wrong = (
            off > max(_LONG_FIT_MIN_SCALE_ERROR, _LONG_FIT_REPORT_SIGMAS * sigma)
            and abs(cmath.phase(m)) < _LONG_FIT_MAX_AXIS_TURN_RAD
        )
        return _scale_fault_text(abs(m)) if is_wrong else ""

    def _classify_path_fault(self, least_m: float) -> str:
        """Return the fault that best explains the fixes in the window: "late", "scaled", "turned" or "mirrored".

        Return "" if the fixes fit a correct source to less than ``least_m`` (m rms), or if no fault explains them.
        """
        fit = self.path_fit
        if fit.healthy_rms_m < least_m:
            return ""
        best = min(fit.rms_m, key=lambda name: fit.rms_m[name])
        if fit.rms_m[best] > _MAX_UNEXPLAINED_FRACTION * fit.healthy_rms_m:
            return ""
        simple = [name for name in ("late", "scaled") if fit.rms_m[name] < 1.3 * fit.rms_m[best]]
        kind = min(simple, key=lambda name: fit.rms_m[name]) if simple else best
        scale = fit.rotation_factor.real
        size = {"late": 0.0, "scaled": scale, "turned": abs(fit.rotation_factor), "mirrored": abs(fit.mirror_factor)}[
            kind
        ]
        lags = size < (_SMALL_MOTION_RATIO if kind in ("turned", "mirrored") else 1.0)
        return "" if lags and fit.healthy_rms_m < _LAG_RESIDUAL_FACTOR * least_m else kind

    def _judge_path(self, least_m: float) -> str:
        """Return the fault of the fixes in the window as a text; "" without one (:meth:`_classify_path_fault`)."""
        fit, kind = self.path_fit, self._classify_path_fault(least_m)
        if not kind:
            return ""
        scale, both = fit.rotation_factor.real, (fit.rms_m["turned"], fit.rms_m["mirrored"])
        if kind in ("turned", "mirrored") and sum(both) < _SMALL_MOTION_RESIDUAL_FACTOR * min(both):
            return "it moves turned or mirrored against the accelerometers: check the sign and order of its axes"
        match kind:
            case "late":
                return _delay_fault_text(fit.delay_s)
            case "scaled" if scale > 0.0:
                return _scale_fault_text(scale)
            case "mirrored":
                return "it moves mirrored against the accelerometers: check the sign and order of its axes"
        return _rotation_fault_text(fit.rotation_factor)


def _root_mean_square(a: NDArray[np.complexfloating]) -> float:
    return math.sqrt(float(np.vdot(a, a).real) / len(a))


def _scale_fault_text(scale: float) -> str:
    return f"it moves {scale:.2f} times as far as measured by the accelerometers"


def _rotation_fault_text(turn: complex) -> str:
    degrees = math.degrees(cmath.phase(turn))
    return f"its axes are turned by {degrees:.0f} degrees against the accelerometers: check its frame"


def _delay_fault_text(delay_s: float) -> str:
    early = "later" if delay_s > 0.0 else "earlier"
    return f"it is {abs(1e3 * delay_s):.0f} ms {early} than its times, against the inertial unit"


def _motion_at_rest_text(speed_m_s: float) -> str:
    return f"it moves by {100 * speed_m_s:.0f} cm/s while the vehicle stands"
