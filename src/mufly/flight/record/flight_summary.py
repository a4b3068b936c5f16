"""Summary of a flight: figures computed from a recording.

Definitions (x is the true position, w a waypoint, both N-E-D):

- A waypoint is *reached* when the mission's state changes to ``hover`` near it after a leg, or at a time that the
  caller gives. In a mission without stops it is reached when x is first within the acceptance radius of w. The *wait*
  lasts until the state changes again.
- *Distance at reach*: |x - w| at the start of the wait. *Mean error in the wait*: mean of |x - w| over the wait.
  *Farthest after reach*: largest |x - w| over the wait.
- *Overshoot*: largest distance of x beyond w, from the start of the leg to the end of the wait. The horizontal one is
  along the leg's horizontal direction, the vertical one along its climb or descent; the greater counts. They are
  separate because the helicopter first changes height and then flies level.
- *Airborne*: more than 1 cm above the position at the first instant.
- *Touchdown speed*: largest rate of descent within 0.1 s of the instant at which x first comes within 1 cm of its
  final height, in the state ``landing`` or after. A touchdown above ``HARD_TOUCHDOWN_M_S`` is hard.
- *Oscillation*: defined in :mod:`mufly.flight.oscillation_detector`, computed from the recorded inputs between
  take-off and touchdown.
- *Railed*: a motor input at 0 or 1, or a servo input at -1 or 1, while airborne. The time is counted in whole
  sampling intervals of the recording.
- *Tilt*: angle between the mast and the vertical, arccos(cos(roll) cos(pitch)).
- *Energy*: integral of battery voltage times current, trapezoidal.
- *Beyond the model*: the warning on wind given before the flight, if any. Otherwise a note if the rotors' inflow,
  including the vehicle's motion, exceeds the range of the model for more than a twentieth of the time (gusts exceed
  twice their standard deviation for that long).
- *Real-time factor*: simulated seconds per second of wall-clock time, over the whole recording; *least*: over the worst
  5 s. *Slips*: number of times that a real-time flight was delayed because the machine was overloaded
  (`mufly.link.real_time.real_time_loop`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from mufly.flight.oscillation_detector import (
    Oscillation,
    OscillationDetector,
    may_oscillate,
    steering_demands,
)
from mufly.mission import HARD_TOUCHDOWN_M_S
from mufly.results import ShownBlock, make_table_block, result
from mufly.world import World, compute_obstacle_distances

FLYING_LEG_STATES = ("waypoint", "obstacle")
NEAR_WAYPOINT_M = 0.5
AIRBORNE_HEIGHT_M = 0.01
INPUT_LIMIT_TOLERANCE = 1e-9

_Array = NDArray[np.float64]
_StateRun = tuple[str, int, int]


@result
class WaypointResult:
    """Result of one waypoint; values are None if they do not apply or the waypoint was not reached.

    Attributes
    ----------
    name : str
        ``take-off`` or the waypoint's number, from 1.
    position_m : (3,) tuple
        N, E, D (m).
    reached_s, distance_at_reach_m, mean_error_in_wait_m, farthest_after_reach_m : float or None
    overshoot_m, overshoot_horizontal_m, overshoot_vertical_m : float or None
        See the module's definitions.
    """

    name: str
    position_m: tuple[float, float, float]
    reached_s: float | None = None
    distance_at_reach_m: float | None = None
    mean_error_in_wait_m: float | None = None
    farthest_after_reach_m: float | None = None
    overshoot_m: float | None = None
    overshoot_horizontal_m: float | None = None
    overshoot_vertical_m: float | None = None


@result
class FlightSummary:
    """Figures of a flight; unknown ones are None. Names give units; the module's docstring gives definitions."""

    outcome: str
    reason: str
    duration_s: float
    waypoints: tuple[WaypointResult, ...]
    waypoints_reached: int
    waypoints_asked: int
    max_speed_m_s: float | None
    max_tilt_deg: float | None
    max_position_error_m: float | None
    touchdown_speed_m_s: float | None
    landing_distance_m: float | None
    least_clearance_m: float | None
    least_clearance_to: str
    longest_railed_s: float
    longest_railed_input: str
    longest_oscillation_s: float
    longest_oscillation: str
    energy_used_J: float | None
    battery_end_V: float | None
    battery_end_charge: float | None
    realtime_factor: float | None
    realtime_factor_least: float | None
    slips: int | None
    estimated_noise: str
    outside_model: str
    events: tuple[tuple[float, str, str], ...]

    def as_record(self) -> dict[str, Any]:
        """Return the summary as dictionaries, lists, texts and numbers, the content of ``summary.json``."""
        content = asdict(self)
        content["events"] = [{"time_s": t, "state": state, "text": text} for t, state, text in self.events]
        return content

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the figures of the flight, and when each waypoint was reached."""
        rows = list(summary_rows(self))
        colour = "green" if self.outcome == "succeeded" else "red"
        rows[0] = (rows[0][0], f"[bold {colour}]{rows[0][1]}[/]")
        points = []
        for w in self.waypoints:
            told = ((w.reached_s, 1.0), (w.distance_at_reach_m, 100.0), (w.overshoot_m, 100.0))
            numbers = ("never" if value is None else f"{factor * value:.1f}" for value, factor in told)
            points.append((w.name, ", ".join(f"{x:g}" for x in w.position_m), *numbers))
        heads = ("waypoint", "N, E, D (m)", "reached (s)", "error (cm)", "overshoot (cm)")
        return [make_table_block(("", ""), rows, text=(0, 1)), make_table_block(heads, points, text=(0, 1))]


def summarise_flight(
    dataset: xr.Dataset,
    waypoints: Sequence[ArrayLike] = (),
    events: Sequence[Sequence[Any]] = (),
    *,
    outcome: str | None = None,
    reason: str | None = None,
    take_off: ArrayLike | None = None,
    reached_s: Sequence[float | None] | None = None,
    reach_m: float = 0.05,
    world: World | None = None,
    realtime_factor: float | None = None,
) -> FlightSummary:
    """Compute the summary of a flight.

    Parameters
    ----------
    dataset : xarray.Dataset
        A recording.
    waypoints : sequence of (3,)
        Waypoints in the order of the mission, N, E, D (m).
    events : sequence of (time_s, state, text, ...)
        Copied into the summary.
    outcome, reason : str, optional
        Outcome and its reason; default the recording's attributes.
    take_off : (3,), optional
        End position of the take-off (N, E, D; m), evaluated as a waypoint.
    reached_s : sequence of float or None, optional
        Times at which ``waypoints`` were reached (s), if the caller knows them.
    reach_m : float
        Acceptance radius of a waypoint in missions without stops (m).
    world : World, optional
        Obstacles for the least clearance, from the centre of gravity to the nearest surface except the floor (m).
    realtime_factor : float, optional
        Simulated time over computing time.

    Returns
    -------
    FlightSummary
        It has no waypoints if the mission was never begun (attribute ``mission_flown`` of the recording).
    """
    time = dataset.time.values
    x = dataset.truth_position.values
    states = find_state_runs(dataset)
    airborne = x[0, 2] - x[:, 2] > AIRBORNE_HEIGHT_M
    # The waypoints do not apply to a manual flight.
    by_hand = not dataset.attrs.get("mission_flown", True)
    goals = [] if by_hand else [np.asarray(w, dtype=np.float64) for w in waypoints]
    results = _waypoint_results(time, x, states, goals, take_off, reached_s, reach_m)
    asked = [r for r in results if r.name != "take-off"]
    touchdown = _touchdown_speed(dataset, states)
    clearance, obstacle = _least_clearance(x[airborne], world)
    railed, which = _find_longest_time_at_limit(dataset, airborne)
    oscillation = _longest_oscillation(dataset, airborne)
    error = np.linalg.norm(x - dataset.reference_position.values, axis=1)
    angles = dataset.truth_attitude.values
    tilt = np.degrees(np.arccos(np.cos(angles[:, 0]) * np.cos(angles[:, 1])))
    # A mission that ends with a return lands at its start.
    foot = goals[-1] if goals and dataset.attrs.get("at_end") != "return" else x[0]
    return FlightSummary(
        outcome=str(dataset.attrs.get("outcome", "")) if outcome is None else outcome,
        reason=str(dataset.attrs.get("reason", "")) if reason is None else reason,
        duration_s=float(time[-1] - time[0]),
        waypoints=tuple(results),
        waypoints_reached=sum(r.reached_s is not None for r in asked),
        waypoints_asked=len(asked),
        max_speed_m_s=_finite_maximum(np.linalg.norm(dataset.truth_velocity.values, axis=1)),
        max_tilt_deg=_finite_maximum(tilt[airborne]),
        max_position_error_m=_finite_maximum(error[airborne]),
        touchdown_speed_m_s=touchdown,
        landing_distance_m=None if touchdown is None or by_hand else float(np.hypot(*(x[-1] - foot)[:2])),
        least_clearance_m=clearance,
        least_clearance_to=obstacle,
        longest_railed_s=railed,
        longest_railed_input=which,
        longest_oscillation_s=0.0 if oscillation is None else oscillation.duration_s,
        longest_oscillation="" if oscillation is None else str(oscillation),
        energy_used_J=_energy_used(dataset),
        battery_end_V=_finite_or_none(dataset.battery_voltage.values[-1]),
        battery_end_charge=_finite_or_none(dataset.battery_charge.values[-1]),
        realtime_factor=realtime_factor,
        realtime_factor_least=dataset.attrs.get("realtime_factor_least"),
        slips=dataset.attrs.get("slips"),
        estimated_noise=str(dataset.attrs.get("estimated_noise", "")),
        outside_model=str(dataset.attrs.get("outside_model", "")) or _describe_inflow_excess(dataset, airborne),
        events=tuple((float(e[0]), str(e[1]), str(e[2])) for e in events),
    )


def _describe_inflow_excess(dataset: xr.Dataset, airborne: NDArray[np.bool_]) -> str:
    """Describe by how much and how long the rotors' inflow exceeded the range of the model; "" if it did not."""
    limits = dataset.attrs.get("model_air_m_s")
    if limits is None or "wind" not in dataset or not airborne.any():
        return ""
    roll, pitch, yaw = dataset.truth_attitude.values[airborne].T
    mast = np.column_stack([
        np.cos(roll) * np.sin(pitch) * np.cos(yaw) + np.sin(roll) * np.sin(yaw),
        np.cos(roll) * np.sin(pitch) * np.sin(yaw) - np.sin(roll) * np.cos(yaw),
        np.cos(roll) * np.cos(pitch),
    ])  # fmt: skip
    air = (dataset.truth_velocity.values - dataset.wind.values)[airborne]
    along = np.abs(np.sum(air * mast, axis=1))
    across = np.sqrt(np.maximum(np.sum(air**2, axis=1) - along**2, 0.0))
    level = str(dataset.attrs.get("level_speed", ""))
    share = float(np.mean((along > limits[0]) | (across > limits[1])))
    if not share > 0.05:
        return ""
    return (
        f"the flight model was not valid for {100 * share:.0f} % of the time in the air: its rotors met "
        f"{across.max():.1f} m/s across and {along.max():.1f} m/s along the mast, and hold up to "
        f"{limits[1]:.1f} and "
        f"{limits[0]:.1f} m/s{level and '; ' + level}"
    )


def find_state_runs(dataset: xr.Dataset) -> list[_StateRun]:
    """Return (state, first row, last row + 1) of every run of one state; names are lower case with hyphens."""
    states = dataset.mission_state.values
    edges = [0, *(np.flatnonzero(states[1:] != states[:-1]) + 1), len(states)]
    names = [str(states[a]).lower().replace("_", "-") for a in edges[:-1]]
    return [(name, int(a), int(b)) for name, (a, b) in zip(names, pairwise(edges), strict=True)]


def _waypoint_results(
    time: _Array,
    x: _Array,
    states: list[_StateRun],
    goals: Sequence[_Array],
    take_off: ArrayLike | None,
    reached_s: Sequence[float | None] | None,
    reach_m: float,
) -> list[WaypointResult]:
    waits = [(before[0], a, b) for before, (name, a, b) in pairwise(states) if name == "hover"]
    results: list[WaypointResult] = []
    start, leg = x[0], 0
    if take_off is not None:
        top = np.asarray(take_off, dtype=np.float64)
        found = next(((a, b) for before, a, b in waits if before == "take-off"), None)
        results.append(_waypoint_result("take-off", top, start, time, x, leg, found))
        start, leg = top, found[1] if found else leg
    for number, goal in enumerate(goals):
        if reached_s is not None:
            found = _waypoint_state_rows(time, states, reached_s[number])
        else:
            found = next(
                (
                    (a, b)
                    for before, a, b in waits
                    if a >= leg and before in FLYING_LEG_STATES and np.linalg.norm(x[a] - goal) < NEAR_WAYPOINT_M
                ),
                None,
            )
            if found is None:
                near = np.flatnonzero(np.linalg.norm(x[leg:] - goal, axis=1) <= reach_m)
                found = (leg + int(near[0]), leg + int(near[0]) + 1) if len(near) else None
        results.append(_waypoint_result(str(number + 1), goal, start, time, x, leg, found))
        start, leg = goal, found[1] if found else leg
    return results


def _waypoint_state_rows(time: _Array, states: list[_StateRun], reached_s: float | None) -> tuple[int, int] | None:
    """Return the rows (first, last + 1) from ``reached_s`` (s) to the end of the mission state at that time.

    Return None if ``reached_s`` is None.
    """
    if reached_s is None:
        return None
    # Times from different computations may differ in the last bit.
    first = min(int(np.searchsorted(time, reached_s - 1e-9)), len(time) - 1)
    return first, next(stop for _, begin, stop in states if begin <= first < stop)


def _waypoint_result(
    name: str, goal: _Array, start: _Array, time: _Array, x: _Array, leg: int, found: tuple[int, int] | None
) -> WaypointResult:
    place = (float(goal[0]), float(goal[1]), float(goal[2]))
    if found is None:
        return WaypointResult(name, place)
    first, stop = found
    away = x[leg:stop] - goal
    wait = np.linalg.norm(x[first:stop] - goal, axis=1)
    along = (goal - start)[:2]
    length = float(np.hypot(*along))
    horizontal = max(0.0, float((away[:, :2] @ along).max() / length)) if length > 1e-3 else None
    rise = float(goal[2] - start[2])
    vertical = max(0.0, float((away[:, 2] * np.sign(rise)).max())) if abs(rise) > 1e-3 else None
    return WaypointResult(
        name,
        place,
        reached_s=float(time[first]),
        distance_at_reach_m=float(wait[0]),
        mean_error_in_wait_m=float(wait.mean()),
        farthest_after_reach_m=float(wait.max()),
        overshoot_m=max((v for v in (horizontal, vertical) if v is not None), default=None),
        overshoot_horizontal_m=horizontal,
        overshoot_vertical_m=vertical,
    )


def _touchdown_speed(dataset: xr.Dataset, states: list[_StateRun]) -> float | None:
    """Return the touchdown speed (m/s); None unless the flight ended with a landing at the height of its take-off."""
    begin = next((first for name, first, _ in reversed(states) if name == "landing"), None)
    down = dataset.truth_position.values[:, 2]
    if begin is None or abs(down[-1] - down[0]) > 0.1:
        return None
    time = dataset.time.values
    contact = time[begin + int(np.argmax(down[begin:] >= down[-1] - AIRBORNE_HEIGHT_M))]
    around = (np.abs(time - contact) <= 0.1) & (time >= time[begin])
    return max(0.0, float(dataset.truth_velocity.values[around, 2].max()))


def _least_clearance(x: _Array, world: World | None) -> tuple[float | None, str]:
    if world is None or world.is_empty or not len(x):
        return None, ""
    least, which = compute_obstacle_distances(world, x)
    nearest = int(least.argmin())
    return float(least[nearest]), world.obstacle_names[which[nearest]]


def _find_longest_time_at_limit(dataset: xr.Dataset, airborne: NDArray[np.bool_]) -> tuple[float, str]:
    """Return the longest time (s) of one input at a limit, and the input's name."""
    time = dataset.time.values
    longest, which = 0.0, ""
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    for name, lowest in (("motor_input", 0.0), ("servo_input", -1.0)):
        variable = dataset[name]
        for label, values in zip(variable[variable.dims[1]].values, variable.values.T, strict=True):
            railed = airborne & ((values <= lowest + INPUT_LIMIT_TOLERANCE) | (values >= 1.0 - INPUT_LIMIT_TOLERANCE))
            for first, stop in _true_stretches(railed):
                lasting = float(time[stop - 1] - time[first]) + step
                if lasting > longest:
                    longest, which = lasting, f"{name} {label}"
    return longest, which


def _longest_oscillation(dataset: xr.Dataset, airborne: NDArray[np.bool_]) -> Oscillation | None:
    flown = np.flatnonzero(airborne)
    if not len(flown):
        return None
    rows = slice(int(flown[0]), int(flown[-1]) + 1)
    time, states = dataset.time.values[rows], dataset.mission_state.values[rows]
    inputs = np.hstack([dataset.motor_input.values[rows], dataset.servo_input.values[rows]])
    if not may_oscillate(inputs):
        return None
    velocity, angles = dataset.reference_velocity.values[rows], dataset.reference_attitude.values[rows]
    turning = np.gradient(angles[:, 2], time) if len(time) > 1 else np.zeros(1)
    look, longest = OscillationDetector(), None
    for t, u, state, v, rate, a in zip(
        time.tolist(),
        inputs.tolist(),
        states,
        velocity.tolist(),
        turning.tolist(),
        angles.tolist(),
        strict=True,
    ):
        name = str(state).lower().replace("_", "-")
        found = look.find_oscillation(t, u, steering_demands(name, v, rate, a[0], a[1]))
        if found is not None and (longest is None or found.duration_s > longest.duration_s):
            longest = found
    return longest


def _true_stretches(flags: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _energy_used(dataset: xr.Dataset) -> float | None:
    power = dataset.battery_voltage.values * dataset.battery_current.values
    return _finite_or_none(0.5 * ((power[1:] + power[:-1]) * np.diff(dataset.time.values)).sum())


def _finite_maximum(values: _Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def summary_rows(summary: FlightSummary) -> list[tuple[str, str]]:
    """Return the summary as (label, value with unit) for a table; unknown values are omitted."""

    def worst_waypoint_value(key: str) -> float | None:
        known = [v for w in summary.waypoints if (v := getattr(w, key)) is not None]
        return max(known, default=None)

    outcome = f"{summary.outcome}: {summary.reason}" if summary.reason else summary.outcome
    clearance_to = f" ({summary.least_clearance_to})" if summary.least_clearance_to else ""
    railed_by = f" ({summary.longest_railed_input})" if summary.longest_railed_input else ""
    speed = summary.touchdown_speed_m_s
    hard = f" (hard: above {HARD_TOUCHDOWN_M_S:g} m/s)" if (speed or 0.0) > HARD_TOUCHDOWN_M_S else ""
    reached = float(summary.waypoints_reached) if summary.waypoints_asked else None
    lines: list[tuple[str, float | None, str]] = [
        ("Duration", summary.duration_s, "{:.1f} s"),
        ("Waypoints reached", reached, f"{{:.0f}} of {summary.waypoints_asked}"),
        (
            "Worst distance when a wait started",
            _scale_optional(100, worst_waypoint_value("distance_at_reach_m")),
            "{:.1f} cm",
        ),
        ("Worst overshoot", _scale_optional(100, worst_waypoint_value("overshoot_m")), "{:.1f} cm"),
        (
            "Worst mean error in a wait",
            _scale_optional(100, worst_waypoint_value("mean_error_in_wait_m")),
            "{:.1f} cm",
        ),
        ("Greatest position error", _scale_optional(100, summary.max_position_error_m), "{:.1f} cm"),
        ("Greatest speed", summary.max_speed_m_s, "{:.2f} m/s"),
        ("Greatest tilt", summary.max_tilt_deg, "{:.1f} deg"),
        ("Touchdown speed", speed, "{:.2f} m/s" + hard),
        ("Landed off its mark by", _scale_optional(100, summary.landing_distance_m), "{:.1f} cm"),
        ("Least distance to an obstacle", summary.least_clearance_m, "{:.2f} m" + clearance_to),
        ("Longest time an input was railed", summary.longest_railed_s, "{:.2f} s" + railed_by),
        (
            "Longest oscillation",
            summary.longest_oscillation_s or None,
            f"{{:.1f}} s ({summary.longest_oscillation})",
        ),
        ("Energy used", summary.energy_used_J, "{:.0f} J"),
        ("Battery at the end", summary.battery_end_V, "{:.2f} V"),
        ("Charge left", _scale_optional(100, summary.battery_end_charge), "{:.0f} %"),
        ("Real-time factor", summary.realtime_factor, _format_realtime_factor(summary)),
    ]
    rows = [(label, form.format(value)) for label, value, form in lines if value is not None]
    notes = (("Noise in flight (vehicle file)", summary.estimated_noise), ("Beyond the model", summary.outside_model))
    return [("Outcome", outcome), *rows, *(note for note in notes if note[1])]


def _format_realtime_factor(summary: FlightSummary) -> str:
    """Return the format string of the real-time factor; for a flight in real time it includes the least factor and the
    number of timing overruns.
    """
    form = "{:.0f}" if (summary.realtime_factor or 0.0) >= 10.0 else "{:.2f}"
    least, slips = summary.realtime_factor_least, summary.slips
    return form if least is None else f"{form}, least {least:.2f}, {slips} timing overruns"


def _scale_optional(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value
