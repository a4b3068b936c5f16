"""Loads of a coaxial pair over speed ratio, climb and edgewise velocity: computation of flight maps, interpolation.

:mod:`mufly.vehicle.flight_map` defines axes and columns. A point (r, m, e) of the map is the pair at

    Omega_up = 2 s / (1 + r),    Omega_dw = r Omega_up,    V_z = m s R,    V = k sqrt(e / (1 - e)) s R

At e = 0 a small V gives the loads divided by V, and the thrust and torque of axial flight. Each point starts from a
solved neighbour. Body rates need one iteration of the coupling: the stream of the upper rotor, with its new inflow
gradients, meets the lower rotor, whose mean inflow does not change to first order.

The flight model interpolates by quadratic splines over climb and e, which have continuous slopes and pass through the
points; over the ratio it is linear (:func:`fit_flight_map_splines`). Beyond an edge the value at the edge is kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError, MuflyError
from mufly.results import ResultColumn, ShownBlock, columns_to_rows, make_lines_block, result, tabulate_results
from mufly.rotor.blading import Blading
from mufly.rotor.forward.forward_results import ForwardCondition, ForwardResult, RigidFlapMode
from mufly.rotor.forward.row_sums import sum_flow_rows, sum_rate_rows
from mufly.rotor.forward.skewed_pair import ForwardPair, solve_forward_pair
from mufly.rotor.rotor_system import Air
from mufly.vehicle.flight_map import ROTOR_LOAD_COLUMNS, FlightMap, FlightMapTables

Array = NDArray[np.float64]

LOAD_COLUMN_COUNT = len(ROTOR_LOAD_COLUMNS)
FLOW_COLUMN_COUNT = ROTOR_LOAD_COLUMNS.index("rate_force")
"""Columns of the flow; those of rates follow."""
MAX_MAP_ADVANCE_RATIO = 0.35
"""Greatest advance ratio of a map."""
_MIN_ADVANCE_FRACTION_OF_KNEE = 0.01  # of the knee, where loads over V are those of V = 0
_BODY_RATE_STEP_RATIO = 0.002  # of the rotor speed, the rates of the differences
_COUPLING_TOLERANCE = 1e-5  # of the coupling


def make_edgewise_axis(knee: float, count: int, *, advance_ratio: float = MAX_MAP_ADVANCE_RATIO) -> Array:
    """Return ``count`` evenly spaced values of the axis e = mu^2 / (mu^2 + knee^2), up to an advance ratio mu."""
    return np.round(np.linspace(0.0, advance_ratio**2 / (advance_ratio**2 + knee**2), count), 5)


def _flow_load_columns(pair: ForwardPair, axial: ForwardPair, density: float, radius: float) -> Array:
    """Return the effects of edgewise flow on the loads of both rotors, (2, 6): the first six columns of a map.

    ``axial`` is the pair at the smallest V, to which thrust and torque are related.
    """
    out = np.zeros((2, 6))
    for k, (at, rest) in enumerate(((pair.upper, axial.upper), (pair.lower, axial.lower))):
        force = density * math.pi * radius**3 * at.speed_rad_s * at.edgewise_m_s
        out[k] = (
            at.thrust_N / rest.thrust_N - 1.0, at.torque_Nm / rest.torque_Nm - 1.0, at.h_force_N / force,
            at.y_force_N / force, at.roll_moment_Nm / (force * radius), at.pitch_moment_Nm / (force * radius),
        )  # fmt: skip
    return out


def _rate_load_columns(
    solve: Callable[[tuple[float, float]], ForwardPair], pair: ForwardPair, density: float, radius: float
) -> Array:
    """Return the effects of roll and pitch rate on the loads of both rotors, (2, 4): the last four columns of a map.

    They are found by differences.
    """
    rate = _BODY_RATE_STEP_RATIO * pair.upper.speed_rad_s
    rolling, pitching = solve((rate, 0.0)), solve((0.0, rate))

    def load_changes_per_rate(moved: ForwardResult, at: ForwardResult) -> tuple[Array, Array]:
        """Return force (forward, right) and moment (x, y) of ``moved`` less those of ``at``, divided by ``rate``."""
        force = at.h_force_N - moved.h_force_N, moved.y_force_N - at.y_force_N
        moment = moved.roll_moment_Nm - at.roll_moment_Nm, moved.pitch_moment_Nm - at.pitch_moment_Nm
        return np.array(force) / rate, np.array(moment) / rate

    out = np.zeros((2, 4))
    for k, side in enumerate(("upper", "lower")):
        at: ForwardResult = getattr(pair, side)
        (force_p, moment_p), (force_q, moment_q) = (
            load_changes_per_rate(getattr(turn, side), at) for turn in (rolling, pitching)
        )
        force = density * math.pi * radius**4 * at.speed_rad_s
        turned = (
            force_p[0] + force_q[1], force_p[1] - force_q[0], moment_p[0] + moment_q[1], moment_p[1] - moment_q[0]
        )  # fmt: skip
        out[k] = 0.5 * np.array(turned) / np.array([force, force, force * radius, force * radius])
    return out


def compute_flight_map_loads(
    upper: Blading,
    lower: Blading,
    flaps: tuple[RigidFlapMode | None, RigidFlapMode | None],
    *,
    pitch_rad: tuple[float, float],
    spacing_m: float,
    mean_speed_rad_s: float,
    ratio: Sequence[float],
    climb_ratio: Sequence[float],
    knee: float,
    edgewise: Sequence[float] | Array,
    air: Air | None = None,
    upper_sign: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FlightMapTables, int]:
    """Compute the loads of a flight map for a pair of rotors over speed ratio, climb and edgewise velocity.

    Parameters
    ----------
    upper, lower : Blading
        Upper and lower rotor, of one radius.
    flaps : (RigidFlapMode, RigidFlapMode)
        Flap modes; None for blades that do not flap.
    pitch_rad : (float, float)
    spacing_m, mean_speed_rad_s : float
    ratio, climb_ratio, edgewise : sequences of float
        Axes in equal steps; the last begins at 0.
    knee : float
        k of the edgewise axis.
    air : Air, optional
    upper_sign : int
        Sense of rotation of the upper rotor: 1 anticlockwise from above (vehicles), -1 clockwise.
    progress : callable, optional
        ``progress(done, total)`` after each point.

    Returns
    -------
    tables : FlightMapTables
    missing : int
        Points without a solution; they have the loads of the next climb towards 0.

    Raises
    ------
    InputError
        If a value is impossible.
    MuflyError
        If a hover has no solution.
    """
    gas, radius = air or Air(), float(upper.radius_m[0])
    axes = tuple(np.asarray(a, dtype=np.float64) for a in (ratio, climb_ratio, edgewise))
    shape = (axes[0].size, axes[1].size, axes[2].size)
    total = math.prod(shape)
    tip = mean_speed_rad_s * radius
    loads = np.zeros((*shape, 2, LOAD_COLUMN_COUNT))
    solved, done = np.zeros(shape, dtype=np.bool_), 0
    order = sorted(range(shape[1]), key=lambda j: abs(axes[1][j]))
    for i in range(shape[0]):
        up = 2.0 * mean_speed_rad_s / (1.0 + float(axes[0][i]))
        first = ForwardCondition(pitch_rad[0], up, rotation_sign=upper_sign, air=gas)
        second = replace(
            first, pitch_rad=pitch_rad[1], speed_rad_s=float(axes[0][i]) * up, rotation_sign=-upper_sign
        )  # fmt: skip

        def solve_map_point(
            edge: float, climb: float, start: ForwardPair | None, tolerance: float = _COUPLING_TOLERANCE,
            rates: tuple[float, float] = (0.0, 0.0), conditions: tuple[ForwardCondition, ...] = (first, second),
        ) -> ForwardPair:  # fmt: skip
            one, two = (replace(c, edgewise_m_s=edge, climb_m_s=climb, rates_rad_s=rates) for c in conditions)
            return solve_forward_pair(
                upper, lower, (one, two), flaps, spacing_m=spacing_m, start=start, tolerance=tolerance
            )

        hover: ForwardPair | None = None
        for j in order:
            climb = float(axes[1][j]) * tip
            rest, last = None, hover
            for k in range(shape[2]):
                e = float(axes[2][k])
                edge = tip * knee * (math.sqrt(e / (1.0 - e)) if k else _MIN_ADVANCE_FRACTION_OF_KNEE)
                try:
                    last = pair = solve_map_point(edge, climb, last)
                    by_rate = _rate_load_columns(
                        lambda rates, at=pair, v=edge, w=climb: solve_map_point(v, w, at, 1e9, rates),  # type: ignore[misc]
                        pair, gas.density_kg_m3, radius,
                    )  # fmt: skip
                    rest = rest or pair
                    hover = hover or pair
                    loads[i, j, k, :, :FLOW_COLUMN_COUNT] = _flow_load_columns(pair, rest, gas.density_kg_m3, radius)
                    loads[i, j, k, :, FLOW_COLUMN_COUNT:] = by_rate
                    solved[i, j, k] = rest.upper.edgewise_m_s < edge or k == 0
                except MuflyError as error:
                    if isinstance(error, InputError) or hover is None:
                        raise
                done += 1
                if progress is not None:
                    progress(done, total)
        for j in order:  # away from V_z = 0
            near = j - 1 if axes[1][j] > 0.0 else j + 1
            for k in range(shape[2]):
                if not solved[i, j, k] and 0 <= near < shape[1]:
                    loads[i, j, k] = loads[i, near, k]
    return FlightMapTables(axes[0], axes[1], axes[2], loads.reshape(*shape, 2 * LOAD_COLUMN_COUNT)), int(
        np.count_nonzero(~solved)
    )


@cached_njit(error_model="numpy", forceinline=True)
def spline_weights(x: float, n: int) -> tuple[int, float, float, float]:
    """Return the index of the first of three neighbouring coefficients of a quadratic spline, and their weights.

    ``x`` is the position in steps from the first of ``n`` points, 3 or more; beyond an edge it is that of the edge.
    """
    i = int(min(n - 2.0, max(1.0, x + 0.5)))  # in this order an index also if x is not a number
    t = min(max(x, 0.0), n - 1.0) - i
    return i - 1, 0.5 * (0.5 - t) * (0.5 - t), 0.75 - t * t, 0.5 * (0.5 + t) * (0.5 + t)


def make_spline_matrix(n: int) -> Array:
    """Return the (n, n) matrix that gives the values at ``n`` points from the coefficients of a quadratic spline."""
    matrix = np.zeros((n, n))
    for k in range(n):
        first, *weights = spline_weights(float(k), n)
        matrix[k, first : first + len(weights)] = weights
    return matrix


@cached_njit(error_model="numpy", forceinline=True)
def interpolate_flow_loads(
    table: Array, climbs: int, edges: int, ratio: float, climb: float, edge: float
) -> tuple[float, float, float, float, float, float, float, float, float, float, float, float]:
    """Return the six loads of each rotor that edgewise flow causes, interpolated in a flight map: 12 numbers.

    Parameters
    ----------
    table : ((climbs + 2) * edges * 12,) array
        Spline coefficients at the middle ratio; then, over e, those of the slope over the ratio, and of the change of
        this slope per step of climb.
    climbs, edges : int
        Points of the axes of climb and e, 3 or more.
    ratio : float
        Speed ratio less that of the table.
    climb, edge : float
        Position on the axes in steps.
    """
    j0, ca, cb, cc = spline_weights(climb, climbs)
    i0, ea, eb, ec = spline_weights(edge, edges)
    skewed = ratio * min(max(climb, 0.0), climbs - 1.0)
    return sum_flow_rows(
        table, 12 * (edges * j0 + i0), 12 * (edges * climbs + i0), 12 * edges, ca, cb, cc, ratio, skewed, ea, eb, ec
    )


@cached_njit(error_model="numpy", forceinline=True)
def interpolate_rate_loads(
    rates: Array, edges: int, edge: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the four loads of each rotor that roll and pitch rate cause, interpolated over the edgewise axis e: 8
    numbers.
    """
    i0, ea, eb, ec = spline_weights(edge, edges)
    return sum_rate_rows(rates, 8 * i0, ea, eb, ec)


class FlightMapSplines(NamedTuple):
    """Coefficients of the quadratic splines that interpolate a flight map.

    Attributes
    ----------
    speed_ratio_middle, speed_ratio_low, speed_ratio_high : float
        Middle, lowest and highest speed ratio; infinite edges for a map of one ratio.
    start, per_step : (2,) arrays
        First value of climb ratio and e, and reciprocal of the step.
    size : (2,) integer array
        Number of values of climb ratio and of e.
    coefficient_table : (climbs + 2, edges, 12) array
        As for :func:`interpolate_flow_loads`.
    rate_coefficient_table : (edges, 8) array
        Spline coefficients over e of the loads per body rate, for both rotors.
    """

    speed_ratio_middle: float
    speed_ratio_low: float
    speed_ratio_high: float
    start: Array
    per_step: Array
    size: NDArray[np.int64]
    coefficient_table: Array
    rate_coefficient_table: Array


def fit_flight_map_splines(tables: FlightMapTables) -> FlightMapSplines:
    """Return the spline coefficients of a map.

    The loads are linear over the ratio, with a slope that is linear over the climb. Loads of rates are those of the
    middle ratio at the climb nearest to 0.

    Parameters
    ----------
    tables : FlightMapTables
    """
    ratio, climb, edge, loads = tables
    both = loads.reshape(*loads.shape[:3], 2, LOAD_COLUMN_COUNT)
    flow = both[..., :FLOW_COLUMN_COUNT].reshape(*loads.shape[:3], 12)
    rates = both[..., FLOW_COLUMN_COUNT:].reshape(*loads.shape[:3], 8)
    middle = float(ratio.mean())
    away = ratio - middle
    slope = np.zeros(flow.shape[1:])
    if ratio.size > 1:
        slope = np.tensordot(away / float(away @ away), flow, axes=1)
    steps = np.arange(climb.size)
    line = np.stack([np.ones(climb.size), steps], axis=1)
    fitted = np.linalg.lstsq(line, slope.reshape(climb.size, -1), rcond=None)[0].reshape(2, edge.size, 12)
    over_edge, over_climb = np.linalg.inv(make_spline_matrix(edge.size)), np.linalg.inv(make_spline_matrix(climb.size))
    return FlightMapSplines(
        middle, float(ratio[0]) if ratio.size > 1 else -math.inf, float(ratio[-1]) if ratio.size > 1 else math.inf,
        np.array([climb[0], edge[0]]),
        np.array([(a.size - 1) / (a[-1] - a[0]) for a in (climb, edge)]),
        np.array([climb.size, edge.size], dtype=np.int64),
        np.concatenate((
            np.einsum("ab,cd,bdk->ack", over_climb, over_edge, flow.mean(axis=0)),
            np.einsum("ab,cbk->cak", over_edge, fitted),
        )),
        over_edge @ rates.mean(axis=0)[int(np.argmin(np.abs(climb)))],
    )  # fmt: skip


class AirspeedMapLoads(NamedTuple):
    """Loads of upper and lower rotor (columns) over airspeed, from a flight map at its middle speed ratio, no climb.

    Attributes
    ----------
    airspeed_m_s : (n,) array
    thrust_excess, torque_excess : (n, 2) arrays
        Thrust and torque over those of hover, less 1.
    drag_N, side_N : (n, 2) arrays
        In-plane forces against the velocity and to the right (N).
    roll_moment_Nm, pitch_moment_Nm : (n, 2) arrays
        Hub moments, right side down and nose up (N m).
    rate_damping_Nms : float
        Hub moment of both rotors per roll rate in hover (N m s).
    """

    airspeed_m_s: Array
    thrust_excess: Array
    torque_excess: Array
    drag_N: Array
    side_N: Array
    roll_moment_Nm: Array
    pitch_moment_Nm: Array
    rate_damping_Nms: float


@result(eq=False)
class FlightMapSummary:
    """Flight map with the loads over airspeed at its middle speed ratio, without climb.

    Attributes
    ----------
    flight_map : FlightMap
    loads : AirspeedMapLoads
    """

    flight_map: FlightMap
    loads: AirspeedMapLoads

    def as_record(self) -> dict[str, Any]:
        """Return settings, axes and loads of the map, and the loads over airspeed."""
        return {
            **self.flight_map.model_dump(exclude={"table"}), **self.flight_map.decode_map_tables()._asdict(),
            "at_mean_ratio_without_climb": self.loads._asdict(),
        }  # fmt: skip

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return size and limits of the map, and the loads over airspeed, as printed text."""
        m, loads = self.flight_map, self.loads
        ratios, climbs, advances, _ = m.decode_map_tables().loads.shape
        edge, sink, climb = m.velocity_range_m_s
        low, high = m.level_speed_m_s
        beyond = "more than " if math.isclose(high, edge, abs_tol=0.02) else ""
        excess = {"T": loads.thrust_excess, "Q": loads.torque_excess}
        sums = {"H": loads.drag_N, "Y": loads.side_N, "roll": loads.roll_moment_Nm, "pitch": loads.pitch_moment_Nm}
        sides = [(f"{name} {side}", values[:, k]) for name, values in excess.items()
                 for k, side in enumerate(("upper", "lower"))]  # fmt: skip
        table = {"V": loads.airspeed_m_s, **dict(sides), **{name: v.sum(axis=1) for name, v in sums.items()}}
        columns = (
            ResultColumn("V", form=".2f", own_unit="m/s"),
            *(ResultColumn(name, "%", "z.1f", head=name) for name, _ in sides),
            *(ResultColumn(name, "mN", "z.1f", head=name, own_unit="N") for name in ("H", "Y")),
            *(ResultColumn(name, "mN m", "z.2f", own_unit="N m") for name in ("roll", "pitch")),
        )
        return (
            make_lines_block(
                f"  {m.description}",
                f"{ratios} speed ratios, {climbs} climbs, {advances} advance ratios: to {edge:.1f} m/s across, "
                f"{sink:.1f} m/s sink, {climb:.1f} m/s climb; below: no climb, rotor speeds of hover",
                head=m.name,
            ),
            tabulate_results(columns_to_rows(table), columns),
            make_lines_block(
                f"rate damping of the hubs: {1e3 * loads.rate_damping_Nms:z.3f} mN m per rad/s; greatest level "
                f"airspeed over the band of flap frequencies: {low:.1f} to {beyond}{high:.1f} m/s"
            ),
        )


def evaluate_flight_map(flight_map: FlightMap) -> AirspeedMapLoads:
    """Return the loads (SI) at the airspeeds on the axis of a flight map, interpolated as in the flight model."""
    splines = fit_flight_map_splines(flight_map.decode_map_tables())
    edge = flight_map.decode_map_tables().edgewise
    mean, radius = flight_map.mean_speed_rad_s, flight_map.radius_m
    up = 2.0 * mean / (1.0 + splines.speed_ratio_middle)
    speeds = np.array([up, splines.speed_ratio_middle * up])
    speed = flight_map.knee * np.sqrt(edge / (1.0 - edge)) * mean * radius
    rest = float(-splines.start[0] * splines.per_step[0])
    climbs, edges = (int(n) for n in splines.size)
    flow = np.array([
        interpolate_flow_loads(splines.coefficient_table.ravel(), climbs, edges, 0.0, rest, float(k))
        for k in range(edges)
    ]).reshape(edges, 2, FLOW_COLUMN_COUNT)  # fmt: skip
    thrust, torque, drag, side, roll, pitch = np.moveaxis(flow, -1, 0)
    scale = flight_map.density_kg_m3 * math.pi * radius**3 * speeds
    turning = np.array(interpolate_rate_loads(splines.rate_coefficient_table.ravel(), edges, 0.0)).reshape(2, 4)
    force, moment = scale * speed[:, None], scale * radius * speed[:, None]
    return AirspeedMapLoads(
        speed, thrust, torque, drag * force, side * force, roll * moment, pitch * moment,
        float(turning[:, 2] @ scale) * radius**2,
    )  # fmt: skip
