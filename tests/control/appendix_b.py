"""Appendix B's matrices written out from its formulas and Table 5.3, independent of the dynamics room.

Signs as in docs/thesis/thesis-errata.md: servo 1 pitches (positive: nose down), servo 2 rolls (positive: right);
the reaction torque of an accelerating rotor is that of ``Izz rdot = -(Q_dw + J_dw Omdot_dw) + (Q_up + J_up Omdot_up)``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi, radians, sqrt

import control as ct
import numpy as np


@dataclass(frozen=True)
class Parameters:
    """Table 5.3, SI units; ``gear`` and ``efficiency`` are dimensionless."""

    m: float = 0.095
    Ixx: float = 1.12e-4
    Iyy: float = 1.43e-4
    Izz: float = 2.66e-5
    z_dw: float = -0.051
    z_up: float = -0.091
    swash_max: float = radians(15.0)
    R: float = 0.0875
    cT_dw: float = 0.0117
    cT_up: float = 0.0138
    cQ_dw: float = 0.0018
    cQ_up: float = 0.0025
    J_dw: float = 7.04e-6
    J_up: float = 2.11e-5
    kE: float = 0.0045
    kM: float = 0.0035
    dR: float = 5.2107e-7
    R_ohm: float = 1.3811
    gear: float = 1.5
    efficiency: float = 0.84
    W_hub: float = 0.009
    Tf_dw: float = 0.001
    Tf_up: float = 0.24
    l_dw: float = 0.77
    l_up: float = 0.48
    rho: float = 1.2
    g: float = 9.81
    U: float = 7.2


def scaled(p: Parameters = Parameters(), **factors: float) -> Parameters:
    """The parameters with some of them multiplied."""
    return replace(p, **{name: getattr(p, name) * factor for name, factor in factors.items()})


@dataclass(frozen=True)
class Trim:
    motor_input: np.ndarray  # (upper, lower)
    rotor_speed: np.ndarray  # (upper, lower), rad/s


@dataclass(frozen=True)
class Linear:
    heave_yaw: ct.StateSpace
    roll_pitch: ct.StateSpace
    trim: Trim
    voltage: float


def linear(p: Parameters = Parameters()) -> Linear:
    """Hover point and both linear models of ``p``."""
    kT, kQ = pi * p.R**4 * p.rho, pi * p.R**5 * p.rho
    ratio = p.cQ_up / p.cQ_dw  # (Om_dw / Om_up)^2 from Q_up = Q_dw
    up = sqrt((p.m * p.g + p.W_hub) / (kT * (p.cT_up + p.cT_dw * ratio)))
    dw = up * sqrt(ratio)

    def motor_input(speed: float, cQ: float) -> float:
        torque = p.dR * speed + cQ * kQ * speed**2 / (p.gear**2 * p.efficiency) + p.kE * p.kM * speed / p.R_ohm
        return torque * p.gear * p.R_ohm / (p.kM * p.U)

    trim = Trim(np.array([motor_input(up, p.cQ_up), motor_input(dw, p.cQ_dw)]), np.array([up, dw]))

    def damping(speed: float, cQ: float) -> float:
        return p.dR + 2 * cQ * kQ * speed / (p.efficiency * p.gear**2) + p.kE * p.kM / p.R_ohm

    A = np.zeros((6, 6))
    A[0, 1] = A[2, 3] = 1.0
    A[1, 4] = -2 * p.cT_dw * kT * dw / p.m
    A[1, 5] = -2 * p.cT_up * kT * up / p.m
    A[3, 4] = (damping(dw, p.cQ_dw) - 2 * p.cQ_dw * kQ * dw) / p.Izz
    A[3, 5] = -(damping(up, p.cQ_up) - 2 * p.cQ_up * kQ * up) / p.Izz
    A[4, 4] = -damping(dw, p.cQ_dw) / p.J_dw
    A[5, 5] = -damping(up, p.cQ_up) / p.J_up
    b = p.kM * p.U / (p.gear * p.R_ohm)
    B = np.zeros((6, 2))
    B[3] = [-b / p.Izz, b / p.Izz]
    B[4, 0], B[5, 1] = b / p.J_dw, b / p.J_up
    C = np.zeros((3, 6))
    C[0, 0] = C[1, 2] = C[2, 3] = 1.0
    heave_yaw = ct.ss(
        A,
        B,
        C,
        np.zeros((3, 2)),
        states=["z", "w", "psi", "r", "Omega_dw", "Omega_up"],
        inputs=["motor_lower", "motor_upper"],
        outputs=["z", "psi", "r"],
    )

    T_up, T_dw = p.cT_up * kT * up**2, p.cT_dw * kT * dw**2
    A = np.zeros((8, 8))
    A[0, 2] = A[1, 3] = 1.0
    A[2, 0] = T_up * p.l_up * p.z_up / p.Ixx
    A[2, 6] = -A[2, 0]
    A[3, 1] = T_up * p.l_up * p.z_up / p.Iyy
    A[3, 7] = -A[3, 1]
    A[2, 5] = -T_dw * p.z_dw / p.Ixx
    A[3, 4] = T_dw * p.z_dw / p.Iyy
    A[4, 4] = A[5, 5] = -1 / p.Tf_dw
    A[6, 6] = A[7, 7] = -1 / p.Tf_up
    A[6, 0] = A[7, 1] = 1 / p.Tf_up
    B = np.zeros((8, 2))
    B[4, 0] = B[5, 1] = p.l_dw * p.swash_max / p.Tf_dw
    roll_pitch = ct.ss(
        A,
        B,
        np.eye(4, 8),
        np.zeros((4, 2)),
        states=["phi", "theta", "p", "q", "a_dw", "b_dw", "bar_roll", "bar_pitch"],
        inputs=["servo_1", "servo_2"],
        outputs=["phi", "theta", "p", "q"],
    )
    return Linear(heave_yaw, roll_pitch, trim, p.U)
