"""Studies of missions: state machine, trajectories, beams, repulsive forces, square track (Figs 6.15 to 6.20)."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.estimate import Estimate
from mufly.flight import FlightSummary, fly_mission, summarise_flight
from mufly.mission import (
    Command,
    Mission,
    MissionPlan,
    MissionState,
    State,
    VehicleRequest,
    check_request,
    initial_mission_state,
    load_mission,
    make_spline,
    parse_mission,
    step_mission,
    update_obstacle_map,
)
from mufly.mission.avoidance import make_beam_ring, repulsive_force
from mufly.results.result_figure import blank_figure, label_axes
from mufly.sensors import beam_angles
from mufly.thesis.claims import ProgressCallback, Study, StudyFindings, judge, make_item_judge
from mufly.vehicle import load_vehicle
from mufly.world import Box, World, cast_ranges

Array = NDArray[np.float64]
LASER_RING = make_beam_ring(8, math.pi / 8, 1.5)
_TIME_STEP_S = 0.02
_OBSTACLE_CHECKS_PER_STEP = 3  # of the flight software between two steps of the machine, one for each beam

# Arrows of Fig. 6.15: from, to -> the condition printed at the arrow.
STATE_TRANSITIONS: dict[tuple[str, str], str] = {
    ("init", "take-off"): "signal: start",
    ("take-off", "hover"): "altitude reached",
    ("take-off", "init"): "take-off failed",
    ("hover", "waypoint"): "signal: waypoint",
    ("waypoint", "hover"): "goal reached",
    ("waypoint", "obstacle"): "obstacle detected",
    ("obstacle", "waypoint"): "obstacle avoided",
    ("hover", "obstacle"): "obstacle detected",
    ("obstacle", "hover"): "obstacle avoided",
    ("hover", "landing"): "signal: land",
    ("waypoint", "landing"): "battery low",
    ("hover", "rc"): "RC",
}
_MISSION_TABLES = {
    "take_off": {"height_m": 1.0, "wait_s": 1.0},
    "waypoint": [{"position_m": [2.0, 0.0, -1.0], "wait_s": 3.0}],
}


def _run_state_machine(
    mission: Mission,
    signals: Callable[[float, MissionState], Command] | None = None,
    *,
    lift: bool = True,
    volts: Callable[[float], float] = lambda t: 7.4,
    world: Callable[[float], World] | None = None,
    limit_s: float = 120.0,
) -> list[tuple[float, str]]:
    """Run the state machine with a point mass as helicopter; return time and name of each state entered."""
    plan = MissionPlan(mission, LASER_RING, 6.0)
    x, v, psi = np.array([*mission.start_m, -0.07]), np.zeros(3), 0.0

    def make_estimate(t: float) -> Estimate:
        c, s = math.cos(psi), math.sin(psi)
        beams = np.stack(
            [c * LASER_RING.cos - s * LASER_RING.sin, s * LASER_RING.cos + c * LASER_RING.sin, np.zeros(8)],
            axis=1,
        )
        seen = cast_ranges(mission.world if world is None else world(t), x, beams, LASER_RING.max_range)
        return Estimate(t, x.copy(), v.copy(), np.array([0.0, 0.0, psi]), np.zeros(3), seen, volts(t))

    state = initial_mission_state(plan, make_estimate(0.0))
    entered = [(0.0, str(state.state))]
    for k in range(int(limit_s / _TIME_STEP_S)):
        t = k * _TIME_STEP_S
        for part in range(1, _OBSTACLE_CHECKS_PER_STEP + 1):
            state = update_obstacle_map(plan, state, make_estimate(t), part, _OBSTACLE_CHECKS_PER_STEP)
        state, wanted = step_mission(
            plan, state, make_estimate(t), signals(t, state) if signals else Command(start=k == 5)
        )
        if str(state.state) != entered[-1][1]:
            entered.append((t, str(state.state)))
        if state.finished or (len(entered) > 1 and entered[-1][1] == "init" and t > 5.0):
            break
        if wanted.motors == "fly" and lift:
            v = v + _TIME_STEP_S * (36.0 * (wanted.position - x) - 12.0 * v)
            x = x + _TIME_STEP_S * v
            psi += _TIME_STEP_S * 8.0 * (wanted.heading - psi)
        if x[2] > -0.07:
            x[2], v = -0.07, np.zeros(3)
    return entered


def study_state_machine(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.15: every transition of the figure, made by mufly's state machine; and the table of requests."""
    mission = parse_mission(_MISSION_TABLES)

    def start_then_command(at: float, command: Command, hold: bool = False) -> Callable[[float, MissionState], Command]:
        def command_at(t: float, s: MissionState) -> Command:
            if t >= at and (hold or t < at + 1.5 * _TIME_STEP_S):
                return command
            return Command(start=abs(t - 0.1) < 0.5 * _TIME_STEP_S)

        return command_at

    hovers = next(t for t, s in _run_state_machine(mission) if s == "hover") + 0.3
    near = World(boxes=(Box((0.45, 0.15, -1.0), (0.2, 0.2, 1.0), 0.0, "visitor"),))
    runs = {
        "mission": _run_state_machine(mission),
        "box on the leg": _run_state_machine(load_mission("box-on-leg")),
        "battery low on the leg": _run_state_machine(mission, volts=lambda t: 7.4 if t < hovers + 1.5 else 5.5),
        "land signal": _run_state_machine(mission, start_then_command(hovers, Command(land=True))),
        "RC": _run_state_machine(mission, start_then_command(hovers, Command(rc_active=True), hold=True), limit_s=20.0),
        "never lifts off": _run_state_machine(mission, lift=False),
        "obstacle approaches": _run_state_machine(
            mission,
            start_then_command(hovers - 0.2, Command(pause=True)),
            limit_s=90.0,
            world=lambda t: near if hovers + 1 < t < hovers + 6 else World(),
        ),
    }
    made = {pair for run in runs.values() for pair in zip([s for _, s in run], [s for _, s in run[1:]], strict=False)}
    missing = {p: c for p, c in STATE_TRANSITIONS.items() if p not in made}
    extra = sorted(made - set(STATE_TRANSITIONS))
    asks = [a for a in VehicleRequest if a in (VehicleRequest.START, VehicleRequest.GO_TO, VehicleRequest.LAND)]
    allowed = {
        (a, s): bool(
            check_request(
                a,
                MissionState(state=s, motors="off" if s is State.INIT else "fly", user_in_control=True),
                height_m=1.0,
            )
        )
        for a in asks
        for s in State
    }
    signals_right = (
        allowed[VehicleRequest.START, State.INIT]
        and allowed[VehicleRequest.GO_TO, State.HOVER]
        and not allowed[VehicleRequest.GO_TO, State.INIT]
        and allowed[VehicleRequest.LAND, State.HOVER]
        and allowed[VehicleRequest.LAND, State.WAYPOINT]
        and not allowed[VehicleRequest.LAND, State.INIT]
    )
    verdicts = [
        judge(
            "fig-6.15/arrows",
            "state machine, point mass",
            f"{len(STATE_TRANSITIONS) - len(missing)} of {len(STATE_TRANSITIONS)} made in {len(runs)} runs"
            + (f"; not made: {', '.join(f'{a} to {b} ({c})' for (a, b), c in missing.items())}" if missing else "")
            + (f"; besides: {', '.join(f'{a} to {b}' for a, b in extra)}" if extra else ""),
            missing=len(missing),
        ),
        judge(
            "fig-6.15/start-is-taken-on-the-floor",
            "table of requests",
            "; ".join(f"{a.value}: {', '.join(s.value for s in State if allowed[a, s])}" for a in asks),
            holds=signals_right,
        ),
    ]
    drawn = blank_figure(9.0, 5.2)
    axes = drawn.subplots()
    places = {
        "init": (0, 1),
        "take-off": (1.2, 2),
        "hover": (2.4, 1),
        "waypoint": (4.4, 1),
        "obstacle": (3.4, 2.2),
        "landing": (3.0, -0.3),
        "rc": (1.4, -0.1),
    }
    for (a, b), condition in STATE_TRANSITIONS.items():
        colour = "C0" if (a, b) in made else "C3"
        (xa, ya), (xb, yb) = places[a], places[b]
        bend = 0.22 if (b, a) in STATE_TRANSITIONS else 0.0
        axes.annotate(
            "",
            places[b],
            places[a],
            arrowprops={
                "arrowstyle": "-|>",
                "color": colour,
                "shrinkA": 26,
                "shrinkB": 26,
                "connectionstyle": f"arc3,rad={bend}",
            },
        )
        # The top of the arc is half of its bend times the distance from the straight line.
        axes.text(
            (xa + xb) / 2 + 0.5 * bend * (yb - ya),
            (ya + yb) / 2 - 0.5 * bend * (xb - xa),
            condition,
            fontsize=7,
            color=colour,
            ha="center",
            va="center",
            bbox={"fc": "w", "ec": "none", "pad": 0.6},
        )
    for name, at in places.items():
        axes.text(*at, name, ha="center", va="center", bbox={"boxstyle": "round,pad=0.5", "fc": "w", "ec": "k"})
    axes.set(xlim=(-0.6, 5.0), ylim=(-0.6, 2.6))
    axes.axis("off")
    axes.set_title("Fig. 6.15: arrows of the figure; blue: made by our machine")
    return StudyFindings(verdicts, drawn)


def study_cubic_spline(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.16: boundary conditions of a spline in space, and the factor 3 in its tangent (eq. 6.13)."""
    x0, xg, d0, dg = (0.0, 0.0, -1.0), (3.0, 2.0, -2.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    away = float(np.linalg.norm(np.subtract(xg, x0)))
    curve = make_spline(x0, xg, np.multiply(away, d0), np.multiply(away, dg))
    t = np.linspace(0.0, 1.0, 201)
    p, tangent, _ = curve.evaluate(t)
    ends = max(float(np.abs(p[0] - x0).max()), float(np.abs(p[-1] - xg).max()))
    slopes = max(float(np.abs(tangent[k] / np.linalg.norm(tangent[k]) - d).max()) for k, d in ((0, d0), (-1, dg)))
    numeric = np.gradient(p, t, axis=0)
    a, b, c, _ = curve.coefficients
    printed = t[:, None] ** 3 * a + 2 * t[:, None] * b + c
    off = float(np.abs(tangent - numeric)[1:-1].max()) / away
    off_printed = float(np.abs(printed - numeric)[1:-1].max()) / away
    verdicts = [
        judge(
            "fig-6.16/the-cubic-starts-and-ends-where",
            "mission/trajectory.py",
            f"ends off by {ends:.0e} m, directions by {slopes:.0e}",
            ends=max(ends, slopes),
        ),
        judge(
            "fig-6.16/t-a-t3-2",
            "as printed",
            f"off the derivative of the curve by {off_printed:.2f} of the way; ours by {off:.1e}",
            off_printed=off_printed,
        ),
    ]
    drawn = blank_figure(6.0, 5.0)
    axes = drawn.add_subplot(projection="3d")
    axes.plot(p[:, 1], p[:, 0], -p[:, 2])
    for k in (0, 50, 100, 150, 200):
        axes.quiver(p[k, 1], p[k, 0], -p[k, 2], *(0.15 * tangent[k, [1, 0]]), -0.15 * tangent[k, 2], color="C1")
    axes.set(
        xlabel="east (m)",
        ylabel="north (m)",
        zlabel="height (m)",
        title="Fig. 6.16: cubic spline, with its tangents",
    )
    axes.locator_params(nbins=4)
    return StudyFindings(verdicts, drawn)


@functools.lru_cache(maxsize=1)
def _fly_square_mission() -> tuple[xr.Dataset, FlightSummary, Mission]:
    mission = load_mission("demonstration")
    d = fly_mission("mufly-1.1", mission)
    return (
        d,
        summarise_flight(d, [w.position_m for w in mission.waypoint], take_off=(0.0, 0.0, -1.0)),
        mission,
    )


def study_waypoints(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.17: waypoints on the nonlinear model: height and heading first, then a straight line."""
    d, found, _ = _fly_square_mission()
    legs = [w for w in found.waypoints if w.name != "take-off" and w.overshoot_m is not None]
    over = [100 * float(w.overshoot_m) for w in legs]  # type: ignore[arg-type]
    states = d.mission_state.values
    x = d.truth_position.values
    apart = []
    for k in np.flatnonzero((states[1:] == "waypoint") & (states[:-1] != "waypoint")):
        end = k + 1 + int(np.argmax(states[k + 1 :] != "waypoint"))
        leg = x[k + 1 : end]
        if abs(leg[-1, 2] - leg[0, 2]) < 0.1:
            continue
        going = np.hypot(*(leg[:, :2] - leg[0, :2]).T)
        moved = int(np.argmax(going > 0.1))
        apart.append(100 * abs(leg[moved, 2] - leg[-1, 2]) / abs(leg[-1, 2] - leg[0, 2]))
    assess = make_item_judge("fig-6.17", "nonlinear model, ideal sensors")
    verdicts = [
        assess("waypoints-are-reached-without-overshoot", f"{', '.join(f'{v:.1f}' for v in over)} cm", over=max(over)),
        assess(
            "first-heading-and-height-are-adapted",
            f"{max(apart):.0f} % of the climb or less is left when it has gone 10 cm",
            apart=max(apart),
        ),
    ]
    drawn = blank_figure(8.0, 6.4)
    time = d.time.values
    rows = drawn.subplots(4, 1, sharex=True)
    for axes, name, values, wanted in zip(
        rows,
        ("north (m)", "east (m)", "height (m)", "heading (deg)"),
        (x[:, 0], x[:, 1], -x[:, 2], np.degrees(d.truth_attitude.sel(angle="yaw").values)),
        (
            d.reference_position.values[:, 0],
            d.reference_position.values[:, 1],
            -d.reference_position.values[:, 2],
            np.degrees(d.reference_attitude.sel(angle="yaw").values),
        ),
        strict=True,
    ):
        axes.plot(time, wanted, "k--", linewidth=1, label="trajectory")
        axes.plot(time, values, label="nonlinear model")
        label_axes(axes, y=name)
    rows[0].legend(fontsize="small")
    rows[-1].set_xlabel("Time (s)")
    drawn.suptitle("Fig. 6.17: following waypoints")
    keep = d[["truth_position", "reference_position", "truth_attitude"]].isel(time=slice(None, None, 10))
    return StudyFindings(verdicts, drawn, {"run": keep})


def study_beam_directions(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.18: directions of the eight laser beams and of their forces."""
    angles = np.degrees(beam_angles(load_vehicle("mufly-2.0"))) % 360
    want = np.arange(8) * 45 + 22.5
    force = []
    for k in range(8):
        seen = np.full(8, 1.5)
        seen[k] = 0.5
        fx, fy = repulsive_force(seen.tolist(), LASER_RING, 1.0)
        force.append(math.degrees(math.atan2(fy, fx)) % 360)
    printed = (np.arange(8) * 45 + 202.5) % 360
    off = float(np.abs((np.array(force) - printed + 180) % 360 - 180).max())
    verdicts = [
        judge(
            "fig-6.18/eight-diodes-the-first-to-the",
            "mufly-2.0",
            f"beams at {', '.join(f'{a:g}' for a in angles)} degrees from x towards y",
            holds=np.allclose(angles, want),
        ),
        judge(
            "fig-6.18/force-i-points-along-i-pi-4",
            "mission/avoidance.py",
            f"ours is off by {off:.1e} degrees at most",
            off=off,
        ),
    ]
    drawn = blank_figure(5.0, 5.2)
    axes = drawn.subplots()
    for k, a in enumerate(np.radians(angles)):
        axes.annotate("", (math.sin(a), math.cos(a)), (0, 0), arrowprops={"arrowstyle": "-|>", "color": "C3"})
        axes.text(1.1 * math.sin(a), 1.1 * math.cos(a), str(k), ha="center", va="center")
    for x, y, name in ((0, 0.7, "x"), (0.7, 0, "y")):
        axes.annotate("", (x, y), (0, 0), arrowprops={"arrowstyle": "-|>", "color": "k"})
        axes.text(1.12 * x, 1.12 * y, name, ha="center", va="center", fontsize=12)
    axes.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), title="Fig. 6.18: beams of mufly-2.0 from above")
    axes.set_aspect("equal")
    axes.axis("off")
    return StudyFindings(verdicts, drawn)


def study_repulsive_force_field(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.19: the field of eqs 6.14 to 6.17 around a box, compared with a separate evaluation of the equations."""
    from matplotlib.patches import Rectangle

    threshold = 1.0
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(200):
        seen = rng.uniform(0.1, 1.5, 8)
        f = np.where(seen < threshold, 1 / seen - 1 / threshold, 0.0)
        alpha = np.arange(8) * math.pi / 4 + 9 * math.pi / 8
        wanted = np.array([np.sum(f * np.cos(alpha)), np.sum(f * np.sin(alpha))])
        worst = max(worst, float(np.abs(wanted - repulsive_force(seen.tolist(), LASER_RING, threshold)).max()))
    box = World(boxes=(Box((0.0, 0.0, -1.0), (0.6, 0.6, 2.0), 0.0, "box"),))
    directions = np.stack([LASER_RING.cos, LASER_RING.sin, np.zeros(8)], axis=1)
    grid = np.linspace(-1.4, 1.4, 15)
    places = [(n, e) for n in grid for e in grid if max(abs(n), abs(e)) > 0.38]
    ranges = [cast_ranges(box, (n, e, -1.0), directions, 1.5).tolist() for n, e in places]
    north, east = np.array(places).T
    force_n, force_e = np.array([repulsive_force(seen, LASER_RING, threshold) for seen in ranges]).T
    size = np.hypot(force_n, force_e)
    acting = size > 1e-9
    away = (north * force_n + east * force_e)[acting] > 0
    seen_by_none = int(np.sum(~acting & (np.maximum(np.abs(north), np.abs(east)) < 0.8)))
    assess = make_item_judge("fig-6.19", "mission/avoidance.py")
    verdicts = [
        assess(
            "forces-from-eight-ranges", f"off the equations by {worst:.0e} at 200 random sets of ranges", worst=worst
        ),
        assess(
            "obstacles-repel",
            f"the force points away from the box at {100 * away.mean():.0f} % of "
            f"{int(acting.sum())} places where it acts"
            + (f"; at {seen_by_none} places near it no beam hits it" if seen_by_none else ""),
            holds=away.all(),
        ),
    ]
    drawn = blank_figure(6.0, 5.6)
    axes = drawn.subplots()
    length = np.log1p(size)
    axes.quiver(
        east[acting],
        north[acting],
        (force_e / np.maximum(size, 1e-12) * length)[acting],
        (force_n / np.maximum(size, 1e-12) * length)[acting],
        color="C3",
    )
    axes.add_patch(Rectangle((-0.3, -0.3), 0.6, 0.6, color="0.6"))
    axes.set(
        xlabel="east (m)",
        ylabel="north (m)",
        xlim=(-1.5, 1.5),
        ylim=(-1.5, 1.5),
        title="Fig. 6.19: repulsive force (log of its size), heading north",
    )
    axes.set_aspect("equal")
    return StudyFindings(verdicts, drawn)


def study_square_track(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.20: take off, four waypoints with 2.5 s of waiting, land, as listed in Sec. 6.2.4.

    Thesis: Fig. 6.20.
    """
    d, found, mission = _fly_square_mission()
    reached = [w for w in found.waypoints if w.name != "take-off"]
    worst = max(100 * float(w.distance_at_reach_m or math.inf) for w in reached)
    places = [tuple(w.position_m) for w in mission.waypoint]
    printed = [(-3, 0, -1), (-3, 3, -2), (0, 3, -1), (0, 0, -2)]
    assess = make_item_judge("fig-6.20", "nonlinear model, ideal sensors")
    verdicts = [
        judge(
            "fig-6.20/four-waypoints-2.5-s-of-waiting",
            "demonstration",
            f"{places}",
            holds=(bool(np.allclose(places, printed))) and (all(w.wait_s == 2.5 for w in mission.waypoint)),
        ),
        assess(
            "it-reaches-all-of-them-without",
            f"{found.waypoints_reached} of {found.waypoints_asked}, off by {worst:.1f} cm at most when the wait begins",
            waypoints_reached=found.waypoints_reached,
            worst=worst,
        ),
        assess(
            "and-lands",
            f"{found.outcome}; touches down at {found.touchdown_speed_m_s or math.nan:.2f} m/s",
            value=found.touchdown_speed_m_s or 9,
            holds=found.outcome == "succeeded",
        ),
    ]
    drawn = blank_figure(6.6, 5.6)
    axes = drawn.add_subplot(projection="3d")
    x = d.truth_position.values
    axes.plot(x[:, 1], x[:, 0], -x[:, 2], label="nonlinear model")
    at = np.array(printed, dtype=np.float64)
    axes.plot(at[:, 1], at[:, 0], -at[:, 2], "ks", markersize=5, label="waypoints as printed")
    axes.set(xlabel="east (m)", ylabel="north (m)", zlabel="height (m)", title="Fig. 6.20: square track")
    axes.legend(fontsize="small")
    keep = d[["truth_position", "reference_position"]].isel(time=slice(None, None, 10))
    return StudyFindings(verdicts, drawn, {"run": keep})


STUDIES: dict[str, Study] = {
    "fig-6.16": Study(study_cubic_spline, 0.1),
    "fig-6.18": Study(study_beam_directions, 0.1),
    "fig-6.19": Study(study_repulsive_force_field, 1),
    "fig-6.15": Study(study_state_machine, 8),
    "fig-6.17": Study(study_waypoints, 15),
    "fig-6.20": Study(study_square_track, 15),
}
