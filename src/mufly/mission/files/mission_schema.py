"""Schema of a mission file.

Lengths are in metres, N-E-D from a point on the floor, so heights above the floor are negative D. Every key carries its
unit. `docs/reference/missions.md` explains each key; a test keeps that page and these models consistent.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, Strict, model_validator

from mufly.files.input_files import make_validation_error
from mufly.mission.trajectory import Trajectory, plan_pending_curve, plan_straight
from mufly.mission.trajectory import TrajectoryLimits as TrajectoryLimits
from mufly.world import Box, Cylinder, Room, World, make_wall

MAX_COORDINATE_M = 10_000.0
"""Largest coordinate or length in a mission (m): flights are indoors, over a flat floor."""
MAX_WIND_M_S, MAX_GUST_RMS_M_S = 50.0, 5.0
"""Bounds of each component of the steady wind (a hurricane's) and of the gusts' rms (m/s).

The model's own range of validity is far smaller."""

BoundedNumber = Annotated[float, Strict(), Field(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
PositiveNumber = Annotated[float, Strict(), Field(ge=1e-3, le=MAX_COORDINATE_M)]
Triple = tuple[BoundedNumber, BoundedNumber, BoundedNumber]
Pair = tuple[BoundedNumber, BoundedNumber]
WindSpeed = Annotated[float, Strict(), Field(ge=-MAX_WIND_M_S, le=MAX_WIND_M_S)]

MIN_WAYPOINT_HEIGHT_M = 0.2
"""Least height of a waypoint above the floor (m), above the legs and the ground effect."""
_MAX_LISTED_POSITIONS = 7  # of a mission in its text: the start and six waypoints


class _MissionTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _strict_field(default: Any, description: str, **bounds: Any) -> Any:
    """Declare a field of a number, boolean or text; values of another type are not converted."""
    return Field(default=default, description=description, strict=True, **bounds)


class TakeOff(_MissionTable):
    """Take-off, the first part of every mission."""

    height_m: float = _strict_field(1.0, "height to climb to", ge=MIN_WAYPOINT_HEIGHT_M, le=50.0)
    wait_s: float = _strict_field(2.5, "wait there", ge=0.0, le=3600.0)


class Waypoint(_MissionTable):
    """Waypoint of a mission file: position, wait, heading and speed."""

    position_m: Triple = Field(description="N, E, D; heights above the floor are negative D")
    wait_s: float = _strict_field(0.0, "wait once it is reached", ge=0.0, le=3600.0)
    heading_deg: float | None = _strict_field(
        None,
        "heading on the leg and at the waypoint, from north to east; default: along the leg",
        ge=-360.0,
        le=360.0,
    )
    speed_m_s: float | None = _strict_field(
        None, "horizontal speed on the leg; default: that of [limits]", ge=0.01, le=3.0
    )


class Limits(_MissionTable):
    """Limits of the reference trajectories: speeds, accelerations, and the radius within which a waypoint counts as
    reached.
    """

    speed_m_s: float = _strict_field(0.6, "horizontal speed", ge=0.01, le=3.0)
    climb_m_s: float = _strict_field(0.5, "rate of climb", ge=0.01, le=2.0)
    descent_m_s: float = _strict_field(0.4, "rate of descent", ge=0.01, le=1.0)
    touchdown_m_s: float = _strict_field(0.15, "rate of descent over the last 0.4 m before the floor", gt=0.02, le=0.25)
    acceleration_m_s2: float = _strict_field(0.4, "horizontal acceleration", ge=0.01, le=2.0)
    climb_acceleration_m_s2: float = _strict_field(0.4, "acceleration of climb and descent", ge=0.01, le=2.0)
    yaw_rate_deg_s: float = _strict_field(60.0, "rate of turn", ge=1.0, le=360.0)
    yaw_acceleration_deg_s2: float = _strict_field(90.0, "acceleration of a turn", ge=1.0, le=1000.0)
    reach_m: float = _strict_field(0.05, "acceptance radius of a waypoint", ge=0.01, le=1.0)
    reach_m_s: float = _strict_field(0.1, "speed below which a waypoint counts as reached", ge=0.01, le=1.0)


class Path(_MissionTable):
    """Table ``[path]`` of a mission file: whether the paths between waypoints are straight or a spline."""

    kind: Literal["straight", "spline"] = Field(
        default="straight",
        description='"straight": heading and height first, then a level line; "spline": heading first, then a cubic '
        "spline through the waypoints",
    )


class Avoidance(_MissionTable):
    """Settings for the avoidance of obstacles that the range beams detect."""

    enabled: bool = _strict_field(True, "true: detect and avoid obstacles")
    clearance_m: float = _strict_field(
        0.39,
        "distance to keep between the helicopter's centre and any surface (rotor radius and 0.3 m)",
        ge=0.15,
        le=1.0,
    )
    speed_m_s: float = _strict_field(0.3, "speed around an obstacle, and on a leg with scanning", gt=0.05, le=1.0)
    scan: bool | None = _strict_field(
        None,
        "fly with one beam ahead and swing the nose, so that no obstacle stays between two beams; default: "
        "true if the file names a box, a cylinder or a wall",
    )
    give_up_s: float = _strict_field(90.0, "time to try to get around obstacles on one leg", ge=5.0, le=3600.0)


class Battery(_MissionTable):
    """Voltage at which the vehicle lands, and share of the charge that a mission may use."""

    low_V: float | None = _strict_field(
        None, "land below this voltage; default: the vehicle's limit", gt=0.0, le=1000.0
    )
    usable: float = _strict_field(0.8, "fraction of the charge that a mission may use", ge=0.01, le=1.0)


class Wind(_MissionTable):
    """Wind of the simulation, unknown to the helicopter."""

    steady_m_s: tuple[WindSpeed, WindSpeed, WindSpeed] = Field(
        default=(0.0, 0.0, 0.0), description="velocity of the air, N, E, D"
    )
    gust_m_s: float = _strict_field(0.0, "intensity of the gusts (rms)", ge=0.0, le=MAX_GUST_RMS_M_S)


class Fence(_MissionTable):
    """Geofence: areas in which the vehicle must stay or which it must avoid, and its action on a breach."""

    polygon_m: tuple[Pair, ...] = Field(default=(), description="corners N, E of the inclusion area, three or more")
    centre_m: Pair | None = Field(default=None, description="N, E of the centre of an inclusion circle")
    radius_m: float | None = _strict_field(None, "radius of that circle", ge=0.1, le=MAX_COORDINATE_M)
    ceiling_m: float | None = _strict_field(
        None, "greatest height above the floor", ge=MIN_WAYPOINT_HEIGHT_M, le=MAX_COORDINATE_M
    )
    keep_out_m: tuple[tuple[Pair, ...], ...] = Field(
        default=(), description="exclusion areas, each with its corners N, E"
    )
    keep_out_circles_m: tuple[Triple, ...] = Field(default=(), description="exclusion circles: N, E and radius of each")
    action: Literal["hold", "return", "land"] = Field(
        default="hold",
        description='action outside the fence: "hold" position, "return" to above the start and land, or "land"',
    )

    @model_validator(mode="after")
    def _check_geometry(self) -> Fence:
        if (self.centre_m is None) != (self.radius_m is None):
            raise make_validation_error("a circle needs both centre_m and radius_m", "give both")
        for name, corners in (("polygon_m", self.polygon_m), *(("keep_out_m", z) for z in self.keep_out_m)):
            if name == "polygon_m" and not corners:
                continue
            if len(corners) < 3:
                raise make_validation_error(f"{name} has {len(corners)} corners", "give three or more")
            if _crosses_itself(corners):
                raise make_validation_error(f"{name} crosses itself", "give its corners in order")
        if any(radius <= 0.0 for _, _, radius in self.keep_out_circles_m):
            raise make_validation_error(
                "keep_out_circles_m has a radius that is not above 0", "give N, E and a radius above 0"
            )
        if not (self.polygon_m or self.radius_m or self.ceiling_m or self.keep_out_m or self.keep_out_circles_m):
            raise make_validation_error(
                "bounds nothing", "give polygon_m, centre_m with radius_m, ceiling_m or keep_out_m"
            )
        return self


def _crosses_itself(corners: tuple[Pair, ...]) -> bool:
    """Return whether two sides of a polygon cross, or it has no area."""

    def cross_product(a: Pair, b: Pair, c: Pair) -> float:
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    n = len(corners)
    sides = [(corners[k], corners[(k + 1) % n]) for k in range(n)]
    if not abs(sum(a[0] * b[1] - a[1] * b[0] for a, b in sides)) > 1e-9:
        return True
    for i in range(n):
        for j in range(i + 2, n if i else n - 1):
            (a, b), (c, d) = sides[i], sides[j]
            if (
                cross_product(a, b, c) * cross_product(a, b, d) < 0.0
                and cross_product(c, d, a) * cross_product(c, d, b) < 0.0
            ):
                return True
    return False


class BoxTable(_MissionTable):
    """Upright box as an obstacle."""

    name: str = Field(default="box", description="what messages call it")
    centre_m: Triple = Field(description="N, E, D of its centre")
    size_m: tuple[PositiveNumber, PositiveNumber, PositiveNumber] = Field(description="edge lengths, x, y, z")
    yaw_deg: float = _strict_field(0.0, "heading of the x edge, from north to east", ge=-360.0, le=360.0)


class CylinderTable(_MissionTable):
    """Upright cylinder as an obstacle."""

    name: str = Field(default="cylinder", description="what messages call it")
    centre_m: Pair = Field(description="N, E of its axis")
    radius_m: float = _strict_field(..., "radius", ge=1e-3, le=MAX_COORDINATE_M)
    height_m: float = _strict_field(..., "from its foot to its top", ge=1e-3, le=MAX_COORDINATE_M)
    foot_m: float = _strict_field(0.0, "height of the foot above the floor", ge=0.0, le=MAX_COORDINATE_M)


class WallTable(_MissionTable):
    """Free-standing wall as an obstacle."""

    name: str = Field(default="wall", description="what messages call it")
    start_m: Pair = Field(description="N, E of one end")
    end_m: Pair = Field(description="N, E of the other end")
    height_m: float = _strict_field(..., "height above the floor", ge=1e-3, le=MAX_COORDINATE_M)
    thickness_m: float = _strict_field(0.1, "thickness", ge=1e-3, le=MAX_COORDINATE_M)


class RoomTable(_MissionTable):
    """Room: walls and ceiling around the flight."""

    north_m: Pair = Field(description="least and greatest N inside")
    east_m: Pair = Field(description="least and greatest E inside")
    height_m: float | None = _strict_field(
        None, "height of the ceiling; default: no ceiling", ge=0.1, le=MAX_COORDINATE_M
    )


class FloorTable(_MissionTable):
    """Floor below an onboard camera, in the simulation."""

    texture: str = Field(description="floor, as for `mufly fly --floor`: a kind, a package's picture or a picture file")
    width_m: float | None = _strict_field(
        None,
        "width of the picture from west to east; default: that of `mufly fly --floor`",
        ge=0.01,
        le=MAX_COORDINATE_M,
    )


class Mission(_MissionTable):
    """A mission as stated in its file; `mufly.mission.load_mission` reads and checks it.

    The keys carry the units of the file. `world`, `trajectory_limits` and `scans_by_yawing` are derived from them.
    """

    name: str = Field(default="", description="name of the mission; default: name of the file")
    description: str = Field(default="", description="one line about it")
    start_m: Pair = Field(default=(0.0, 0.0), description="start position N, E")
    start_heading_deg: float = _strict_field(0.0, "initial heading, from north to east", ge=-360.0, le=360.0)
    at_end: Literal["land", "hover", "return"] = Field(
        default="land",
        description='action after the last wait: "land", "hover" until a request or a low battery, '
        'or "return" to above the start and land',
    )
    take_off: TakeOff = TakeOff()
    waypoint: tuple[Waypoint, ...] = ()
    limits: Limits = Limits()
    path: Path = Path()
    avoidance: Avoidance = Avoidance()
    battery: Battery = Battery()
    wind: Wind = Wind()
    fence: Fence | None = None
    room: RoomTable | None = None
    floor: FloorTable | None = None
    box: tuple[BoxTable, ...] = ()
    cylinder: tuple[CylinderTable, ...] = ()
    wall: tuple[WallTable, ...] = ()

    def __repr__(self) -> str:
        """Return name, path and non-default settings in a few lines."""
        title = f"Mission {self.name}" + (f": {self.description}" if self.description else "")
        way = [self.start_m, *(w.position_m for w in self.waypoint)]
        lines = [f"  take-off to {self.take_off.height_m:g} m at N {way[0][0]:g}, E {way[0][1]:g} m"]
        lines += [f"  {k}: N {w[0]:g}, E {w[1]:g}, D {w[2]:g} m" for k, w in enumerate(way[1:_MAX_LISTED_POSITIONS], 1)]
        if len(way) > _MAX_LISTED_POSITIONS:
            lines.append(f"  {len(way) - _MAX_LISTED_POSITIONS} more waypoints")
        lines.append(f"  at the end: {self.at_end}")
        given = sorted(self.model_fields_set - {"name", "description", "take_off", "waypoint", "at_end", "start_m"})
        lines += [f"  also given: {', '.join(given)}"] if given else []
        return "\n".join([title, *lines, f"  all of it: `mufly mission show {self.name or 'FILE'} --toml`"])

    __str__ = __repr__

    def replace_parts(self, **parts: Any) -> Mission:
        """Return the mission with some parts replaced; it is checked and derives its values anew."""
        return Mission(**{**{name: getattr(self, name) for name in Mission.model_fields}, **parts})

    @cached_property
    def world(self) -> World:
        """Room, boxes, cylinders and walls of the mission as one world."""
        boxes = [Box(b.centre_m, b.size_m, math.radians(b.yaw_deg), b.name) for b in self.box]
        boxes += [
            make_wall(w.start_m, w.end_m, height=w.height_m, thickness=w.thickness_m, name=w.name) for w in self.wall
        ]
        posts = [Cylinder(c.centre_m, c.radius_m, c.height_m, c.foot_m, c.name) for c in self.cylinder]
        r = self.room
        room = Room(r.north_m, r.east_m, math.inf if r.height_m is None else r.height_m) if r else None
        return World(tuple(boxes), tuple(posts), room)

    @cached_property
    def scans_by_yawing(self) -> bool:
        """Whether the helicopter yaws to and fro to scan for obstacles."""
        chosen = self.avoidance.scan
        named = bool(self.box or self.cylinder or self.wall)
        return self.avoidance.enabled and (named if chosen is None else chosen)

    @cached_property
    def trajectory_limits(self) -> TrajectoryLimits:
        """Limits of the trajectories in SI units; while scanning, ``avoidance.speed_m_s`` bounds the speed."""
        return self.leg_limits(None)

    def leg_limits(self, index: int | None) -> TrajectoryLimits:
        """Return the limits on the leg to waypoint ``index`` (from 0), with the waypoint's own speed if it has one."""
        q = self.limits
        asked = None if index is None else self.waypoint[index].speed_m_s
        speed = q.speed_m_s if asked is None else asked
        return TrajectoryLimits(
            min(speed, self.avoidance.speed_m_s) if self.scans_by_yawing else speed,
            q.climb_m_s,
            q.descent_m_s,
            q.acceleration_m_s2,
            q.climb_acceleration_m_s2,
            math.radians(q.yaw_rate_deg_s),
            math.radians(q.yaw_acceleration_deg_s2),
        )


def limits_to_file_units(q: TrajectoryLimits) -> dict[str, float]:
    """Return limits of trajectories with the keys and units of a mission file."""
    return {
        "speed_m_s": q.speed,
        "climb_m_s": q.climb,
        "descent_m_s": q.descent,
        "acceleration_m_s2": q.acceleration,
        "climb_acceleration_m_s2": q.climb_acceleration,
        "yaw_rate_deg_s": math.degrees(q.yaw_rate),
        "yaw_acceleration_deg_s2": math.degrees(q.yaw_acceleration),
    }


# ----------------------------------------------------------------------------
# Trajectories of the mission's legs.


ROTOR_SPIN_UP_TIME_S = 3.0
"""Time of the rotors' spin-up before lift-off (s)."""

SLOW_LANDING_HEIGHT_M = 0.4
"""Height below which a landing descends at touchdown speed (m)."""


def plan_leg_trajectory(
    mission: Mission,
    index: int,
    start: NDArray[np.float64],
    heading: float,
    *,
    nose_offset: float = 0.0,
    made: bool = True,
) -> Trajectory:
    """Return the trajectory of the leg to waypoint ``index`` (from 0), from any start position.

    Parameters
    ----------
    mission : Mission
        Source of path kind and limits.
    index : int
        Index of the waypoint.
    start : (3,) array
        Start position N, E, D (m).
    heading : float
        Heading at the start (rad).
    nose_offset : float
        Angle of the nose from the direction of flight (rad), for waypoints without a heading.
    made : bool
        Whether a curve is computed at once, or later by :meth:`mufly.mission.trajectory.Trajectory.finish_curve`.
    """
    waypoint = mission.waypoint[index]
    goal = np.array(waypoint.position_m)
    final = None if waypoint.heading_deg is None else math.radians(waypoint.heading_deg)
    limits = mission.leg_limits(index)
    if mission.path.kind == "straight":
        return plan_straight(start, goal, heading, limits, final_heading=final, nose_offset=nose_offset)
    before = np.array(mission.waypoint[index - 1].position_m) if index else position_after_take_off(mission)
    # Chord directions through the neighbours (Catmull-Rom) give a curve without kinks at waypoints.
    after = np.array(mission.waypoint[index + 1].position_m) if index + 1 < len(mission.waypoint) else goal
    further = np.array(mission.waypoint[index - 2].position_m) if index > 1 else position_after_take_off(mission)
    leaving = goal - further if index else goal - before
    way = plan_pending_curve(
        start, goal, leaving, after - before, heading, limits, final_heading=final, nose_offset=nose_offset
    )
    return way.finish_curve() if made else way


def position_after_take_off(mission: Mission) -> NDArray[np.float64]:
    """Return the position at the end of the take-off, N, E, D (m)."""
    return np.array([*mission.start_m, -mission.take_off.height_m])
