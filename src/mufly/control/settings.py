"""What shapes the designs: weights, scaling, limits. The defaults, and how scaling follows from a vehicle's authority.

Reasons stand in docs/control.md. The weights of heave-yaw are eq. 6.4 but for W_r and W_M; those of roll-pitch and
velocity, which the thesis does not print, are chosen here.
"""

from __future__ import annotations

from dataclasses import dataclass

import control
import numpy as np

from mufly.control.schemes import OneDegreeWeights, Scaling, TransferFunction, TwoDegreeWeights

__all__ = [
    "HEAVE_YAW_WEIGHTS",
    "ROLL_PITCH_WEIGHTS",
    "VELOCITY_WEIGHTS",
    "Settings",
    "heave_yaw_scaling",
    "roll_pitch_scaling",
]

# W_r without its factor 1e-4, and its zero at 4 instead of 1 rad/s; W_M at 9 instead of 14 rad/s.
HEAVE_YAW_WEIGHTS = TwoDegreeWeights(
    model_matching=TransferFunction((1.0, 18.0, 56.0), (1.0, 14.0, 0.0014)),
    reference_model=TransferFunction((9.0,), (1.0, 9.0)),
    auxiliary=0.0,
)
ROLL_PITCH_WEIGHTS = OneDegreeWeights(
    control=TransferFunction((0.001,)),
    output_noise=TransferFunction((1.0, 35.0), (0.1, 70.0)),
    input_disturbance=TransferFunction((0.7, 7.0), (1.0, 0.03)),
    auxiliary=0.0,
)
VELOCITY_WEIGHTS = OneDegreeWeights(
    control=TransferFunction((0.001,)),
    output_noise=TransferFunction((1.0, 20.0), (0.1, 40.0)),
    input_disturbance=TransferFunction((0.7, 0.14), (1.0, 0.007)),
)
VELOCITY_SCALING = Scaling(outputs=(1.0, 1.0), inputs=(0.08, 0.08))


@dataclass(frozen=True)
class Settings:
    """Everything that shapes the designs; the defaults fly ``mufly-1.1``.

    Attributes
    ----------
    heave_yaw_scaling : Scaling or None
        Outputs z (m), psi (rad), r (rad/s); inputs motor lower, upper. None: from the vehicle's authority, see
        ``heave_yaw_scaling``.
    heave_yaw_weights : TwoDegreeWeights
    heave_yaw_relaxation : float
        Factor on the smallest level; see ``hinfsyn``.
    roll_pitch_scaling, roll_pitch_weights, roll_pitch_relaxation
        Likewise: phi, theta (rad), p, q (rad/s); servos 1, 2; see ``roll_pitch_scaling``.
    velocity_scaling, velocity_weights, velocity_relaxation
        Likewise: u, v (m/s); phi, theta (rad).
    position_gain : float
        1/s.
    speed_limit : float
        Of the velocity that the position loop may ask for, m/s.
    tilt_limit : float
        Of the tilt that the cascade may ask for, rad.
    command_tilt_limit : float
        Of each tilt reference of roll-pitch, whoever asks, rad.
    reference_bandwidth : float
        Of the reference filters of heave and yaw, rad/s.
    planning_charge : float
        Fraction of the battery's charge for which the heave reference's acceleration is chosen.
    heave_share : float
        Share of the acceleration then available that a heave reference may ask for.
    heave_acceleration_max, heave_speed : float
        Upper bounds of a heave reference's acceleration and speed, m/s2, m/s, whatever the motors could give.
    heave_slack : float
        By how much the height may trail its filtered reference before the reference waits for it, m.
    reference_lead : float
        Share of the loops' lag behind a reference of constant rate that is made up for.
    yaw_acceleration, yaw_rate : float
        Bounds of a yaw reference, rad/s2, rad/s.
    voltage_filter : float
        Time constant of the battery voltage's filter, s.
    """

    heave_yaw_scaling: Scaling | None = None
    heave_yaw_weights: TwoDegreeWeights = HEAVE_YAW_WEIGHTS
    heave_yaw_relaxation: float = 1.003
    roll_pitch_scaling: Scaling | None = None
    roll_pitch_weights: OneDegreeWeights = ROLL_PITCH_WEIGHTS
    roll_pitch_relaxation: float = 1.2
    velocity_scaling: Scaling = VELOCITY_SCALING
    velocity_weights: OneDegreeWeights = VELOCITY_WEIGHTS
    velocity_relaxation: float = 1.2
    position_gain: float = 1.0
    speed_limit: float = 1.5
    tilt_limit: float = 0.15
    command_tilt_limit: float = 0.35
    reference_bandwidth: float = 8.0
    planning_charge: float = 0.3
    heave_share: float = 0.37
    heave_acceleration_max: float = 1.5
    heave_speed: float = 1.0
    heave_slack: float = 0.3
    reference_lead: float = 1.0
    yaw_acceleration: float = 8.0
    yaw_rate: float = 2.0
    voltage_filter: float = 0.05


def heave_yaw_scaling(plant: control.StateSpace) -> Scaling:
    """Scaling of heave-yaw from what the motors can do.

    One scaled unit of both inputs gives 4.4 m/s2 in the end, against one metre of height error. r is scaled so that
    one unit of one input starts to turn the fuselage by 5 units of r a second, and psi by a fifth of the scale of r.
    For ``mufly-1.1`` that is 0.22 of the motor input, 1 m, 20 rad/s and 4 rad. Vehicles of another authority so get
    the same scaled plant, and much the same loop.
    """
    states = list(plant.state_labels)
    motors = [states.index("Omega_dw"), states.index("Omega_up")]
    speed = -np.linalg.solve(plant.A[np.ix_(motors, motors)], plant.B[motors])
    unit = 4.4 / abs(float((plant.A[states.index("w"), motors] @ speed).sum()))
    turn = float(np.abs(plant.B[states.index("r")]).mean())
    rate = unit * turn / 5.0
    return Scaling(outputs=(1.0, rate / 5.0, rate), inputs=(unit, unit))


def roll_pitch_scaling(plant: control.StateSpace) -> Scaling:
    """Scaling of roll-pitch from what the servos can do.

    One scaled unit of an input gives 40 rad/s2 once the swash plate has followed, against 0.5 rad of tilt or
    5 rad/s. For ``mufly-1.1`` that is about the full servo.
    """
    states = list(plant.state_labels)
    tilts = [states.index("a_dw"), states.index("b_dw")]
    tilt = -np.linalg.solve(plant.A[np.ix_(tilts, tilts)], plant.B[tilts])
    turn = np.abs(plant.A[np.ix_([states.index("p"), states.index("q")], tilts)] @ tilt).max(axis=0)
    return Scaling(outputs=(0.5, 0.5, 5.0, 5.0), inputs=tuple(float(v) for v in 40.0 / turn))
