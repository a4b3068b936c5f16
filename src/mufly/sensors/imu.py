"""The inertial unit: what three accelerometers and three gyroscopes on a shaking board say.

An accelerometer feels specific force, all that acts but gravity (body axes, at the place r of the element):

    f = R^T (dv/dt - g e_D) + dw/dt x r + w x (w x r)

The mean over a period of the flight software needs no model of forces: dv/dt is the change of velocity over it, so
that what the floor, a gust or a collision does is in it. On top shakes the board: rotor k adds along a direction e_k

    A_1 cos(th + p_1) + A_2 cos(2 th + p_2),      th its azimuth (imbalance; two blades),

and blades that pass each other A_p cos(2 (th_up + th_dw) + p_p). Forces grow with the square of the speed and go
through the board's resonance, |H(w)| with H = 1 / (1 - (w / w_r)^2 + 2 j zeta w / w_r); the file gives A at the hover
speed.

At the element, every ``sample_period`` (8 kHz): axes off by scale and misalignment, bias = switching on + wandering
(first order Gauss-Markov: d b = -b dt / tau + sigma sqrt(2 dt / tau) n) + warming of the board, white noise of
density N (standard deviation N sqrt(f_s / 2)); gyroscopes also feel acceleration. Then it *clips*, and only then a
second-order Butterworth filter takes out what the processor must not see; its output is what is read. A shaking that
is lopsided (2/rev in step with 1/rev) so becomes, by clipping, an acceleration that is not there: the false tilt of
Sec. 2.1.2.

Sources: IEEE Std 952 and 1293 for the error terms; Groves, Principles of GNSS, Inertial and Multisensor Integrated
Navigation Systems, 2nd ed., ch. 4; own derivation for the shaking. Thesis: Fig. 2.6.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.dynamics import rotation, trim
from mufly.sensors.readings import Reading, Sensor, Truth
from mufly.units import GRAVITY
from mufly.vehicle import Vehicle
from mufly.vehicle.sensing import Imu as ImuTable
from mufly.vehicle.sensing import Vibration

_Array = NDArray[np.float64]
_ELEVATION = math.asin(math.sqrt(1 / 3))  # of the shaking above the horizon: all axes share alike
ROOM_K = 293.15
_LINES = 5  # once and twice of both rotors, and the passing of blades


class Imu(Sensor):
    """Reads ``acceleration`` (m/s^2), ``rates`` (rad/s), ``clipping`` (share of samples, an axis), ``temperature``.

    Parameters
    ----------
    table : mufly.vehicle.sensing.Imu
    vehicle : Vehicle
    rng : numpy.random.Generator
        All that is random: errors of this unit, directions and phases of the shaking, noise.
    hover_rad_s : (2,) array, optional
        Rotor speeds for which the file gives the shaking; by default those of the trimmed vehicle.
    """

    def __init__(
        self, table: ImuTable, vehicle: Vehicle, rng: np.random.Generator, hover_rad_s: _Array | None = None
    ) -> None:
        imu = table
        self._rng, self._imu = rng, imu
        self._hover = np.asarray(trim(vehicle).state[18:20] if hover_rad_s is None else hover_rad_s)
        self._place = imu.place.array()[0]
        self._dt = float(imu.sample_period)
        density = np.repeat([float(imu.accelerometer_noise), float(imu.gyro_noise)], 3)
        self._white = density * math.sqrt(0.5 / self._dt)
        self._limit = np.repeat([float(imu.accelerometer_range), float(imu.gyro_range)], 3)
        self._range = self._limit.copy()
        self._filter = butterworth(float(imu.bandwidth), self._dt)
        # What this unit is like, for good
        self._axes = np.stack([_axes(rng, float(imu.scale_error), float(imu.misalignment)) for _ in range(2)])
        on = np.repeat([float(imu.accelerometer_bias), float(imu.gyro_bias)], 3)
        heat = np.repeat([float(imu.accelerometer_temperature), float(imu.gyro_temperature)], 3)
        self.switched_on = on * rng.standard_normal(6)
        self._heat = heat * rng.standard_normal(6)
        self._feigned = float(imu.gyro_g_sensitivity) * rng.standard_normal((3, 3))
        azimuth = rng.uniform(0.0, 2 * math.pi, 3)
        level = math.cos(_ELEVATION)
        e = np.column_stack(
            [level * np.cos(azimuth), level * np.sin(azimuth), np.full(3, math.sin(_ELEVATION))]
        )
        self._directions = np.ascontiguousarray(e[[0, 0, 1, 1, 2]])
        self._phases = rng.uniform(0.0, 2 * math.pi, _LINES)
        self.reset()

    def reset(self) -> None:
        drift = np.repeat([float(self._imu.accelerometer_drift), float(self._imu.gyro_drift)], 3)
        self._drift, self._wander = drift, drift * self._rng.standard_normal(6)
        self._azimuth = self._rng.uniform(0.0, 2 * math.pi, 2)
        self._memory = np.zeros((6, 2))
        self._before: Truth | None = None
        self._force_now = np.zeros(3)
        self._last: Mapping[str, Reading] = {}

    @property
    def bias(self) -> _Array:
        """Of accelerometers (m/s^2) and gyroscopes (rad/s) now, but for warming: what an estimator looks for (6,)."""
        return self.switched_on + self._wander

    def clip_at(self, limit_m_s2: float | None) -> None:
        """Let the accelerometers clip at another limit (a fault); None for their own."""
        self._limit[:3] = self._range[:3] if limit_m_s2 is None else limit_m_s2

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        before, self._before = self._before, truth
        if before is None:
            first = self._force_now = self._force(truth, np.zeros(3), np.zeros(3))
            self._memory[:] = np.concatenate([first, truth.rates])[:, None]
            return self._say(truth, self._memory[:, 0] + self.bias, np.zeros(6))
        elapsed = truth.time_s - before.time_s
        if elapsed <= 0.0:
            return self._last
        n = max(1, round(elapsed / self._dt))
        force = self._force_now = self._force(
            truth, (truth.velocity - before.velocity) / elapsed, (truth.rates - before.rates) / elapsed
        )
        self._wander += -self._wander * elapsed / float(self._imu.drift_time) + self._drift * math.sqrt(
            2 * elapsed / float(self._imu.drift_time)
        ) * self._rng.standard_normal(6)
        warm = self._warmth(truth.time_s)
        motion = np.empty((2, 6))
        motion[0, :3] = motion[1, :3] = force
        motion[0, 3:], motion[1, 3:] = before.rates, truth.rates
        speeds = np.stack([before.rotor_speed, truth.rotor_speed])
        out, clipped = np.empty(6), np.empty(6)
        _sample(
            motion, speeds, self._azimuth, self._shaking(speeds.mean(axis=0)), self._directions, self._phases,
            self._axes, self.bias + self._heat * warm, self._feigned,
            self._rng.standard_normal((n, 6)) * self._white, self._limit, self._filter, self._memory, elapsed / n,
            out, clipped,
        )  # fmt: skip
        return self._say(truth, out, clipped / n)

    def right(self, truth: Truth) -> Mapping[str, Any]:
        """Of the period that was read last."""
        return {"acceleration": self._force_now, "rates": truth.rates}

    def _warmth(self, time_s: float) -> float:
        """How much warmer than when it was switched on (K)."""
        return float(self._imu.warming) * (1.0 - math.exp(-time_s / float(self._imu.warming_time)))

    def _force(self, truth: Truth, acceleration: _Array, turning: _Array) -> _Array:
        """Specific force at the element (m/s^2)."""
        w, r = truth.rates, self._place
        down = np.array([0.0, 0.0, GRAVITY])
        return (
            rotation(truth.state[6:10]).T @ (acceleration - down)
            + np.cross(turning, r)
            + np.cross(w, np.cross(w, r))
        )

    def _shaking(self, speed: _Array) -> _Array:
        """Amplitudes of the lines at these speeds (m/s^2)."""
        v = self._imu.vibration
        passing = speed.sum() / self._hover.sum()
        share = speed / self._hover
        return np.array([
            *(float(a) * share[k] ** 2 * resonance(v, m * speed[k]) / resonance(v, m * self._hover[k])
              for k in range(2) for m, a in ((1, v.once), (2, v.twice))),
            float(v.passing) * passing**2 * resonance(v, 2 * speed.sum()) / resonance(v, 2 * self._hover.sum()),
        ])  # fmt: skip

    def _say(self, truth: Truth, values: _Array, clipped: _Array) -> Mapping[str, Reading]:
        t = truth.time_s
        self._last = {
            "acceleration": Reading(values[:3].copy(), t),
            "rates": Reading(values[3:].copy(), t),
            "clipping": Reading(clipped[:3], t),
            "temperature": Reading(ROOM_K + self._warmth(t), t),
        }
        return self._last


def resonance(vibration: Vibration, speed_rad_s: float) -> float:
    """How much the board exaggerates a shaking of this speed (rad/s): |H|."""
    x = speed_rad_s / float(vibration.resonance)
    return 1.0 / math.hypot(1.0 - x * x, 2.0 * float(vibration.damping) * x)


def butterworth(cutoff_rad_s: float, step_s: float) -> _Array:
    """Coefficients b0, b1, b2, a1, a2 of the second-order low pass, by the bilinear transform at its cut-off."""
    k = math.tan(min(0.5 * cutoff_rad_s * step_s, 0.49 * math.pi))
    norm = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    b0 = k * k * norm
    return np.array([b0, 2 * b0, b0, 2 * (k * k - 1) * norm, (1 - math.sqrt(2.0) * k + k * k) * norm])


def _axes(rng: np.random.Generator, scale: float, misalignment: float) -> _Array:
    """What three axes feel of three: the identity with errors."""
    off = misalignment * rng.standard_normal((3, 3))
    return np.eye(3) + np.diag(scale * rng.standard_normal(3)) + off - np.diag(np.diag(off))


@compiled(error_model="numpy")
def _sample(  # type: ignore[no-untyped-def]
    motion, speeds, azimuth, amplitude, directions, phases, axes, bias, feigned, white, limit, coefficients, memory, dt,
    out, clipped,
):  # fmt: skip
    """Samples of one period: shake, sense, clip, filter; ``azimuth`` and ``memory`` (6, 2) of the filter stay."""
    n = white.shape[0]
    b0, b1, b2, a1, a2 = coefficients[0], coefficients[1], coefficients[2], coefficients[3], coefficients[4]
    true, felt = np.empty(6), np.empty(6)
    gain = 1.0 + a1 + a2
    clipped[:] = 0.0
    for i in range(n):
        share = (i + 0.5) / n
        for k in range(2):
            azimuth[k] += dt * (speeds[0, k] + share * (speeds[1, k] - speeds[0, k]))
        for j in range(6):
            true[j] = motion[0, j] + share * (motion[1, j] - motion[0, j])
        for line in range(5):
            angle = azimuth[line // 2] * (1 + line % 2) if line < 4 else 2.0 * (azimuth[0] + azimuth[1])
            push = amplitude[line] * math.cos(angle + phases[line])
            for j in range(3):
                true[j] += push * directions[line, j]
        for j in range(3):
            a = w = 0.0
            for m in range(3):
                a += axes[0, j, m] * true[m]
                w += axes[1, j, m] * true[3 + m] + feigned[j, m] * true[m]
            felt[j], felt[3 + j] = a, w
        for j in range(6):
            x = felt[j] + bias[j] + white[i, j]
            if x > limit[j]:
                x = limit[j]
                clipped[j] += 1.0
            elif x < -limit[j]:
                x = -limit[j]
                clipped[j] += 1.0
            # Direct form II with its memory in units of the signal: at rest both states are the value itself.
            s = gain * x - a1 * memory[j, 0] - a2 * memory[j, 1]
            out[j] = (b0 * s + b1 * memory[j, 0] + b2 * memory[j, 1]) / gain
            memory[j, 1] = memory[j, 0]
            memory[j, 0] = s
    for k in range(2):
        azimuth[k] %= 2.0 * math.pi
