"""The estimator of a vehicle with sensors: the filter, with what the flight software wants of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import model_parameters
from mufly.estimate.beliefs import Beliefs, Check, Checks
from mufly.estimate.estimate import Estimate, Estimator
from mufly.estimate.layout import (
    BLOCK_S,
    CHECKED,
    EX_ACCEL_BIAS,
    EX_FIX_BIAS,
    EX_FIX_HEADING,
    EX_GYRO_BIAS,
    R_BATTERY,
    R_FIX,
    R_PRESSURE,
    R_RING,
    SENSORS,
    STARTS,
    SX_ACCEL_BIAS,
    SX_ATT,
    SX_FIX_BIAS,
    SX_GYRO_BIAS,
    SX_POS,
    SX_TERRAIN,
    SX_THRUST_SCALE,
    SX_VEL,
    SX_WIND,
    WIDTHS,
    beams_used,
    filter_settings,
    memory_type,
)
from mufly.estimate.native import Code, steps
from mufly.estimate.output_predictor import TOLD_EVERY
from mufly.estimate.sensor_checks import ACTING, CLIPPING, VALUES
from mufly.sensors import Reading, Readings
from mufly.sensors.pressure import STANDARD_PRESSURE_PA
from mufly.vehicle import Vehicle
from mufly.world import World

_Array = NDArray[np.float64]
_BATTERY = STARTS[R_BATTERY]
SHOWN = (
    "covariance_output", "sigma_output", "status", "reason", "fault_number", "innovation", "innovation_sigma",
    "last_fused_tick", "last_new_tick", "fault_component", "tick",
)  # fmt: skip
"""Of the memory, what is told every :data:`mufly.estimate.output_predictor.TOLD_EVERY` periods."""


def fitted_estimator(vehicle: Vehicle, world: World, rate_Hz: float) -> Estimator:
    """Return the estimator for what the vehicle has on board.

    Parameters
    ----------
    vehicle : Vehicle
        With the table ``sensors``.
    world : World
        Its room, which is known beforehand.
    rate_Hz : float
        Of the flight software (Hz).
    """
    return KalmanEstimator(vehicle, world, rate_Hz)


class KalmanEstimator(Estimator):
    """The error-state Kalman filter of :mod:`mufly.estimate.ekf_step`.

    Parameters
    ----------
    vehicle, world, rate_Hz
        As for :func:`fitted_estimator`.
    kind : type
        Of the filter's numbers; a processor on board has ``numpy.float32``.
    code : "", "c" or "numba"
        What computes it (:mod:`mufly.estimate.native`); what starts sooner by default. ``steps`` says which it is.
    block_s : float
        Time over which inputs are averaged (s).

    Attributes
    ----------
    by_covariance : bool
        Whether position fixes that come with a covariance are taken for as good as that says.
    wander_s : float
        Over which errors of such fixes hang together; 0: not at all, each is white noise, and the wandering of all
        stays as the vehicle's file has it. Else they wander by as much as the covariance says, where that is more than
        the file does (a map that has drifted is off by the same for long), and noise stays as in the file. A bias that
        the filter holds for small gets as large but over that time; until then the rest r of the variance is told as
        noise that is worth as much over long, of variance r (1 + 2 wander_s / period).
    """

    def __init__(
        self,
        vehicle: Vehicle,
        world: World,
        rate_Hz: float,
        kind: Any = np.float64,
        code: Code = "",
        block_s: float = BLOCK_S,
    ) -> None:
        self._kind, self._rate = kind, rate_Hz
        self._settings = filter_settings(vehicle, world, rate_Hz, kind, block_s)
        self._parameters = model_parameters(vehicle)
        self._fitted = [k for k in range(SENSORS) if self._settings["fitted"][k]]
        self._place = {CHECKED[k]: k for k in self._fitted}
        ring = vehicle.range_ring
        self._nothing = np.full(ring.count, float(ring.max_range))
        self._beams = beams_used(ring.count)
        # A record of an array is a view of it: the compiled step writes into the array.
        self._box = np.zeros(1, memory_type(self._kind))
        self.memory = m = self._box[0]
        self._out, self._rates, self._angles = m["x_output"], m["rates_output"], m["angles_output"]
        self._z = np.zeros(VALUES, self._kind)
        self._new, self._age = np.zeros(SENSORS, np.int32), np.zeros(SENSORS, self._kind)
        self._code: Code = code
        self.by_covariance, self.wander_s = False, 0.0
        self.use(self._settings)

    def use(self, settings: Any) -> None:
        """Take other settings (:func:`mufly.estimate.layout.filter_settings`), and start anew."""
        self._settings = settings
        self._by_file = {
            name: np.array(settings[name]) for name in ("fix_variance", "heading_variance", "sigma")
        }
        self.steps = steps(settings, self._parameters, self._z, self._new, self._age, self._code)
        self.reset()

    def reset(self) -> None:
        for row in (self._box, self._z, self._new, self._age):
            row.view(np.uint8)[:] = 0
        for name, own in self._by_file.items():
            self.steps.settings[name] = own
        self._wander = self._wants = self._by_file["sigma"][EX_FIX_BIAS : EX_FIX_HEADING + 1] ** 2
        self.steps.begin(self._box)
        self._periods = 0
        self._last: dict[str, Reading] = {}
        self._checks: Sequence[Check] = ()
        self._told: tuple[Any, ...] = ()
        self._first = math.nan
        self._pictures = [self._nothing] * 3
        self._ranges = self._nothing

    def update(self, readings: Readings, acting: _Array | None = None) -> Estimate:
        self._read(readings, acting)
        valid = self.steps.step(self._box)
        return self.told(readings.time_s, valid)

    def told(self, time_s: float, valid: bool, periods: int = 1) -> Estimate:
        """What is believed after so many more periods; of those whose turn it is to tell much, none is left out."""
        self._periods += periods
        if (periods and self._periods % TOLD_EVERY == 0) or not self._told:
            self.show(self.memory.copy())
        return self.said(
            time_s, valid, self._out, self._rates, self._angles, float(self._z[_BATTERY]), self._ranges
        )

    def show(self, m: Mapping[str, Any] | np.void) -> None:
        """Tell much from now on, of a memory, or of as much of it as :data:`SHOWN` names, that does not change any
        more."""
        self._checks = Checks(m, self._settings, self._fitted)
        sigma, covariance = m["sigma_output"].astype(np.float64), np.zeros((EX_ACCEL_BIAS, EX_ACCEL_BIAS))
        bias = range(EX_GYRO_BIAS, EX_ACCEL_BIAS)
        covariance[:EX_GYRO_BIAS, :EX_GYRO_BIAS] = m["covariance_output"]
        covariance[bias, bias] = sigma[bias] ** 2 + self._settings["rest_gyro"] ** 2
        self._told = (covariance, sigma)

    def said(
        self, time_s: float, valid: bool, out: _Array, rates: _Array, angles: _Array, volts: float, ranges: _Array
    ) -> Estimate:  # fmt: skip
        """Return the estimate of these numbers, with what is told every so often as it stands."""
        x = out.astype(np.float64)
        return Estimate(
            time_s, x[SX_POS:SX_VEL], x[SX_VEL:SX_ATT], angles.astype(np.float64), rates.astype(np.float64), ranges,
            volts or math.nan, self._told[0], valid,
            Beliefs(
                x[SX_GYRO_BIAS:SX_ACCEL_BIAS], x[SX_ACCEL_BIAS:SX_TERRAIN], float(x[SX_TERRAIN]),
                x[SX_FIX_BIAS:SX_WIND], x[SX_WIND:SX_THRUST_SCALE], float(x[SX_THRUST_SCALE]),
                self._told[1], self._checks,
            ),
        )  # fmt: skip

    def _look(self, seen: _Array) -> None:
        """Take a picture of the ring: of each beam the middle of the last three is told.

        In a flight of minutes noise makes a spot where none is, and an obstacle that is seen once is a detour; it costs
        an obstacle that is there the time of one picture.
        """
        a, b, c = self._pictures = [*self._pictures[1:], np.where(np.isfinite(seen), seen, self._nothing)]
        self._ranges = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))

    def _read(self, readings: Readings, acting: _Array | None) -> None:
        """Lay what has come anew into one row."""
        self._z[ACTING : ACTING + 4] = 0.0 if acting is None else acting
        self._new[:] = 0
        for k in self._fitted:
            r = readings.latest.get(CHECKED[k])
            if r is not None:
                self._take(k, r, readings.time_s)
        clipping = readings.latest.get("clipping")
        self._z[CLIPPING:] = 0.0 if clipping is None else clipping.value

    def hear(self, said: Mapping[str, Reading], time_s: float) -> None:
        """Lay what some of the sensors say into the row of this period."""
        for name, r in said.items():
            k = self._place.get(name)
            if k is not None:
                self._take(k, r, time_s)
            elif name == "clipping":
                self._z[CLIPPING:] = r.value

    def _take(self, k: int, r: Reading, t: float) -> None:
        """Lay what one sensor says into the row, if it is new."""
        name, z = CHECKED[k], self._z
        before = self._last.get(name)
        if r is before or (before is not None and r.time_s == before.time_s):
            return
        self._last[name] = r
        self._age[k] = t - r.time_s
        self._new[k] = 1 if r.valid else 2
        start = STARTS[k]
        if k == R_RING:
            seen = np.asarray(r.value, dtype=np.float64)
            self._look(seen)
            z[start : start + len(self._beams)] = seen[self._beams]
        elif k == R_PRESSURE:
            z[start] = r.value - STANDARD_PRESSURE_PA
        else:
            if k == R_FIX and self.by_covariance:
                self._weigh(r, 0.0 if before is None else r.time_s - before.time_s)
            z[start : start + WIDTHS[k]] = r.value

    def _weigh(self, fix: Reading, since_s: float) -> None:
        """Take a fix for as good as it says that it is, or else as the vehicle's file says."""
        s, file, four = self.steps.settings, self._by_file, slice(EX_FIX_BIAS, EX_FIX_HEADING + 1)
        noise = np.array([file["fix_variance"], file["heading_variance"]])
        own = None if fix.covariance is None else np.diag(fix.covariance)
        wander = file["sigma"][four] ** 2
        if own is not None and self.wander_s > 0.0:
            # What the filter's bias may be off by by now
            grown = 1.0 - math.exp(-2.0 * since_s / self.wander_s)
            self._wander = self._wander + grown * (self._wants - self._wander)
            self._wants = wander = np.maximum(wander, own)
            self._wander = np.minimum(self._wander, wander)
            rest = np.maximum(own - self._wander, 0.0) * (
                1.0 + 2.0 * self.wander_s / float(s["period"][R_FIX])
            )
            noise += [rest[:3].max(), rest[3]]
        elif own is not None:
            noise = np.array([own[:3].max(), own[3]])
        s["fix_variance"], s["heading_variance"] = noise
        s["sigma"][four] = np.sqrt(wander)

    # What others do who lay readings into the row themselves

    def lend(self, taken: _Array, pictures: _Array, ranges: _Array) -> None:
        """Write when each sensor's latest reading was taken (s), the last three pictures (3, n), and what is told of
        them (n,)."""
        taken[:] = math.nan
        for name, reading in self._last.items():
            taken[self._place[name]] = reading.time_s
        pictures[:], ranges[:] = self._pictures, self._ranges

    def went_on(self, said: Mapping[str, Reading], pictures: _Array, ranges: _Array) -> None:
        """Take notice of readings that others laid into the row."""
        self._last |= {name: reading for name, reading in said.items() if name in self._place}
        if "ranges" in said:
            self._pictures, self._ranges = list(pictures.copy()), ranges.copy()

    @property
    def fitted(self) -> Mapping[str, int]:
        """Readings that it takes, and their places in :data:`mufly.estimate.layout.CHECKED`."""
        return self._place

    @property
    def beams(self) -> NDArray[np.intp]:
        """Which of the ring's it looks at."""
        return self._beams

    @property
    def periods(self) -> int:
        """How many it has been told."""
        return self._periods

    @property
    def covariance(self) -> _Array:
        """That was told last (12, 12)."""
        covariance: _Array = self._told[0]
        return covariance

    @property
    def checks(self) -> Sequence[Check]:
        """What is thought of the sensors."""
        return self._checks

    @property
    def ranges(self) -> _Array:
        """Of the beams, as told (m)."""
        return self._ranges

    @property
    def row(self) -> tuple[_Array, NDArray[np.int32], _Array]:
        """Values of this period, which of the sensors are new, and their ages: what :mod:`kernel` takes."""
        return self._z, self._new, self._age

    @property
    def box(self) -> NDArray[np.void]:
        """The memory (1,)."""
        return self._box
