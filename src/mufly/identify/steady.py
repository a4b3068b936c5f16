"""Where a simulated record begins: steady rotors, hover by eq. 5.1, and the stabiliser bar's place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.parameters import GRAVITY

__all__ = ["bar_normal", "hover", "steady_speed"]

_Array = NDArray[np.float64]


def steady_speed(p: NDArray[np.void], duty: _Array, volts: float) -> _Array:
    """Return the rotor speeds (b, 2) at which the motors settle under constant inputs (2,): eq. 4.29 at rest."""
    gear, out = p["gear_ratio"], np.empty((len(p), 2))
    for k, side in enumerate(("up", "dw")):
        square = p[f"torque_{side}"] / (gear**2 * p["gear_efficiency"])
        linear = p["kM"] * p["kE"] / p["R_ohm"] + p["dR"]
        drive = p["kM"] * duty[k] * volts / (p["R_ohm"] * gear)
        out[:, k] = 2 * drive / (linear + np.sqrt(linear**2 + 4 * square * drive))
    return out


def hover(p: NDArray[np.void]) -> tuple[_Array, _Array]:
    """Return hover speeds (b, 2) by eq. 5.1 and the motor inputs that hold them."""
    ratio = p["torque_up"] / p["torque_dw"]
    up = np.sqrt(
        (p["mass"] * GRAVITY + p["downwash"]) / (p["thrust_up"] + p["thrust_dw"] * ratio)
    )  # fmt: skip
    speed = np.column_stack([up, up * np.sqrt(ratio)])
    gear = p["gear_ratio"][:, None]
    torque = np.column_stack([p["torque_up"], p["torque_dw"]]) * speed**2
    current = p["dR"][:, None] * speed + torque / (gear**2 * p["gear_efficiency"][:, None])
    current *= gear / p["kM"][:, None]
    volts = current * p["R_ohm"][:, None] + p["kE"][:, None] * gear * speed
    return speed, volts / p["battery_curve"][:, -1:]


def bar_normal(attitude: _Array, tilt: _Array) -> _Array:
    """Return upward normals in N-E-D (b, 3) of bars tilted by roll and pitch against the mast."""
    roll, pitch, yaw = attitude[:, 0] + tilt[:, 0], attitude[:, 1] + tilt[:, 1], attitude[:, 2]
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return -np.column_stack([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr])
