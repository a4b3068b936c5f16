"""Robust stability over a vehicle's uncertain parameters: bounds of mu over frequency, and the worst parameters.

The affine model ``[A B] = [A0 B0] + sum z_i L_i R_i`` of :mod:`mufly.control.robust.parameter_spreads`, with every
component of z within -1 to 1, makes every z_i a real scalar block. The loop from the scalars' outputs to their inputs,
closed by the controller and 1.5 periods of delay (hold and computation), is M.

``mu(M(j w)) < 1 / k`` at every frequency proves stability for all z within k. An example proves the other side: the
smallest k for which some z of size k puts a closed-loop pole on the axis. The affine loop has its least damped pole at
corners of the box in nearly all cases, so signs of the pole's derivatives lead from corner to corner.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import control
import numpy as np
from scipy import linalg, signal

from mufly.control.linear_systems import Array, ComplexArray, frequency_response
from mufly.control.robust.parameter_spreads import (
    default_spreads,
    differentiate_plants_by_parameters,
    factor_derivatives,
    parameter_values,
)
from mufly.control.robust.structured_singular_value import Block, mu_upper_bound
from mufly.errors import ArgumentError, InputError, MuflyError
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.vehicle import Vehicle, replace_parameters

if TYPE_CHECKING:
    from mufly.control.controller_design import ControllerDesign
    from mufly.control.designs import FlightController

_INPUT_DELAY_PERIODS = 1.5
_MIN_SPREAD_FACTOR, _MAX_SPREAD_FACTOR = 0.1, 10.0  # of the spreads, in the search for the worst parameters
_MU_DESCENT_END_FRACTION = 0.8  # fraction of the lower bound's peak at which the descent of the upper bound ends


@result
class LoopRobustness:
    """Bounds of mu of one loop.

    Attributes
    ----------
    name : str
    frequency : array, shape (n,)
        Frequencies (rad/s).
    upper_bound : array, shape (n,)
        Upper bound of mu. The bound is tight near its peak; elsewhere the minimisation ends at 0.8 of
        ``peak_lower_bound``.
    peak, peak_frequency : float
        Its largest value and frequency.
    peak_lower_bound, peak_lower_bound_frequency : float
        Lower bound by the worst parameters found, and the frequency of the pole on the axis; 0 if none is found.
    worst : dict
        Components of z at the lower bound, by the names of the directions, in units of their spread.
    block_sizes : tuple of int
        Size of every real block.
    processor_time_s : float
        Processor time for both bounds.
    """

    name: str
    frequency: Array
    upper_bound: Array
    peak: float
    peak_frequency: float
    peak_lower_bound: float
    peak_lower_bound_frequency: float
    worst: dict[str, float]
    block_sizes: tuple[int, ...]
    processor_time_s: float


@result
class ParameterRobustness:
    """Bounds of mu of heave-yaw and roll-pitch over a vehicle's parameters.

    Attributes
    ----------
    vehicle_name : str
    method : str
        Method of synthesis of the controllers.
    spreads : dict
        Spread of every parameter (SI), by key: half the range, or the row's length of a correlated spread.
    heave_yaw, roll_pitch : LoopRobustness
    worst_values : dict
        Parameters (SI) of the worst vehicle within the spreads, or at the boundary of stability if that is nearer. A
        value beyond the range of its parameter is the range's end.
    worst_loop : str
        Loop for which these parameters are the worst.
    """

    vehicle_name: str
    method: str
    spreads: dict[str, float]
    heave_yaw: LoopRobustness
    roll_pitch: LoopRobustness
    worst_values: dict[str, float]
    worst_loop: str

    @property
    def loop_results(self) -> tuple[LoopRobustness, LoopRobustness]:
        """Results of both loops: heave-yaw and roll-pitch."""
        return self.heave_yaw, self.roll_pitch

    def as_record(self) -> dict[str, Any]:
        """Return every loop's bounds of mu and the worst parameters as JSON data."""
        return {
            "vehicle": self.vehicle_name,
            "method": self.method,
            "spreads": self.spreads,
            "loops": [
                {
                    "name": x.name,
                    "mu_upper": x.peak,
                    "mu_upper_frequency_rad_s": x.peak_frequency if x.peak else None,
                    "mu_lower": x.peak_lower_bound,
                    "mu_lower_frequency_rad_s": x.peak_lower_bound_frequency if x.peak_lower_bound else None,
                    "worst": x.worst,
                    "block_sizes": list(x.block_sizes),
                    "frequency_rad_s": x.frequency.tolist(),
                    "mu_upper_over_frequency": x.upper_bound.tolist(),
                }
                for x in self.loop_results
            ],
            "worst_loop": self.worst_loop,
            "worst_values": self.worst_values,
        }

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the bounds of mu, the verdict and the worst parameters as printed text."""
        rows = [
            ("mu, upper bound", *(f"{x.peak:.3f}" for x in self.loop_results)),
            ("at (rad/s)", *(f"{x.peak_frequency:.3g}" for x in self.loop_results)),
            (
                "mu, lower bound",
                *(f"{x.peak_lower_bound:.3f}" if x.peak_lower_bound else "-" for x in self.loop_results),
            ),
            (
                "stable for all within (times the spreads)",
                *(f"{1 / x.peak:.2f}" if x.peak else "any" for x in self.loop_results),
            ),
            (
                "unstable at (times the spreads)",
                *(f"{1 / x.peak_lower_bound:.2f}" if x.peak_lower_bound else "-" for x in self.loop_results),
            ),
            ("real blocks, size in all", *(f"{len(x.block_sizes)}, {sum(x.block_sizes)}" for x in self.loop_results)),
        ]
        values = [(key, f"{value:.5g}", f"{self.spreads[key]:.2g}") for key, value in self.worst_values.items()]
        return [
            make_table_block(
                ("", *(x.name for x in self.loop_results)), rows, title=f"{self.vehicle_name}, {self.method}"
            ),
            make_table_block(
                ("parameter", f"worst for {self.worst_loop}", "spread"), values, title="Worst parameters, SI units"
            ),
            make_lines_block(
                *(
                    f"{x.name}: stability for all parameters within the spreads is "
                    + ("proved" if x.peak < 1 else "not proved")
                    for x in self.loop_results
                )
            ),
        ]


class UncertainLoop:
    """A control loop whose plant depends linearly on uncertain parameters (the components of z).

    The plant is given by its nominal model and its derivative by each parameter.
    """

    def __init__(self, design: ControllerDesign, derivatives: Sequence[Array]) -> None:
        self.name = design.name
        self.plant, self.feedback = design.plant, design.feedback_controller(design.reduced)
        self.delay_s = _INPUT_DELAY_PERIODS * design.discrete.period_s
        n = self.plant.nstates
        factors = factor_derivatives(derivatives, float(np.linalg.norm(self.plant.A)))
        self.kept = [i for i, (L, _) in enumerate(factors) if L.shape[1]]
        self.blocks = [Block(factors[i][0].shape[1], True) for i in self.kept]
        left, right = [factors[i][0] for i in self.kept], [factors[i][1] for i in self.kept]
        self.left = np.hstack(left) if left else np.zeros((n, 0))
        self.right = np.vstack(right) if right else np.zeros((0, n + self.plant.ninputs))
        self.derivatives = [derivatives[i] for i in self.kept]

    def open_loop_responses(self, frequency: Array) -> ComplexArray:
        """Return the plant's response without controller, from (uncertainty outputs, u) to (uncertainty inputs, y)."""
        g, n, m = self.plant, self.plant.nstates, self.left.shape[1]
        B, C = np.hstack([self.left, g.B]), np.vstack([self.right[:, :n], g.C])
        D = np.zeros((C.shape[0], B.shape[1]))
        D[:m, m:] = self.right[:, n:]
        s = 1j * frequency[:, None, None]
        right = np.broadcast_to(B, (frequency.size, *B.shape))
        inner: ComplexArray = np.linalg.solve(s * np.eye(n) - g.A, right).astype(complex)
        response: ComplexArray = C @ inner + D
        return response

    def closed_loop_responses(self, frequency: Array) -> ComplexArray:
        """Return the closed-loop response M from outputs to inputs of the uncertainty, over frequency (rad/s)."""
        m, P = self.left.shape[1], self.open_loop_responses(frequency)
        delay = np.exp(-1j * frequency[:, None, None] * self.delay_s)
        K = -frequency_response(self.feedback, frequency) * delay
        closed = np.linalg.solve(np.eye(self.plant.noutputs) - P[:, m:, m:] @ K, P[:, m:, :m])
        response: ComplexArray = P[:, :m, :m] + P[:, :m, m:] @ K @ closed
        return response

    def state_matrix_and_derivatives(self) -> tuple[Array, list[Array]]:
        """Return the closed loop's state matrix, with a third-order Pade delay, and its derivative by each uncertain
        parameter.
        """
        g, k, m = self.plant, self.feedback, self.plant.ninputs
        pade = control.pade(self.delay_s, 3)
        A1, B1, C1, D1 = (np.kron(np.eye(m), X) for X in signal.tf2ss(*pade))
        n, d, c = g.nstates, len(A1), k.nstates

        def close_loop(A: Array, B: Array) -> Array:
            u = np.hstack([-D1 @ k.D @ g.C, C1, D1 @ k.C])
            return np.vstack(
                [
                    np.hstack([A, np.zeros((n, d + c))]) + B @ u,
                    np.hstack([-B1 @ k.D @ g.C, A1, B1 @ k.C]),
                    np.hstack([-k.B @ g.C, np.zeros((c, d)), k.A]),
                ]
            )

        nominal = close_loop(g.A, g.B)
        steps: list[Array] = [close_loop(g.A + E[:, :n], g.B + E[:, n:]) - nominal for E in self.derivatives]
        return nominal, steps


def _find_least_damped_mode(A: Array) -> tuple[complex, Array, Array]:
    """Return the eigenvalue nearest to instability by its damping ratio, and its left and right eigenvectors."""
    values, left, right = cast(tuple[Any, Any, Any], linalg.eig(A, left=True, right=True))
    k = int(np.argmax(values.real / np.maximum(np.abs(values), 1e-12) + 1e3 * (values.real > 0) * np.abs(values.real)))
    return complex(values[k]), left[:, k], right[:, k]


def _search_unstable_corner(
    nominal: Array, steps: Sequence[Array], size: float, starts: Sequence[Array]
) -> tuple[float, Array]:
    """Search the corners of a parameter box for the largest real part of an eigenvalue; return it and the corner."""
    best, at = -np.inf, np.zeros(len(steps))
    for start in starts:
        z, seen = np.array(start, dtype=float), set()
        while tuple(np.sign(z)) not in seen:
            seen.add(tuple(np.sign(z)))
            A = nominal + sum(size * v * E for v, E in zip(z, steps, strict=True))
            value, y, x = _find_least_damped_mode(A)
            if value.real > best:
                best, at = value.real, z.copy()
            slope = np.array([(np.vdot(y, E @ x) / np.vdot(y, x)).real for E in steps])
            z = np.where(slope >= 0.0, 1.0, -1.0)
    return float(best), at


def find_smallest_unstable_box(loop: UncertainLoop, least: float) -> tuple[float, float, Array]:
    """Search for the smallest parameter box with an unstable corner; return its size, pole frequency and corner.

    The size is a multiple of the spreads; it is ``inf`` if there is no such box up to ten times the spreads. The
    frequency (rad/s) is that of the unstable pole.
    """
    nominal, steps = loop.state_matrix_and_derivatives()
    rng = np.random.default_rng(0)
    starts = [np.zeros(len(steps)), *rng.choice([-1.0, 1.0], (5, len(steps)))]
    low, high, corner = 0.0, least, None
    while high <= _MAX_SPREAD_FACTOR:
        value, at = _search_unstable_corner(nominal, steps, high, starts)
        if value > 0.0:
            corner = at
            break
        starts[0] = at
        low, high = high, 1.15 * high
    if corner is None:
        return np.inf, np.nan, np.zeros(len(steps))
    direction = sum(v * E for v, E in zip(corner, steps, strict=True))
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if np.linalg.eigvals(nominal + middle * direction).real.max() > 0 else (middle, high)
    pole = _find_least_damped_mode(nominal + high * direction)[0]
    return high, abs(pole.imag), corner


def sweep_mu(loop: UncertainLoop, points: int, names: Sequence[str]) -> LoopRobustness:
    """Return the bounds of mu of a loop at ``points`` frequencies; ``names`` labels all uncertain parameters."""
    began = time.process_time()
    poles = np.abs(np.linalg.eigvals(loop.state_matrix_and_derivatives()[0]))
    inside = poles[(poles > 0.3) & (poles < 100.0)]
    frequency = np.geomspace(0.3 * inside.min(initial=1.0), 5.0 * inside.max(initial=30.0), points)
    if not loop.blocks:
        return LoopRobustness(loop.name, frequency, np.zeros(points), 0.0, np.nan, 0.0, np.nan, {}, (), 0.0)
    size, where, corner = find_smallest_unstable_box(loop, _MIN_SPREAD_FACTOR)
    if np.isfinite(where) and where > 0.0:  # the grid must hold the frequency at which the lower bound is
        frequency[int(np.argmin(np.abs(np.log(frequency / where))))] = where
    M = loop.closed_loop_responses(frequency)
    enough = _MU_DESCENT_END_FRACTION / size if np.isfinite(size) else 0.1
    # Every frequency starts anew: the scalings of its neighbour are often at a kink that the descent does not leave.
    upper = np.array(
        [mu_upper_bound(m, loop.blocks, restarts=0, tolerance=1e-3, max_steps=150, enough=enough).value for m in M]
    )
    for _ in range(5):  # descend further where the bound is largest
        k = int(np.argmax(upper))
        better = mu_upper_bound(M[k], loop.blocks, restarts=1, tolerance=1e-5, enough=enough).value
        if better > 0.99 * upper[k]:
            break
        upper[k] = better
    k = int(np.argmax(upper))
    seconds = time.process_time() - began
    worst = {names[i]: float(size * v) for i, v in zip(loop.kept, corner, strict=True)} if np.isfinite(size) else {}
    return LoopRobustness(
        loop.name, frequency, upper, float(upper[k]), float(frequency[k]), 1.0 / size, where, worst,
        tuple(b.size for b in loop.blocks), seconds,
    )  # fmt: skip


def analyse_parameter_robustness(
    vehicle: Vehicle,
    controller: FlightController,
    spreads: Mapping[str, float] | None = None,
    *,
    keys: Sequence[str] = (),
    spread_matrix: Array | None = None,
    points: int = 60,
) -> ParameterRobustness:
    """Return bounds of mu over frequency for the loops of a vehicle with uncertain parameters.

    Parameters
    ----------
    vehicle : Vehicle
    controller : FlightController
        Design for the vehicle.
    spreads : mapping, optional
        Spread of every parameter (SI) by key, independent of each other; :func:`default_spreads` by default.
    keys, spread_matrix : sequence of str, array of shape (keys, directions), optional
        Correlated spreads instead: the parameters move by ``spread_matrix @ z``.
    points : int
        Number of frequencies.

    Returns
    -------
    ParameterRobustness

    Raises
    ------
    ArgumentError
        If nothing varies.
    MuflyError
        If a parameter moves no loop.
    """
    if spread_matrix is None:
        spreads = default_spreads(vehicle) if spreads is None else dict(spreads)
        keys, spread_matrix = list(spreads), np.diag(list(spreads.values()))
        names = list(keys)
    else:
        names = [f"direction {i + 1}" for i in range(spread_matrix.shape[1])]
        if np.count_nonzero(spread_matrix) == len(keys) == spread_matrix.shape[1]:
            names = list(keys)
    if not len(keys):
        raise ArgumentError("vary", "", "nothing varies", "vary parameters")
    linear = differentiate_plants_by_parameters(vehicle, controller.voltage_V, keys, spread_matrix)
    centre = parameter_values(vehicle, keys)
    loops = [
        sweep_mu(UncertainLoop(design, linear[design.name]), points, names)
        for design in (controller.heave_yaw, controller.roll_pitch)
    ]
    if not any(x.block_sizes for x in loops):
        raise MuflyError("no parameter that varies enters heave-yaw or roll-pitch; vary others")
    worst = max(loops, key=lambda x: (x.peak_lower_bound, x.peak))
    direction = np.array([worst.worst.get(name, 0.0) for name in names])
    direction *= min(1.0, 1.0 / max(float(np.abs(direction).max(initial=0.0)), 1e-12))
    values = [
        _nearest_valid_value(vehicle, key, middle, middle + step)
        for key, middle, step in zip(keys, centre.tolist(), (spread_matrix @ direction).tolist(), strict=True)
    ]
    return ParameterRobustness(
        vehicle.name,
        controller.settings.method,
        {key: float(np.linalg.norm(row)) for key, row in zip(keys, spread_matrix, strict=True)},
        loops[0],
        loops[1],
        dict(zip(keys, values, strict=True)),
        worst.name,
    )


def _nearest_valid_value(vehicle: Vehicle, key: str, middle: float, wanted: float) -> float:
    """Return the permitted value of a parameter between ``middle`` and ``wanted`` that is nearest to ``wanted``."""
    low, high = 0.0, 1.0
    share = high
    for _ in range(20):  # 1e-6 of the way
        try:
            replace_parameters(vehicle, {key: middle + share * (wanted - middle)})
        except InputError:
            high = share
        else:
            low = share
        if low == high:
            break
        share = 0.5 * (low + high)
    return middle + low * (wanted - middle)
