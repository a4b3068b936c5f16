"""Status of a filter's sensors, and its states besides position, velocity, attitude and rates."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from mufly.estimate.filter.measurements import sensor_checks as g
from mufly.quantities.quantity_table import READINGS_WITH_FUSION_STATUS
from mufly.quantities.sensor_table import CHECKED

_Array = NDArray[np.float64]

FusionStatus = Literal["fused", "rejected", "missing", "faulty", "waiting"]


@dataclass(frozen=True, slots=True)
class SensorStatus:
    """The estimator's status of one sensor.

    Attributes
    ----------
    name : str
        Name of the reading (:data:`mufly.quantities.sensor_table.READINGS`).
    status : str
        ``"fused"``: in use. ``"rejected"``: inconsistent with the estimate. ``"missing"``: readings have stopped.
        ``"faulty"``: readings are invalid in themselves. ``"waiting"``: not needed, or no reading yet.
    innovation, sigma, ratio : float
        Innovation of the worst component, its standard deviation (both in SI units), and their quotient.
    time_since_fusion_s : float
        Time since the last fused measurement (s).
    reason : str
        Explanation of the status; empty without a problem.
    is_suspicious : bool
        Whether a fused or waiting sensor has a problem, which ``reason`` explains.
    """

    name: str
    status: FusionStatus = "waiting"
    innovation: float = 0.0
    sigma: float = 0.0
    ratio: float = 0.0
    time_since_fusion_s: float = 0.0
    reason: str = ""
    is_suspicious: bool = False


@dataclass(frozen=True, slots=True)
class AuxiliaryStates:
    """Filter states besides the motion: biases, wind, terrain and thrust scale.

    Attributes
    ----------
    gyro_bias : (3,) array
        Bias of the gyroscopes (rad/s), body axes.
    accelerometer_bias : (3,) array
        Bias of the accelerometers (m/s^2), body axes.
    floor_height : float
        Height of the surface under the sonar above D = 0 (m, positive up).
    fix_bias : (4,) array
        Bias of the position fix: N, E, D (m), heading (rad).
    wind : (2,) array
        Wind, N, E (m/s).
    thrust_scale : float
        Ratio of the true thrust to the model's (1).
    error_state_sigma : (n,) array
        Standard deviations of the whole error state, in the order of
        :data:`mufly.estimate.filter.filter_records.ERROR_STATES`.
    checks : sequence of SensorStatus
        Status of each sensor of the vehicle.
    specific_force : (3,) array
        Last reading of the accelerometers (m/s^2), body axes; zero without accelerometers.
    """

    gyro_bias: _Array
    accelerometer_bias: _Array
    floor_height: float
    fix_bias: _Array
    wind: _Array
    thrust_scale: float
    error_state_sigma: _Array
    checks: Sequence[SensorStatus] = ()
    specific_force: _Array = field(default_factory=lambda: np.zeros(3))


_STATUS_NAMES: tuple[FusionStatus, ...] = ("waiting", "fused", "rejected", "missing", "faulty")
_FIX_OR_SONAR_PREFIX, _FIX_OR_GYRO_PREFIX = "position fix or sonar: ", "position fix or gyroscopes: "
_ACCEL_OR_MODEL_PREFIX, _ROTOR_MODEL_PREFIX = (
    "accelerometers or rotor model (thrust, drag, wind): ",
    "rotor model (thrust, drag, wind): ",
)
_MAGNETOMETER_OR_IRON_PREFIX = "magnetometer, steel or motor currents: "
REASON_CAUSE_PREFIXES = (
    _FIX_OR_SONAR_PREFIX,
    _FIX_OR_GYRO_PREFIX,
    _ACCEL_OR_MODEL_PREFIX,
    _ROTOR_MODEL_PREFIX,
    _MAGNETOMETER_OR_IRON_PREFIX,
)
"""Openings of reasons that name the possible causes themselves, where this sensor alone is not accused."""
_REASON_TEXTS: Mapping[int, Callable[[float, str], str]] = {
    g.REASON_NONE: lambda x, u: "",
    g.REASON_NO_READING: lambda x, u: "no reading yet",
    g.REASON_TIMEOUT: lambda x, u: f"no reading for {x:.2f} s",
    g.REASON_LATE: lambda x, u: f"arrives {1e3 * x:.0f} ms after its measurement, later than allowed",
    g.REASON_OUT_OF_RANGE: lambda x, u: "value not finite or out of range",
    g.REASON_FROZEN: lambda x, u: f"value frozen for {x:.2f} s",
    g.REASON_DUPLICATED: lambda x, u: "every reading arrives twice; duplicates are ignored",
    g.REASON_INNOVATION: lambda x, u: f"differs from the estimate by {x:.3g} {u}",
    g.REASON_CLIPPING: lambda x, u: f"clips {100 * x:.0f} % of its samples; the rotor model replaces them",
    g.REASON_TERRAIN_STEP: lambda x, u: f"step of the surface below, to {x:.2f} m above the floor",
    g.REASON_RESET: lambda x, u: f"consistent deviation of {x:.3g} {u}; estimate reset to this sensor",
    g.REASON_NO_ECHO: lambda x, u: f"no echo for {x:.2f} s",
    g.REASON_WALLS_TOO_FAR: lambda x, u: "no wall within range",
    g.REASON_NO_WALL: lambda x, u: "detections match no wall of the room",
    g.REASON_SPIKES: lambda x, u: f"spikes of {x:.2g} {u}; the flight model bridges them",
    g.REASON_TERRAIN_SLOPE: lambda x, u: f"consistent deviation of {x:.3g} {u}: sloping surface below, or drift",
    g.REASON_HEIGHT_CONFLICT: lambda x, u: f"{_FIX_OR_SONAR_PREFIX}their heights differ by {x:.2f} m",
    g.REASON_STUCK: lambda x, u: f"stuck at {x:.2f} m: varies less than in any flight",
    g.REASON_LARGE_BIAS: lambda x, u: f"bias of {x:.2g} {u}, above the largest possible",
    g.REASON_FUSED_THOUGH_OFFSET: lambda x, u: f"{_FIX_OR_GYRO_PREFIX}persistent offset of {x:.3g} {u}",
    g.REASON_FORCE_CONFLICT: lambda x, u: f"{_ACCEL_OR_MODEL_PREFIX}they differ by {x:.3g} {u}",
    g.REASON_MODEL_WRONG: lambda x, u: f"{_ROTOR_MODEL_PREFIX}differs by {x:.3g} {u} from the accelerometers",
    g.REASON_LEVELLED: lambda x, u: f"mounted {math.degrees(x):.1f} degrees off level; its axes are turned level",
    g.REASON_FIELD_STRENGTH: lambda x, u: (
        f"{_MAGNETOMETER_OR_IRON_PREFIX}field differs by {1e6 * x:.0f} uT from the earth's"
    ),
    g.REASON_JUMP: lambda x, u: f"sudden offset of {x:.2g} {u}, subtracted from its readings",
}

REASON_COUNT = len(_REASON_TEXTS)
SUSPICIOUS_REASONS = (
    g.REASON_DUPLICATED, g.REASON_SPIKES, g.REASON_JUMP, g.REASON_FUSED_THOUGH_OFFSET, g.REASON_MODEL_WRONG,
)  # fmt: skip
"""Reasons that mark a fused or waiting sensor as suspicious. Clipping is usual and only reduces the weight."""


class LazySensorStatuses(Sequence[SensorStatus]):
    """Sequence of the statuses of the sensors that the vehicle has, evaluated on first access.

    Parameters
    ----------
    m, s : records
        Memory and settings of the filter, which must not change afterwards.
    fitted : sequence of int
        Indices of these sensors in :data:`mufly.quantities.quantity_table.READINGS_WITH_FUSION_STATUS`.
    """

    def __init__(self, m: Mapping[str, Any] | np.void, s: np.void, fitted: Sequence[int]) -> None:
        self._source_records = (m, s, fitted)
        self._evaluated: tuple[SensorStatus, ...] | None = None

    @overload
    def __getitem__(self, k: int) -> SensorStatus: ...
    @overload
    def __getitem__(self, k: slice) -> tuple[SensorStatus, ...]: ...
    def __getitem__(self, k: int | slice) -> SensorStatus | tuple[SensorStatus, ...]:
        return self._evaluate_statuses()[k]

    def __iter__(self) -> Iterator[SensorStatus]:
        return iter(self._evaluate_statuses())

    def __len__(self) -> int:
        return len(self._source_records[2])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LazySensorStatuses | tuple) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(self._evaluate_statuses())

    def __repr__(self) -> str:
        return repr(self._evaluate_statuses())

    def _evaluate_statuses(self) -> tuple[SensorStatus, ...]:
        if self._evaluated is None:
            m, s, fitted = self._source_records
            dt, tick = float(s["dt"]), int(m["tick"])
            rows = zip(*(m[name].tolist() for name in _STATUS_FIELDS), strict=True)
            part = int(m["fix_fault_component"])
            self._evaluated = tuple(_make_status(k, row, dt, tick, part) for k, row in enumerate(rows) if k in fitted)
        return self._evaluated


_STATUS_FIELDS = (
    "status", "reason", "reason_number", "innovation", "innovation_sigma", "last_fused_tick", "last_new_tick",
)  # fmt: skip


def _make_status(k: int, row: Sequence[float], dt: float, tick: int, part: int) -> SensorStatus:
    code, why, number, nu, spread, used, came = row
    if code == g.STATUS_WAITING and why == g.REASON_NONE:
        why = g.REASON_NONE if came else g.REASON_NO_READING
    return SensorStatus(
        READINGS_WITH_FUSION_STATUS[k],
        _STATUS_NAMES[int(code)],
        nu,
        spread,
        nu / spread if spread > 0.0 else 0.0,
        (tick - int(used)) * dt,
        describe_reason(int(why), number, k, part),
        code in (g.STATUS_FUSED, g.STATUS_WAITING) and int(why) in SUSPICIOUS_REASONS,
    )


_INNOVATION_REASON_CODES = (g.REASON_INNOVATION, g.REASON_RESET, g.REASON_FUSED_THOUGH_OFFSET)


def describe_reason(why: int, number: float, sensor: int, component: int = 0) -> str:
    """Return the reason for a sensor's status as a text.

    ``sensor`` is an index into :data:`mufly.quantities.quantity_table.READINGS_WITH_FUSION_STATUS`. ``component`` is
    the component of a position fix to which ``number`` belongs: N, E, D (m) or the heading (rad).
    """
    in_unit = CHECKED[sensor].unit_component_count
    if in_unit is not None and component >= in_unit and why in _INNOVATION_REASON_CODES:
        return _REASON_TEXTS[why](math.degrees(number), "deg in heading")
    return _REASON_TEXTS[why](number, _reason_unit(sensor))


def _reason_unit(k: int) -> str:
    return CHECKED[k].innovation_unit or CHECKED[k].unit
