"""Obstacles around the helicopter: ray casting and signed distances.

All coordinates are N-E-D in metres: the floor is the plane D = 0 and heights are negative. Obstacles are solid: upright
boxes with any yaw, upright circular cylinders, and a `Room` whose walls and ceiling enclose the flight. Each obstacle
has a name for messages.

A ray x(t) = x0 + t u with unit vector u hits

- a box, in its own axes, where it has entered all three slabs |x_i| <= h_i (slab method);
- an upright cylinder of radius R where |x0 + t u - c|^2 = R^2 in the horizontal plane, a quadratic in t, cut by
  the slab between its foot and its top;
- a wall, the ceiling or the floor where one coordinate reaches the plane.

The signed distance to a box with half edges h of a point at q in its axes is |max(|q| - h, 0)| + min(max_i(|q_i| -
h_i), 0): Euclidean outside, minus the distance to the nearest face inside. A cylinder is a box in the two coordinates
(distance from the axis, height). For a wall or ceiling it is the distance to the plane. Own derivation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError

_ROOM_FACE_NAMES = ("south wall", "north wall", "west wall", "east wall", "ceiling")


def _require_finite(where: str, key: str, *values: float) -> None:
    for value in values:
        if not math.isfinite(value):
            raise InputError(where, key, f"{value} is not a number", "give finite metres and radians")


def _require_positive(where: str, key: str, *values: float) -> None:
    _require_finite(where, key, *values)
    for value in values:
        if value <= 0.0:
            raise InputError(where, key, f"{value:g} is not positive", "give a length above zero")


@dataclass(frozen=True, slots=True)
class Box:
    """Upright box.

    Attributes
    ----------
    centre : (3,) tuple
        N, E, D of the centre (m).
    size : (3,) tuple
        Full edge lengths (m) along the box's x, y and z axes.
    yaw : float
        Angle of the x edge from north towards east (rad).
    name : str
        Name in messages.
    """

    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0
    name: str = "box"

    def __post_init__(self) -> None:
        _require_finite(self.name, "centre", *self.centre)
        _require_positive(self.name, "size", *self.size)
        _require_finite(self.name, "yaw", self.yaw)


@dataclass(frozen=True, slots=True)
class Cylinder:
    """Upright circular cylinder.

    Attributes
    ----------
    centre : (2,) tuple
        N, E of the axis (m).
    radius : float
        Radius (m).
    height : float
        Height from foot to top (m).
    foot : float
        Height of the foot above the floor (m, positive up); 0 for a cylinder on the floor.
    name : str
        Name in messages.
    """

    centre: tuple[float, float]
    radius: float
    height: float
    foot: float = 0.0
    name: str = "cylinder"

    def __post_init__(self) -> None:
        _require_finite(self.name, "centre", *self.centre)
        _require_positive(self.name, "radius", self.radius)
        _require_positive(self.name, "height", self.height)
        _require_finite(self.name, "foot", self.foot)


@dataclass(frozen=True, slots=True)
class Room:
    """Four walls and a ceiling around the flight.

    Attributes
    ----------
    north, east : (2,) tuples
        Least and greatest N and E inside the walls (m).
    height : float
        Height of the ceiling above the floor (m); infinite without ceiling.
    """

    north: tuple[float, float]
    east: tuple[float, float]
    height: float = math.inf

    def __post_init__(self) -> None:
        for key, (low, high) in (("north", self.north), ("east", self.east)):
            _require_finite("room", key, low, high)
            if low >= high:
                raise InputError("room", key, f"[{low:g}, {high:g}] is an empty interval", "give [least, greatest]")
        if not self.height > 0.0:
            raise InputError("room", "height", f"{self.height} is not positive", "give a height above zero")


@dataclass(frozen=True)
class World:
    """Static environment of the helicopter.

    Attributes
    ----------
    boxes, cylinders : tuples
        The obstacles.
    room : Room or None
        Walls and ceiling; None for open terrain.
    has_floor : bool
        True if beams hit the plane D = 0, which is never an obstacle in `find_nearest_obstacle`.
    obstacle_names : tuple of str
        Name of every obstacle in the order in which `compute_obstacle_distances` counts them: boxes, cylinders, then
        the walls (south, north, west, east) and the ceiling.
    """

    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    room: Room | None = None
    has_floor: bool = True
    obstacle_names: tuple[str, ...] = field(init=False, compare=False)
    packed_tables: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] = field(
        init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "boxes", tuple(self.boxes))
        object.__setattr__(self, "cylinders", tuple(self.cylinders))
        names = [*(b.name for b in self.boxes), *(c.name for c in self.cylinders)]
        object.__setattr__(self, "obstacle_names", (*names, *_ROOM_FACE_NAMES))
        object.__setattr__(self, "packed_tables", _pack_world(self))

    @property
    def is_empty(self) -> bool:
        """True if there is no obstacle but the floor."""
        return not (self.boxes or self.cylinders or self.room)


def _pack_world(world: World) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return flat tables for the compiled loops: boxes (n, 8), cylinders (n, 5), limits (6,)."""
    boxes = np.array(
        [(*b.centre, *(0.5 * s for s in b.size), math.cos(b.yaw), math.sin(b.yaw)) for b in world.boxes]
    ).reshape(-1, 8)
    cylinders = np.array([(*c.centre, c.radius, -(c.foot + c.height), -c.foot) for c in world.cylinders]).reshape(-1, 5)
    r = world.room
    inside = (*r.north, *r.east, -r.height) if r else (-math.inf, math.inf, -math.inf, math.inf, -math.inf)
    limits = np.array([*inside, 0.0 if world.has_floor else math.inf])
    return boxes, cylinders, limits


def make_wall(
    start: tuple[float, float],
    end: tuple[float, float],
    *,
    height: float,
    thickness: float = 0.1,
    name: str = "wall",
) -> Box:
    """Return a free-standing wall on the floor as a box.

    Parameters
    ----------
    start, end : (2,) tuples
        N, E of the two ends of the centre line (m).
    height, thickness : float
        Height above the floor, and thickness (m).
    name : str
        Name in messages.

    Raises
    ------
    InputError
        If the two ends coincide, or a length is not positive.
    """
    north, east = end[0] - start[0], end[1] - start[1]
    length = math.hypot(north, east)
    if not length > 0.0:
        raise InputError(name, "end", f"{end} equals the start of the wall", "give two different ends")
    centre = (0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1]), -0.5 * height)
    return Box(centre, (length, thickness, height), math.atan2(east, north), name)


_Array = NDArray[np.float64]
BOX_CENTRE_INDEX, BOX_HALF_EDGES_INDEX, BOX_HEADING_COS_INDEX, BOX_HEADING_SIN_INDEX = 0, 3, 6, 7
"""Indices in the row of a packed box: N, E, D of the centre, half edges, cosine and sine of the heading."""
CYLINDER_RADIUS_INDEX, CYLINDER_TOP_INDEX, CYLINDER_BOTTOM_INDEX = 2, 3, 4
"""Indices in the row of a packed cylinder, after N and E of the axis."""
ROOM_CEILING_INDEX, ROOM_FLOOR_INDEX = 4, 5
"""Indices among the limits of a packed room, after those of N and E."""


@cached_njit
def _clip_to_slab(x: float, u: float, half: float, near: float, far: float) -> tuple[float, float]:
    """Clip the interval [near, far] of a ray's parameter t to |x + t u| <= half; an empty interval has near > far."""
    if u == 0.0:
        return (near, far) if abs(x) <= half else (1.0, -1.0)
    a, b = (-half - x) / u, (half - x) / u
    return max(near, min(a, b)), min(far, max(a, b))


@cached_njit
def compute_first_hit_distance(
    x: _Array, un: float, ue: float, ud: float, best: float, boxes: _Array, cylinders: _Array, limits: _Array
) -> float:
    """Return the distance (m) from ``x`` (3,) along a unit vector to the first surface, at most ``best``."""
    for b in boxes:
        dn, de = x[0] - b[0], x[1] - b[1]
        c, s = b[BOX_HEADING_COS_INDEX], b[BOX_HEADING_SIN_INDEX]
        near, far = _clip_to_slab(c * dn + s * de, c * un + s * ue, b[BOX_HALF_EDGES_INDEX], 0.0, best)
        near, far = _clip_to_slab(-s * dn + c * de, -s * un + c * ue, b[BOX_HALF_EDGES_INDEX + 1], near, far)
        near, far = _clip_to_slab(x[2] - b[2], ud, b[BOX_HALF_EDGES_INDEX + 2], near, far)
        if near <= far:
            best = near
    for row in cylinders:
        radius, top, bottom = row[CYLINDER_RADIUS_INDEX], row[CYLINDER_TOP_INDEX], row[CYLINDER_BOTTOM_INDEX]
        mid, half = 0.5 * (top + bottom), 0.5 * (bottom - top)
        near, far = _clip_to_slab(x[2] - mid, ud, half, 0.0, best)
        dn, de = x[0] - row[0], x[1] - row[1]
        uu, du, dd = un * un + ue * ue, dn * un + de * ue, dn * dn + de * de - radius * radius
        if uu == 0.0:
            if dd > 0.0:
                continue
        else:
            under = du * du - uu * dd
            if under < 0.0:
                continue
            root = math.sqrt(under)
            near, far = max(near, (-du - root) / uu), min(far, (-du + root) / uu)
        if near <= far:
            best = near
    for axis in range(2):
        u = un if axis == 0 else ue
        if u < 0.0:
            best = min(best, max(0.0, (limits[2 * axis] - x[axis]) / u))
        elif u > 0.0:
            best = min(best, max(0.0, (limits[2 * axis + 1] - x[axis]) / u))
    if ud < 0.0:
        best = min(best, max(0.0, (limits[ROOM_CEILING_INDEX] - x[2]) / ud))
    elif ud > 0.0:
        best = min(best, max(0.0, (limits[ROOM_FLOOR_INDEX] - x[2]) / ud))
    return best


@cached_njit
def _cast_beams(
    x: _Array, directions: _Array, max_range: float, boxes: _Array, cylinders: _Array, limits: _Array
) -> _Array:
    out = np.empty(directions.shape[0])
    for k in range(directions.shape[0]):
        un, ue, ud = directions[k, 0], directions[k, 1], directions[k, 2]
        out[k] = compute_first_hit_distance(x, un, ue, ud, max_range, boxes, cylinders, limits)
    return out


@cached_njit
def compute_packed_obstacle_distances(
    points: _Array, boxes: _Array, cylinders: _Array, limits: _Array
) -> tuple[_Array, NDArray[np.int64]]:
    """Return signed distance and index of the nearest obstacle of a packed world to points (n, 3)."""
    count = points.shape[0]
    least, which = np.full(count, np.inf), np.full(count, -1, np.int64)
    nb, nc = boxes.shape[0], cylinders.shape[0]
    for k in range(count):
        x = points[k]
        for i in range(nb):
            b = boxes[i]
            dn, de = x[0] - b[0], x[1] - b[1]
            qx = abs(b[BOX_HEADING_COS_INDEX] * dn + b[BOX_HEADING_SIN_INDEX] * de) - b[BOX_HALF_EDGES_INDEX]
            qy = abs(-b[BOX_HEADING_SIN_INDEX] * dn + b[BOX_HEADING_COS_INDEX] * de) - b[BOX_HALF_EDGES_INDEX + 1]
            qz = abs(x[2] - b[2]) - b[BOX_HALF_EDGES_INDEX + 2]
            d = math.sqrt(max(qx, 0.0) ** 2 + max(qy, 0.0) ** 2 + max(qz, 0.0) ** 2)
            d += min(max(qx, qy, qz), 0.0)
            if d < least[k]:
                least[k], which[k] = d, i
        for i in range(nc):
            c = cylinders[i]
            qr = math.hypot(x[0] - c[0], x[1] - c[1]) - c[CYLINDER_RADIUS_INDEX]
            qz = max(c[CYLINDER_TOP_INDEX] - x[2], x[2] - c[CYLINDER_BOTTOM_INDEX])
            d = math.sqrt(max(qr, 0.0) ** 2 + max(qz, 0.0) ** 2) + min(max(qr, qz), 0.0)
            if d < least[k]:
                least[k], which[k] = d, nb + i
        for face in range(5):
            d = x[face // 2] - limits[face]
            if face == 1 or face == 3:
                d = -d
            if d < least[k]:
                least[k], which[k] = d, nb + nc + face
    return least, which


def cast_ranges(world: World, position: ArrayLike, directions: ArrayLike, max_range: float = math.inf) -> _Array:
    """Return the distance along each beam to the first surface.

    Parameters
    ----------
    world : World
        Obstacles, including the floor unless ``world.has_floor`` is false.
    position : (3,) array
        Origin of the beams, N, E, D (m).
    directions : (n, 3) array
        Unit vectors of the beams in N, E, D.
    max_range : float
        Range of beams without a hit, and greatest range (m).

    Returns
    -------
    (n,) array
        Ranges (m) in [0, max_range]; 0 for a beam that starts inside an obstacle or outside the room.
    """
    return _cast_beams(
        np.ascontiguousarray(position, dtype=np.float64),
        np.ascontiguousarray(directions, dtype=np.float64),
        float(max_range),
        *world.packed_tables,
    )


def compute_obstacle_distances(world: World, points: ArrayLike) -> tuple[_Array, NDArray[np.int64]]:
    """Return the signed distances of many points to the nearest obstacle, and its index.

    Parameters
    ----------
    world : World
        Obstacles, including walls and ceiling but not the floor.
    points : (n, 3) array
        Points, N, E, D (m).

    Returns
    -------
    distance : (n,) array
        Signed distance (m), negative inside an obstacle or outside the room, infinite in an empty world.
    which : (n,) array of int
        Index of the nearest obstacle in ``world.obstacle_names``, -1 in an empty world.
    """
    return compute_packed_obstacle_distances(
        np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3), *world.packed_tables
    )


def find_nearest_obstacle(world: World, point: ArrayLike) -> tuple[float, str]:
    """Return the signed distance (m) of a point (3,) to the nearest obstacle, and the obstacle's name ("" if none)."""
    least, which = compute_obstacle_distances(world, point)
    return float(least[0]), world.obstacle_names[which[0]] if which[0] >= 0 else ""
