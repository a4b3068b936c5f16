"""The position cascade with the real attitude loop below it, in discrete time and without simplification.

The velocity controller is designed on a point mass with ideal tilt (eq. 6.10). What it meets is the lateral part
of the whole linear model (tilted rotor thrust and stabiliser bar included) under the sampled roll-pitch controller with
one sample of delay. The tilt reference is held over ``divider`` periods of that inner loop, so with the inner loop
``x+ = Ai x + Bi ref`` the plant of the cascade is exactly

    x+ = Ai^divider x + (I + Ai + ... + Ai^(divider - 1)) Bi ref,   y = (x, y, u, v),

and the cascade is the feedback ``tilt = K_vel (K_p (0 - position) - velocity)``, at zero heading.
"""

from __future__ import annotations

import control
import numpy as np

from mufly.control.analysis import LoopAnalysis, analyse, sample_plant
from mufly.control.discretise import DiscreteController
from mufly.control.linear import connect, state_space

__all__ = ["analyse_cascade", "inner_loop", "outer_feedback"]

LATERAL = ("x", "y", "u", "v", "phi", "theta", "p", "q", "a_dw", "b_dw", "bar_roll", "bar_pitch")
OUTPUTS = ("x", "y", "u", "v")


def lateral_plant(full: control.StateSpace) -> control.StateSpace:
    """The lateral part of the whole linear model: servos to all lateral states."""
    states, inputs = list(full.state_labels), list(full.input_labels)
    i = [states.index(name) for name in LATERAL]
    j = [inputs.index(name) for name in ("servo_1", "servo_2")]
    n = len(i)
    return state_space(
        full.A[np.ix_(i, i)],
        full.B[np.ix_(i, j)],
        np.eye(n),
        np.zeros((n, 2)),
        inputs=("servo_1", "servo_2"),
        outputs=LATERAL,
        states=LATERAL,
    )


def inner_loop(full: control.StateSpace, roll_pitch: DiscreteController, divider: int) -> control.StateSpace:
    """Tilt reference (phi, theta) to position and velocity, at the cascade's rate.

    Parameters
    ----------
    full : control.StateSpace
        ``Linearisation.full``.
    roll_pitch : DiscreteController
    divider : int
        Periods of the inner loop in one of the cascade.
    """
    plant = sample_plant(lateral_plant(full), roll_pitch.period_s, 1)
    errors, references = list(roll_pitch.inputs), ("phi_reference", "theta_reference")
    measured = ("phi", "theta", "p", "q")
    wiring: dict[str, dict[str, float]] = {"servo_1": {"command_1": 1.0}, "servo_2": {"command_2": 1.0}}
    for error, output in zip(errors, measured, strict=True):
        wiring[error] = {output: -1.0}
    for error, reference in zip(errors[:2], references, strict=True):
        wiring[error][reference] = 1.0
    K = roll_pitch.system()
    K = state_space(K.A, K.B, K.C, K.D, inputs=errors, outputs=("command_1", "command_2"), dt=K.dt)
    loop = connect([plant, K], wiring, references, OUTPUTS)
    A, B = np.eye(loop.nstates), np.zeros_like(loop.B)
    for _ in range(divider):
        A, B = loop.A @ A, loop.A @ B + loop.B
    return state_space(
        A,
        B,
        loop.C,
        np.zeros((4, 2)),
        inputs=references,
        outputs=OUTPUTS,
        dt=divider * roll_pitch.period_s,
    )


def outer_feedback(velocity: DiscreteController, position_gain: float) -> control.StateSpace:
    """``tilt = -K (x, y, u, v)``."""
    mix = np.hstack([position_gain * np.eye(2), np.eye(2)])
    return state_space(
        velocity.A,
        velocity.B @ mix,
        velocity.C,
        velocity.D @ mix,
        inputs=OUTPUTS,
        outputs=("phi_reference", "theta_reference"),
        dt=velocity.period_s,
    )


def analyse_cascade(
    full: control.StateSpace,
    roll_pitch: DiscreteController,
    velocity: DiscreteController,
    position_gain: float,
    divider: int,
) -> LoopAnalysis:
    """Analyse the whole cascade, broken at the tilt reference.

    Parameters
    ----------
    full : control.StateSpace
        ``Linearisation.full``.
    roll_pitch, velocity : DiscreteController
        The latter at ``divider`` times the period of the former.
    position_gain : float
        1/s.
    divider : int

    Returns
    -------
    LoopAnalysis
    """
    return analyse(inner_loop(full, roll_pitch, divider), outer_feedback(velocity, position_gain))
