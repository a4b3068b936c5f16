"""Numbers of the control law as NumPy records, padded with zero states to a fixed order.

The padding makes the compiled law the same for every vehicle; Numba reads ``gains.A`` as fast as a C struct. Units
SI and radians. The states of the law are flat arrays; that of heave-yaw holds, behind the controller's own, the
filtered references, the origins of height and heading, and the filtered battery voltage.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from mufly.control.discretise import DiscreteController
from mufly.errors import MuflyError

__all__ = [
    "HEAVE_YAW_GAINS",
    "HEAVE_YAW_ORDER",
    "HEAVE_YAW_STATE",
    "POSITION_GAINS",
    "ROLL_PITCH_GAINS",
    "ROLL_PITCH_ORDER",
    "VELOCITY_ORDER",
    "pack",
]

HEAVE_YAW_ORDER, ROLL_PITCH_ORDER, VELOCITY_ORDER = 10, 8, 6
_f8 = np.float64


def _matrices(order: int, inputs: int, outputs: int) -> list[tuple[str, type, tuple[int, ...]]]:
    return [
        ("A", _f8, (order, order)),
        ("B", _f8, (order, inputs)),
        ("C", _f8, (outputs, order)),
        ("D", _f8, (outputs, inputs)),
        ("M", _f8, (order, outputs)),
    ]


HEAVE_YAW_GAINS = np.dtype(
    [
        *_matrices(HEAVE_YAW_ORDER, 5, 2),
        ("trim", _f8, (2,)),  # lower, upper; fraction of the design voltage
        ("design_voltage", _f8),  # V
        ("voltage_blend", _f8),  # 0..1, share of a new voltage measurement in its filter
        ("period", _f8),  # s
        ("heave_bandwidth", _f8),  # rad/s, of the reference filter
        ("heave_acceleration", _f8),  # m/s2
        ("heave_speed", _f8),  # m/s
        ("heave_lead", _f8),  # s, by which the reference runs ahead to make up for the loop's lag
        ("heave_slack", _f8),  # m, by which the height may trail the filtered reference before that waits
        ("yaw_bandwidth", _f8),  # rad/s
        ("yaw_acceleration", _f8),  # rad/s2
        ("yaw_rate", _f8),  # rad/s
        ("yaw_lead", _f8),  # s
    ]
)
ROLL_PITCH_GAINS = np.dtype(
    [
        *_matrices(ROLL_PITCH_ORDER, 4, 2),
        ("trim", _f8, (2,)),  # servo 1, servo 2
        ("tilt_limit", _f8),  # rad
    ]
)
POSITION_GAINS = np.dtype(
    [
        *_matrices(VELOCITY_ORDER, 2, 2),
        ("position_gain", _f8),  # 1/s
        ("speed_limit", _f8),  # m/s
        ("tilt_limit", _f8),  # rad
        ("gravity", _f8),  # m/s2
    ]
)
# State of heave-yaw behind the controller's own: filtered references, origins, filtered voltage.
SHAPED_Z, SHAPED_W, SHAPED_PSI, SHAPED_R, ORIGIN_Z, ORIGIN_PSI, VOLTAGE = range(
    HEAVE_YAW_ORDER, HEAVE_YAW_ORDER + 7
)
HEAVE_YAW_STATE = HEAVE_YAW_ORDER + 7


def pack(dtype: np.dtype, controller: DiscreteController, **values: object) -> np.void:
    """Gains record of a controller, its states padded with zeros to the record's order.

    Raises
    ------
    MuflyError
        If the controller has more states than the record holds, or other signals.
    """
    record = np.zeros((), dtype=dtype)
    order, inputs = record["B"].shape
    n = controller.order
    if n > order or controller.B.shape[1] != inputs:
        raise MuflyError(
            f"control law: a controller of order {n} with {controller.B.shape[1]} inputs does not fit a record of "
            f"order {order} with {inputs}; reduce it further"
        )
    record["A"][:n, :n], record["B"][:n], record["C"][:, :n] = controller.A, controller.B, controller.C
    record["D"], record["M"][:n] = controller.D, controller.M
    for name, value in values.items():
        record[name] = value
    return cast(np.void, record[()])
