"""Design the fixed-point control law for processors without a floating-point unit, and prove it free of overflow.

Signals (m, m/s, rad, rad/s, V, shares of full throw) are 32-bit multiples of 2^-20. Coefficients are 16-bit integers
and states 32-bit integers, each with its own power of two. A row of a controller is a sum of products in 64 bits,
rounded once to the nearest value, halves away from zero.

**Scaling.** A controller ``x+ = A x + B e + M (v - u)``, ``u = C x + D e``, with the actuator output ``v``, equals

    x+ = (A - M C) x + (B - M D) e + M v.

The anti-windup gain M makes this form stable. Its inputs are bounded: errors and actuator outputs are limited. With the
impulse responses ``h`` of a state's row, every state is bounded by

    |x_i| <= sum_j |e_j|max sum_k |h_ij[k]| + ... = bound_i                          (the L1 norm; Jackson 1970),

summed to K terms, with the remainder ``S <= S_K + |(A - M C)^K| S``. The state's power of two keeps the bound below
2^30. :class:`OverflowProof` repeats the calculation with the *rounded* coefficients. It includes the rounding of states
and outputs as further inputs, and the state at engagement as the initial state.

**Form.** The candidates are two coordinate systems, modal (of the design) and balanced (Gramians of the stable form),
and two update forms: ``x+ = A x + ...`` (shift) and ``x+ = x + (A - I) x + ...`` (delta; Middleton and Goodwin 1986).
The delta form keeps all bits of a slow mode's small coefficient. Each candidate replaces the exact controller in its
sampled loop with a sample of delay; the one with the least loss of margins and peaks is chosen.

Sources: Jackson, L. B., Bell System Technical Journal 49 (1970) 159; Middleton, R. H. and Goodwin, G. C., IEEE Trans.
Automatic Control 31 (1986) 1015. Own derivation otherwise. Thesis: Sec. 6.1.7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mufly.control import FlightController
from mufly.control.implementation import DiscreteController, analyse_position_cascade, balancing_transform
from mufly.control.linear_systems import Array, LoopAnalysis, analyse_loop, replace_matrices, sample_plant
from mufly.dynamics import linearise_vehicle
from mufly.errors import MuflyError
from mufly.results import ResultColumn, ShownBlock, result, tabulate_results
from mufly.vehicle import Vehicle

_IntArray = NDArray[np.int64]

FRACTION_BITS = 20
"""Number of fraction bits of every signal."""

SATURATION_EXCESS_FRACTION_BITS = 16
"""Number of fraction bits of the saturation excess; fewer, since an unlimited command can be large."""

ERROR_LIMITS = {
    "heave_yaw": (64.0, 512.0, 64.0, 512.0, 32.0),  # z and heading relative to engagement; r
    "roll_pitch": (4.0, 4.0, 32.0, 32.0),
    "position": (32.0, 32.0),
}
"""Limits of the control errors (m, rad, rad/s; m/s)."""

ACTUATION_LIMITS = {"heave_yaw": 1.5, "roll_pitch": 1.5, "position": 8.0}
"""Largest actuator outputs without trim: voltage ratio to the design (measured ratios are limited to 1.5); tilt with a
feedforward of 64 m/s2 (rad)."""

_MAX_STATE_BITS = 30
STATE_FORMS = (("modal", True), ("modal", False), ("balanced", True), ("balanced", False))


@dataclass(frozen=True)
class CoefficientRows:
    """Matrix of a fixed-point controller: integer coefficients, and the shifts that scale their products and sums.

    A coefficient represents ``c 2^-bits``; ``left_shift`` aligns the products of a row to one power of two.

    Attributes
    ----------
    coefficients, left_shift : arrays of int, shape (rows, inputs)
        Integer coefficients, and left shift of each product (bits).
    right_shift : array of int, shape (rows,)
        Right shift of the sum (bits).
    quantised_values : array, shape (rows, inputs)
        Real values of the coefficients.
    """

    coefficients: _IntArray
    left_shift: _IntArray
    right_shift: _IntArray
    quantised_values: Array


@result
class OverflowProof:
    """Bounds of the states and sums of a fixed-point controller, valid for any inputs in their ranges.

    Attributes
    ----------
    controller : str
    form : str
    state_bound_shares : array, shape (n,)
        Bound of each state over 2^31, the range of 32 bits (1).
    sum_bound_shares : array
        Bound of each sum of products over 2^63 (1).
    saturation_excess_bound_share : float
        Bound of the saturation excess over 2^31 (1).
    max_pole_magnitude : float
        Greatest magnitude of a pole of the stable form, with rounded coefficients (1).
    """

    controller: str
    form: str
    state_bound_shares: Array
    sum_bound_shares: Array
    saturation_excess_bound_share: float
    max_pole_magnitude: float

    @property
    def is_overflow_free(self) -> bool:
        """Return whether the proof holds: no state or sum can exceed its integer range, and the poles are stable."""
        return bool(
            max(self.state_bound_shares.max(), self.sum_bound_shares.max(), self.saturation_excess_bound_share) < 1.0
            and self.max_pole_magnitude < 1.0
        )


@result
class QuantisationLoss:
    """Loss of a loop's stability margins due to rounded coefficients.

    Attributes
    ----------
    loop : str
    form : str
    peaks_dB : float
        Growth of the peak of S_u or T_u, whichever grows more.
    gain_dB : float
        Loss of gain margin or gain reduction, whichever is larger.
    phase_dB, delay_dB : float
        Loss of the phase and delay margins, as ratios.
    worst_dB : float
        Largest of these losses.
    """

    loop: str
    form: str
    peaks_dB: float
    gain_dB: float
    phase_dB: float
    delay_dB: float
    worst_dB: float


@dataclass(frozen=True)
class FixedPointController:
    """A linear controller in fixed point.

    Attributes
    ----------
    name, form : str
    is_delta_form : bool
    state_fraction_bits : tuple of int
        Fraction bits of each state.
    update_rows, output_rows, start_rows : CoefficientRows
        Rows from states, errors and saturation excess to the next state; from states and errors to the command; from
        errors and the command to the state at engagement.
    proof : OverflowProof
    """

    name: str
    form: str
    is_delta_form: bool
    state_fraction_bits: tuple[int, ...]
    update_rows: CoefficientRows
    output_rows: CoefficientRows
    start_rows: CoefficientRows
    proof: OverflowProof

    def to_state_space(self, of: DiscreteController) -> control.StateSpace:
        """Return the controller with its rounded coefficients as a system, labelled as the exact controller ``of``."""
        n = len(self.state_fraction_bits)
        A = self.update_rows.quantised_values[:, :n] + (np.eye(n) if self.is_delta_form else 0.0)
        m = self.output_rows.coefficients.shape[1] - n
        return replace_matrices(
            of.to_state_space(), A=A, B=self.update_rows.quantised_values[:, n : n + m],
            C=self.output_rows.quantised_values[:, :n], D=self.output_rows.quantised_values[:, n:],
        )  # fmt: skip


def _quantise_rows(W: Array, bits_in: Array, bits_out: Array, most: Array) -> CoefficientRows:
    """Return 16-bit coefficients of a matrix ``W`` for inputs of magnitude up to ``most`` times 2^-bits_in."""
    rows, columns = W.shape
    c, up, own = (np.zeros((rows, columns), dtype=np.int64) for _ in range(3))
    down = np.zeros(rows, dtype=np.int64)
    for i in range(rows):
        size = np.abs(W[i])
        used = size > 0.0
        if not used.any():
            continue
        # As many bits as fit in 16: a number of 2^k has 14 - k fraction bits.
        own[i, used] = 14 - np.floor(np.log2(size[used])).astype(np.int64)
        great = float(np.sum(size * most * 2.0**-bits_in))
        point = min(int((bits_in + own[i])[used].max()), 61 - math.ceil(math.log2(great)))
        if point < bits_out[i]:
            raise MuflyError(
                f"fixed point: a sum of up to {great:.3g} leaves {point} bits of {bits_out[i]}; the controller's "
                "numbers are too far apart for 64 bits"
            )
        own[i] = np.minimum(own[i], point - bits_in)
        c[i] = np.rint(W[i] * 2.0 ** own[i])
        if np.abs(c[i]).max() > 32767:
            over = np.abs(c[i]) > 32767
            own[i, over] -= 1
            c[i, over] = np.rint(W[i, over] * 2.0 ** own[i, over])
        c[i, own[i] < 0] = 0  # negligible beside the other products
        up[i] = np.where(c[i] != 0, point - bits_in - own[i], 0)
        down[i] = point - bits_out[i]
    return CoefficientRows(c, up, down, c * 2.0 ** -own.astype(float))


def _impulse_bounds(A: Array, B: Array, C: Array, terms: int = 4096) -> tuple[Array, Array]:
    """Return upper bounds of ``sum_k |A^k B|`` and ``sum_k |C A^k B|``, element by element."""
    X, total, seen = B.copy(), np.zeros_like(B), np.zeros((len(C), B.shape[1]))
    for _ in range(terms):
        total += np.abs(X)
        seen += np.abs(C @ X)
        X = A @ X
    rest = np.abs(np.linalg.matrix_power(A, terms))
    if np.abs(np.linalg.eigvals(rest)).max(initial=0.0) >= 1.0:
        raise MuflyError("fixed point: the controller states have no bound while actuators saturate")
    whole = np.linalg.solve(np.eye(len(A)) - rest, total)
    return whole, seen + np.abs(C) @ rest @ whole


def _transient_bound(A: Array, B: Array, most: Array, terms: int = 4096) -> Array:
    """Return an upper bound over k of ``|A^k B| most``."""
    X, great = B.copy(), np.zeros(len(A))
    for _ in range(terms):
        great = np.maximum(great, np.abs(X) @ most)
        X = A @ X
    rest = np.abs(np.linalg.matrix_power(A, terms))
    return np.asarray(np.maximum(great, rest.sum(1).max() * great.max()))


def quantise_controller(name: str, gains: np.void, form: str = "modal", delta: bool = True) -> FixedPointController:
    """Convert one of the three controllers to fixed point, and compute the bounds that exclude an overflow.

    Parameters
    ----------
    name : str
        ``"heave_yaw"``, ``"roll_pitch"`` or ``"position"``.
    gains : record
        Gains of this name of a :class:`mufly.control.FlightController`.
    form : str
        ``"modal"`` (as designed) or ``"balanced"``.
    delta : bool
        Whether to use the delta form.

    Raises
    ------
    MuflyError
        If a state has no bound, or the bound exceeds its bits.
    """
    F, B, C, D, M, E, U = (np.array(gains[k]) for k in "FBCDMEU")
    A: Array = F + np.eye(len(F))
    errors, most = np.array(ERROR_LIMITS[name]), np.full(2, ACTUATION_LIMITS[name])
    if form == "balanced":
        A, B, C, M, E, U = _balance_coordinates(A, B, C, D, M, E, U, errors, most)
    n = len(A)
    inputs = np.hstack([B - M @ D, M])
    begun = np.hstack([E, U])
    engaged = np.concatenate([errors, most + 1.0])
    stable = A - M @ C
    forced, commanded = _impulse_bounds(stable, inputs, C)
    inputs_most, begins = np.concatenate([errors, most]), _transient_bound(stable, begun, engaged)
    bound = forced @ inputs_most + begins
    bits = np.array(
        [
            min(_MAX_STATE_BITS, _MAX_STATE_BITS - math.ceil(math.log2(b))) if b > 0.0 else _MAX_STATE_BITS
            for b in bound * 1.01
        ]
    )
    signal = np.full(len(errors), FRACTION_BITS)
    refused = commanded @ inputs_most + np.abs(C) @ begins + np.abs(D) @ errors + most
    top_x, top_e = bound * 2.0**bits, errors * 2.0**FRACTION_BITS
    change = A - np.eye(n) if delta else A
    update = _quantise_rows(
        np.hstack([change, B, M]), np.concatenate([bits, signal, [SATURATION_EXCESS_FRACTION_BITS] * 2]), bits,
        np.concatenate([top_x, top_e, refused * 2.0**SATURATION_EXCESS_FRACTION_BITS]),
    )  # fmt: skip
    output = _quantise_rows(
        np.hstack([C, D]),
        np.concatenate([bits, signal]),
        np.full(2, FRACTION_BITS),
        np.concatenate([top_x, top_e]),
    )
    start = _quantise_rows(begun, np.full(len(errors) + 2, FRACTION_BITS), bits, engaged * 2.0**FRACTION_BITS)
    label = f"{form}, {'delta' if delta else 'shift'}"
    made = FixedPointController(
        name, label, delta, tuple(int(b) for b in bits), update, output, start,
        OverflowProof(name, label, np.zeros(n), np.zeros(1), 0.0, 0.0),
    )  # fmt: skip
    return replace(made, proof=_prove_no_overflow(made, errors, most, engaged))


def _balance_coordinates(
    A: Array, B: Array, C: Array, D: Array, M: Array, E: Array, U: Array, errors: Array, most: Array
) -> tuple[Array, ...]:
    """Return ``A, B, C, M, E, U`` of a controller in balanced coordinates.

    These balance the Gramians of its stable form ``x+ = (A - M C) x + ...`` (see the module's docstring).

    Padding states are not transformed.
    """
    n = int(np.max(np.flatnonzero(np.abs(A).sum(0) + np.abs(B).sum(1) + np.abs(C).sum(0)), initial=0)) + 1
    F, G = A[:n, :n] - M[:n] @ C[:, :n], np.hstack([(B - M @ D)[:n], M[:n]])
    G = G * np.concatenate([np.minimum(errors, 1.0), np.minimum(most, 1.0)])
    P = linalg.solve_discrete_lyapunov(F, G @ G.T)
    Q = linalg.solve_discrete_lyapunov(F.T, C[:, :n].T @ C[:, :n])
    T, inverse = balancing_transform(P, Q)
    pad = np.eye(len(A) - n)
    T, inverse = linalg.block_diag(T, pad), linalg.block_diag(inverse, pad)
    return inverse @ A @ T, inverse @ B, C @ T, inverse @ M, inverse @ E, inverse @ U


def _prove_no_overflow(made: FixedPointController, errors: Array, most: Array, engaged: Array) -> OverflowProof:
    """Return bounds of all states and sums of a controller with rounded coefficients and rounded signals."""
    n, m = len(made.state_fraction_bits), len(errors)
    lsb = 2.0 ** -np.array(made.state_fraction_bits, dtype=float)
    A = made.update_rows.quantised_values[:, :n] + (np.eye(n) if made.is_delta_form else 0.0)
    B, M = made.update_rows.quantised_values[:, n : n + m], made.update_rows.quantised_values[:, n + m :]
    C, D = made.output_rows.quantised_values[:, :n], made.output_rows.quantised_values[:, n:]
    stable = A - M @ C
    # Rounding by half a step: of each state, and through M of the command and the saturation excess.
    rounding = np.hstack(
        [np.diag(lsb / 2.0), M * (2.0 ** -(FRACTION_BITS + 1) + 2.0 ** -(SATURATION_EXCESS_FRACTION_BITS + 1))]
    )
    forced, commanded = _impulse_bounds(stable, np.hstack([B - M @ D, M, rounding]), C)
    inputs = np.concatenate([errors, most, np.ones(n + 2)])
    begun = _transient_bound(
        stable,
        np.hstack([made.start_rows.quantised_values, np.diag(lsb)]),
        np.concatenate([engaged, np.ones(n)]),
    )
    bound = forced @ inputs + begun
    command = commanded @ inputs + np.abs(C) @ begun + np.abs(D) @ errors
    top_x, top_e, top_r = (
        bound / lsb,
        errors * 2.0**FRACTION_BITS,
        (command + most + 1e-3) * 2.0**SATURATION_EXCESS_FRACTION_BITS,
    )
    sums = np.concatenate(
        [
            _bound_sums(made.update_rows, np.concatenate([top_x, top_e, top_r])),
            _bound_sums(made.output_rows, np.concatenate([top_x, top_e])),
            _bound_sums(made.start_rows, engaged * 2.0**FRACTION_BITS),
        ]
    )
    return OverflowProof(
        made.name, made.form, top_x / 2.0**31, sums / 2.0**63, float(top_r.max() / 2.0**31),
        float(np.abs(np.linalg.eigvals(stable)).max()),
    )  # fmt: skip


def _bound_sums(rows: CoefficientRows, most: Array) -> Array:
    return np.asarray((np.abs(rows.coefficients) * 2.0**rows.left_shift) @ most + 2.0**rows.right_shift)


_DESIGN_NAME_BY_LOOP = {"heave_yaw": "heave_yaw", "roll_pitch": "roll_pitch", "position": "velocity"}


def measure_quantisation_margin_loss(controller: FlightController, made: FixedPointController) -> QuantisationLoss:
    """Return the margin loss of one controller's loop, sampled and with a sample of delay."""
    of = getattr(controller, _DESIGN_NAME_BY_LOOP[made.name])
    exact: DiscreteController = of.discrete
    K = _strip_padding(made, exact)
    found = analyse_loop(
        sample_plant(of.plant, exact.period_s, 1),
        of.feedback_controller(K),
        output_scale=np.array(of.scaling.outputs),
    )
    return _compare_loops(_DESIGN_NAME_BY_LOOP[made.name].replace("_", "-"), made.form, of.sampled_loop, found)


def _strip_padding(made: FixedPointController, exact: DiscreteController) -> control.StateSpace:
    K = made.to_state_space(replace(exact, **_padded_matrices(exact, len(made.state_fraction_bits))))
    n = exact.order
    return replace_matrices(K, A=K.A[:n, :n], B=K.B[:n], C=K.C[:, :n])


def _padded_matrices(exact: DiscreteController, n: int) -> dict[str, Any]:
    more = n - exact.order
    return {
        "A": linalg.block_diag(exact.A, np.zeros((more, more))),
        "B": np.vstack([exact.B, np.zeros((more, exact.B.shape[1]))]),
        "C": np.hstack([exact.C, np.zeros((2, more))]),
    }


def _compare_loops(loop: str, form: str, before: LoopAnalysis, after: LoopAnalysis) -> QuantisationLoss:
    if not after.stable:
        return QuantisationLoss(loop, form, math.inf, math.inf, math.inf, math.inf, math.inf)

    def margin_drop(a: float, b: float) -> float:
        return 0.0 if a == b else a - b

    def ratio_dB(a: float, b: float) -> float:
        return 0.0 if a == b else 20.0 * math.log10(a / b)

    peaks = max(
        margin_drop(after.sensitivity_peak_dB, before.sensitivity_peak_dB),
        margin_drop(after.complementary_peak_dB, before.complementary_peak_dB),
    )
    gain = max(
        margin_drop(before.gain_margin_dB, after.gain_margin_dB),
        margin_drop(after.gain_reduction_dB, before.gain_reduction_dB),
    )
    phase = ratio_dB(before.phase_margin_deg, after.phase_margin_deg)
    delay = ratio_dB(before.delay_margin_s, after.delay_margin_s)
    return QuantisationLoss(loop, form, peaks, gain, phase, delay, max(peaks, gain, phase, delay))


@dataclass(frozen=True)
class FixedPointLaw:
    """The three controllers of a vehicle in fixed point.

    Attributes
    ----------
    heave_yaw, roll_pitch, position : FixedPointController
    candidate_losses : tuple of QuantisationLoss
        Losses of all candidate forms.
    """

    heave_yaw: FixedPointController
    roll_pitch: FixedPointController
    position: FixedPointController
    candidate_losses: tuple[QuantisationLoss, ...]

    @property
    def controllers(self) -> tuple[FixedPointController, FixedPointController, FixedPointController]:
        """Return the controllers of heave-yaw, roll-pitch and position."""
        return self.heave_yaw, self.roll_pitch, self.position

    @property
    def chosen_losses(self) -> tuple[QuantisationLoss, ...]:
        """Return the loss of stability margins of each controller in its chosen fixed-point form."""
        forms = [c.form for c in self.controllers]
        loops = [_DESIGN_NAME_BY_LOOP[c.name].replace("_", "-") for c in self.controllers]
        return tuple(
            one
            for one in self.candidate_losses
            if any(one.loop == w and one.form == f for w, f in zip(loops, forms, strict=True))
        )

    def make_printed_blocks(self, *more: QuantisationLoss) -> list[ShownBlock]:
        """Return as printed text the losses of all forms, ``more`` losses of chosen forms, and the overflow proofs."""
        chosen = (*self.chosen_losses, *more)
        losses = (*self.candidate_losses, *more)
        figures = (ResultColumn(name, form=".4f") for name in ("peaks_dB", "gain_dB", "phase_dB", "delay_dB"))
        bounds = (
            ResultColumn("state_bound_shares.max", form=".2f", head="state of 32 bits"),
            ResultColumn("sum_bound_shares.max", form=".2f", head="sum of 64 bits"),
            ResultColumn("saturation_excess_bound_share", form=".2f", head="saturation excess"),
            ResultColumn("max_pole_magnitude", form=".5f"),
        )
        return [
            tabulate_results(
                losses, ("loop", "form", *figures), title="Loss of margins by 16-bit coefficients",
                names=["chosen" if one in chosen else "" for one in losses],
            ),
            tabulate_results(
                [c.proof for c in self.controllers], ("controller", "form", *bounds),
                title="Bounds for any inputs, as shares of the number range (L1 norm)",
            ),
        ]  # fmt: skip


def quantise_law(controller: FlightController) -> FixedPointLaw:
    """Convert a vehicle's controllers to fixed point, each in the form with the least loss.

    Raises
    ------
    MuflyError
        If no form of a controller is bounded and stable, or roll-pitch is scheduled over speed.
    """
    if controller.schedule is not None:
        raise MuflyError("fixed point: the law has no schedule over speed; design by another method, such as fixed")
    found: dict[str, FixedPointController] = {}
    losses: list[QuantisationLoss] = []
    for name in _DESIGN_NAME_BY_LOOP:
        tried = []
        for form, delta in STATE_FORMS:
            try:
                made = quantise_controller(name, getattr(controller, f"{name}_gains"), form, delta)
            except MuflyError:
                continue
            lost = measure_quantisation_margin_loss(controller, made)
            losses.append(lost)
            if made.proof.is_overflow_free and math.isfinite(lost.worst_dB):
                tried.append((lost.worst_dB, made))
        if not tried:
            raise MuflyError(f"fixed point: {name.replace('_', '-')} has no form that is bounded and stable")
        # Losses below 0.01 dB count as equal; the design form, listed first, has the most zero coefficients.
        found[name] = next((made for lost, made in tried if lost < 0.01), min(tried, key=lambda t: t[0])[1])
    return FixedPointLaw(**found, candidate_losses=tuple(losses))


def measure_cascade_margin_loss(vehicle: Vehicle, controller: FlightController, law: FixedPointLaw) -> QuantisationLoss:
    """Return the margin loss of the position loop with fixed-point roll-pitch and position controllers."""
    before = controller.cascade_loop
    exact = (controller.roll_pitch.discrete, controller.velocity.discrete)
    rounded = []
    for made, of in zip((law.roll_pitch, law.position), exact, strict=True):
        K = _strip_padding(made, of)
        rounded.append(replace(of, A=K.A, B=K.B, C=K.C, D=K.D))
    full = linearise_vehicle(vehicle, voltage=controller.voltage_V).full
    after = analyse_position_cascade(
        full, rounded[0], rounded[1], controller.settings.position_gain, controller.position_divider
    )
    return _compare_loops("position", f"{law.roll_pitch.form}; {law.position.form}", before, after)
