"""From a continuous controller to difference equations at the flight rate, in numbers that survive rounding.

The bilinear (Tustin) rule integrates the controller by trapezoids: ``s = 2/T (z-1)/(z+1)`` maps the stable half plane
onto the unit disc, keeps the static gain, and adds no phase of its own beyond its warping of frequencies (below 2 % up
to a twelfth of the sampling rate). With ``v = (I - A T/2) x - B T/2 e``

    v+ = Ad v + Bd e + Md (sat(u) - u),   u = Cd v + Dd e,
    Ad = (I - A T/2)^-1 (I + A T/2),  Bd = T (I - A T/2)^-1 B,
    Cd = C (I - A T/2)^-1,            Dd = D + C (I - A T/2)^-1 B T/2,   Md = T M.

The last input is the anti-windup: the part of the command that the actuators refuse. It acts one sample later, so the
equations stay explicit.

Coordinates: real modal form. Every mode is a number, or a 2 x 2 block of a damped rotation, so rounding a
coefficient moves one mode by as much as the coefficient. In direct (polynomial) form the slow modes of these
controllers leave the unit circle even with 24-bit coefficients. Modes that nearly coincide have no good modal form; a
real Schur form (an orthogonal change of coordinates) then takes its place.

Anti-windup: while the actuators are at their limit the controller runs as ``Ad - Md Cd``. That must be stable, else the
gain is replaced by that of a Kalman filter for the pair (Ad, Cd), which is.
"""

from __future__ import annotations

from dataclasses import dataclass

import control
import numpy as np
from scipy import linalg

from mufly.control.linear import (
    Array,
    LoopAnalysis,
    altered,
    analyse,
    connect,
    sample_plant,
    state_space,
)
from mufly.dynamics import submodel
from mufly.errors import MuflyError


@dataclass(frozen=True)
class DiscreteController:
    """``x+ = A x + B e + M (sat(u) - u)``, ``u = C x + D e``, in physical units.

    Attributes
    ----------
    A, B, C, D : array
        Shapes (n, n), (n, inputs), (outputs, n), (outputs, inputs).
    M : array, shape (n, outputs)
        Anti-windup.
    period_s : float
    form : str
        ``"modal"`` or ``"schur"``.
    anti_windup : str
        ``"observer"`` (the controller's own copy of the plant learns what the actuators did) or ``"kalman"``.
    inputs, outputs : tuple of str
        Labels.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    M: Array
    period_s: float
    form: str
    anti_windup: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def order(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    def system(self) -> control.StateSpace:
        """As ``control.StateSpace``, without the anti-windup input."""
        return state_space(
            self.A, self.B, self.C, self.D, inputs=self.inputs, outputs=self.outputs, dt=self.period_s
        )


def _modal(A: Array) -> tuple[Array, Array] | None:
    """T and inv(T) with inv(T) A T real modal; None where the eigenvectors are too nearly dependent."""
    values, vectors = np.linalg.eig(A)
    columns = []
    order = np.lexsort((values.imag, -np.abs(values)))
    seen: set[int] = set()
    for i in order:
        if i in seen:
            continue
        seen.add(int(i))
        if abs(values[i].imag) > 0.0:
            partner = int(np.argmin(np.abs(values - values[i].conj())))
            seen.add(partner)
            columns += [vectors[:, i].real, vectors[:, i].imag]
        else:
            columns.append(vectors[:, i].real)
    T = np.column_stack(columns)
    T = T / np.linalg.norm(T, axis=0)
    if np.linalg.cond(T) > 1e5:
        return None
    return T, np.linalg.inv(T)


def _even_out(A: Array, B: Array, C: Array) -> Array:
    """Scale of each state that makes its input row and its output column equally long; blocks are kept."""
    n = A.shape[0]
    scale = np.ones(n)
    i = 0
    while i < n:
        block = slice(i, i + 2) if i + 1 < n and abs(A[i + 1, i]) > 1e-14 else slice(i, i + 1)
        b, c = np.linalg.norm(B[block]), np.linalg.norm(C[:, block])
        if b > 0 and c > 0:
            scale[block] = np.sqrt(b / c)
        i = block.stop
    return scale


def discretise(controller: control.StateSpace, actuation: Array, period_s: float) -> DiscreteController:
    """Discretise a controller and give it well-conditioned coordinates and an anti-windup.

    Parameters
    ----------
    controller : control.StateSpace
        Continuous, in physical units.
    actuation : array, shape (n, outputs)
        Effect on its states of an actuation beyond its own command, per unit (see ``hinf.HinfResult.actuation``).
    period_s : float

    Returns
    -------
    DiscreteController

    Raises
    ------
    MuflyError
        If the period is not positive or a mode is too fast to be stepped through.
    """
    if not (np.isfinite(period_s) and period_s > 0):
        raise MuflyError(f"discretisation: a period of {period_s} s is not possible; give a positive one")
    T = period_s
    n = controller.nstates
    left = np.eye(n) - controller.A * (T / 2)
    if n and np.linalg.cond(left) > 1e12:
        raise MuflyError(
            f"discretisation: the controller has a mode at {2 / T:.4g} rad/s; choose another rate"
        )
    A = np.linalg.solve(left, np.eye(n) + controller.A * (T / 2))
    B = T * np.linalg.solve(left, controller.B)
    C = np.linalg.solve(left.T, controller.C.T).T
    D = controller.D + C @ controller.B * (T / 2)
    M = T * actuation

    changed = _modal(A)
    form = "modal"
    if changed is None:
        form = "schur"
        _, Z = linalg.schur(A, output="real")
        changed = Z, Z.T
    S, Sinv = changed
    A, B, C, M = Sinv @ A @ S, Sinv @ B, C @ S, Sinv @ M
    A[np.abs(A) < 1e-12] = 0.0
    scale = _even_out(A, B, C)
    A, B, C, M = A * scale / scale[:, None], B / scale[:, None], C * scale, M / scale[:, None]

    anti_windup = "observer"
    if n and np.abs(np.linalg.eigvals(A - M @ C)).max() >= 1.0 - 1e-7:
        anti_windup = "kalman"
        M = _kalman(A, C)
    return DiscreteController(
        A, B, C, D, M, T, form, anti_windup, tuple(controller.input_labels), tuple(controller.output_labels)
    )


def _kalman(A: Array, C: Array) -> Array:
    """Gain M with A - M C stable: predictor for process noise spread evenly over the states."""
    W, R = 1e-4 * np.eye(A.shape[0]), np.eye(C.shape[0])
    P = linalg.solve_discrete_are(A.T, C.T, W, R)
    gain: Array = A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    return gain


LATERAL = ("x", "y", "u", "v", "phi", "theta", "p", "q", "a_dw", "b_dw", "bar_roll", "bar_pitch")
SERVOS, TILT = ("servo_1", "servo_2"), ("phi_reference", "theta_reference")


def _tilted(full: control.StateSpace, roll_pitch: DiscreteController, divider: int) -> control.StateSpace:
    """Tilt reference (phi, theta) to position and velocity (x, y, u, v), at the cascade's rate."""
    plant = sample_plant(submodel(full, LATERAL, SERVOS, LATERAL), roll_pitch.period_s, 1)
    errors = roll_pitch.inputs
    wiring: dict[str, dict[str, float]] = {servo: {f"command_{servo}": 1.0} for servo in SERVOS}
    for error, output in zip(errors, ("phi", "theta", "p", "q"), strict=True):
        wiring[error] = {output: -1.0}
    for error, reference in zip(errors[:2], TILT, strict=True):
        wiring[error][reference] = 1.0
    K = altered(roll_pitch.system(), outputs=[f"command_{servo}" for servo in SERVOS])
    loop = connect([plant, K], wiring, TILT, LATERAL[:4])
    A, B = np.eye(loop.nstates), np.zeros_like(loop.B)
    for _ in range(divider):
        A, B = loop.A @ A, loop.A @ B + loop.B
    return altered(loop, A=A, B=B, D=np.zeros((4, 2)), dt=divider * roll_pitch.period_s)


def analyse_cascade(
    full: control.StateSpace,
    roll_pitch: DiscreteController,
    velocity: DiscreteController,
    position_gain: float,
    divider: int,
) -> LoopAnalysis:
    """Analyse the position cascade with the real attitude loop below it, broken at the tilt reference.

    The velocity controller is designed on a point mass with ideal tilt (eq. 6.10). What it meets is the lateral part
    of the whole linear model (tilted rotor thrust and stabiliser bar included) under the sampled roll-pitch controller
    with one sample of delay. The tilt reference is held over ``divider`` periods of that inner loop, so with the inner
    loop ``x+ = Ai x + Bi ref`` the plant of the cascade is exactly

        x+ = Ai^divider x + (I + Ai + ... + Ai^(divider - 1)) Bi ref,   y = (x, y, u, v),

    and the cascade is the feedback ``tilt = K_vel (K_p (0 - position) - velocity)``, at zero heading.

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
    mix = np.hstack([position_gain * np.eye(2), np.eye(2)])
    K = velocity.system()
    K = altered(K, B=K.B @ mix, D=K.D @ mix, inputs=LATERAL[:4], outputs=TILT)
    return analyse(_tilted(full, roll_pitch, divider), K)
