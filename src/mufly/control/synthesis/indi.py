"""Incremental nonlinear dynamic inversion (INDI) of roll and pitch, written as a linear controller.

The angular acceleration is measured instead of modelled: ``wdot_f = H(s) s w`` from the gyroscopes. The servos move
from their present position in proportion to the error of the angular acceleration (Smeur, Chu and de Croon, J. Guid.
Control Dyn. 39, 2016)::

    u = H(s) A(s) u_act + G^-1 (nu - wdot_f),      nu = k_w (k_a (r - att) - w)

``G`` is the angular acceleration per servo input once the swash plate has settled. ``A(s)`` is the model of the
servos: their lag, and a second lag that stands for hold, computation and gyroscope filter, so that commands and
measurements are late by the same time. ``H(s) = omega^2 / (s^2 + 2 zeta omega s + omega^2)`` filters both alike.
Moments of the stabiliser bar and of gusts are part of ``wdot_f``; no model of them enters.

One filter serves both terms, since ``H`` is linear: with ``v = H (A u_act + G^-1 s e_w)`` and ``e_w = -w``::

    z1' = z2 - 2 zeta omega z1 + omega^2 G^-1 e_w
    z2' = omega^2 (a2 - z1)
    a1' = (u_act - a1) / T_1,   a2' = (a1 - a2) / T_2,   u = z1 + G^-1 nu

``T_1 + T_2`` is servo lag and delay, ``T_1`` the servo lag or half of both: a law that samples cannot know a faster
one. That is four states an axis. The law is linear in errors and actuation: reduction, discretisation, margins,
export and the code on board are those of the other methods. ``u_act`` is the saturated command, so it needs no other
anti-windup. A small leak of ``a2`` keeps the law's integrator stable. ``G`` is constant: the lower rotor's thrust at
hover.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import control
import numpy as np

from mufly.control.linear_systems import Array, state_space
from mufly.errors import MuflyError

_INTEGRATOR_LEAK_FRACTION = (
    0.002  # fraction of the servo model's output that is lost, which makes the integrator a slow pole
)
_RATE_FILTER_DAMPING = 0.7


@dataclass(frozen=True)
class IndiGains:
    """Gains of incremental nonlinear dynamic inversion (INDI).

    Attributes
    ----------
    attitude, rate : float
        Gains ``k_a`` from tilt to rate and ``k_w`` from rate to angular acceleration (1/s).
    filter_rad_s : float
        Frequency omega of the filter of the angular acceleration.
    delay_periods : float
        Delay of commands against measurements, in periods of the law: hold, computation and gyroscope filter.
    """

    attitude: float = 12.0
    rate: float = 12.0
    filter_rad_s: float = 50.0
    delay_periods: float = 3.0


class IndiLaw(NamedTuple):
    """The INDI control law in scaled units.

    Attributes
    ----------
    controller : control.StateSpace
        From errors of phi, theta, p, q to the servos; eight states.
    anti_windup_matrix : array, shape (8, 2)
        Effect of actuation beyond the command on the states.
    effectiveness : array, shape (2, 2)
        ``G``, in scaled units: change of the scaled rates per second and scaled input.
    """

    controller: control.StateSpace
    anti_windup_matrix: Array
    effectiveness: Array


def design_indi(plant: control.StateSpace, gains: IndiGains, period_s: float) -> IndiLaw:
    """Return the INDI law of roll-pitch.

    Parameters
    ----------
    plant : control.StateSpace
        Scaled plant with outputs phi, theta, p, q and states ``a_dw``, ``b_dw`` of the swash plate.
    gains : IndiGains
    period_s : float
        Period of the law (s).

    Raises
    ------
    MuflyError
        If the servos cannot turn the vehicle about both axes.
    """
    states = list(plant.state_labels)
    plate = [states.index("a_dw"), states.index("b_dw")]
    lag = -plant.A[np.ix_(plate, plate)]
    settled = np.linalg.solve(lag, plant.B[plate])
    G = plant.C[2:] @ plant.A[:, plate] @ settled
    if not np.linalg.cond(G) < 1e6:
        raise MuflyError("INDI: the servos do not turn the vehicle about both axes; check the swash plate's linkage")
    inverse = np.linalg.inv(G)
    # The scaled rate of tilt that belongs to a scaled rate of rotation.
    kinematics = plant.C[:2] @ plant.A @ np.linalg.pinv(plant.C[2:])
    command = inverse @ (gains.rate * np.hstack([gains.attitude * np.linalg.inv(kinematics), np.eye(2)]))
    w, one, none = gains.filter_rad_s, np.eye(2), np.zeros((2, 2))
    total = 1.0 / float(lag.diagonal().mean()) + gains.delay_periods * period_s
    slower = max(1.0 / float(lag.diagonal().mean()), 0.5 * total)
    servo, delay = one / slower, total - slower
    model = np.block([
        [-2.0 * _RATE_FILTER_DAMPING * w * one, one, none, none],
        [-w * w * one, none, none, (1.0 - _INTEGRATOR_LEAK_FRACTION) * w * w * one],
        [none, none, -servo, none],
        [none, none, one / delay, -one / delay],
    ])  # fmt: skip
    actuation = np.vstack([none, none, servo, none])
    C = np.hstack([one, none, none, none])
    B = np.vstack([np.hstack([none, w * w * inverse]), np.zeros((6, 4))])
    K = state_space(
        model + actuation @ C, B + actuation @ command, C, command,
        inputs=[f"error[{name}]" for name in plant.output_labels], outputs=plant.input_labels,
    )  # fmt: skip
    return IndiLaw(K, actuation, G)
