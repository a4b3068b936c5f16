"""What stands around the helicopter.

All coordinates are N-E-D in metres: the floor is the plane D = 0 and heights are negative. Obstacles are solid:
upright boxes that may be turned about the vertical, upright circular cylinders, and a `Room` whose walls and
ceiling enclose the flight. Each has a name, so that a message can say which one is meant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

__all__ = ["Box", "Cylinder", "Room", "World", "wall"]

_ROOM_FACES = ("south wall", "north wall", "west wall", "east wall", "ceiling")


def _finite(where: str, key: str, *values: float) -> None:
    for value in values:
        if not math.isfinite(value):
            raise InputError(where, key, f"{value} is not a number", "give finite metres and radians")


def _positive(where: str, key: str, *values: float) -> None:
    _finite(where, key, *values)
    for value in values:
        if value <= 0.0:
            raise InputError(where, key, f"{value:g} is not positive", "give a length above zero")


@dataclass(frozen=True, slots=True)
class Box:
    """An upright box.

    Attributes
    ----------
    centre : (3,) tuple
        N, E, D of its centre (m).
    size : (3,) tuple
        Full edge lengths (m) along its own x, y and z.
    yaw : float
        Turn of its x edge from north towards east (rad).
    name : str
        What messages call it.
    """

    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0
    name: str = "box"

    def __post_init__(self) -> None:
        _finite(self.name, "centre", *self.centre)
        _positive(self.name, "size", *self.size)
        _finite(self.name, "yaw", self.yaw)


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright circular cylinder.

    Attributes
    ----------
    centre : (2,) tuple
        N, E of its axis (m).
    radius : float
        Radius (m).
    height : float
        From its foot to its top (m).
    foot : float
        Height of its foot above the floor (m, positive up); 0 stands on the floor.
    name : str
        What messages call it.
    """

    centre: tuple[float, float]
    radius: float
    height: float
    foot: float = 0.0
    name: str = "cylinder"

    def __post_init__(self) -> None:
        _finite(self.name, "centre", *self.centre)
        _positive(self.name, "radius", self.radius)
        _positive(self.name, "height", self.height)
        _finite(self.name, "foot", self.foot)


@dataclass(frozen=True, slots=True)
class Room:
    """Four walls and a ceiling around the flight.

    Attributes
    ----------
    north, east : (2,) tuples
        Least and greatest N and E inside the walls (m).
    height : float
        Height of the ceiling above the floor (m); infinite when there is none.
    """

    north: tuple[float, float]
    east: tuple[float, float]
    height: float = math.inf

    def __post_init__(self) -> None:
        for key, (low, high) in (("north", self.north), ("east", self.east)):
            _finite("room", key, low, high)
            if low >= high:
                raise InputError(
                    "room", key, f"[{low:g}, {high:g}] encloses nothing", "give [least, greatest]"
                )
        if not self.height > 0.0:
            raise InputError("room", "height", f"{self.height} is not positive", "give a height above zero")


@dataclass(frozen=True)
class World:
    """Everything that stands still around the helicopter.

    Attributes
    ----------
    boxes, cylinders : tuples
        The obstacles.
    room : Room or None
        Walls and ceiling, or an open plain.
    floor : bool
        Whether beams see the plane D = 0. It is never an obstacle in `distance`.
    names : tuple of str
        Name of every obstacle in the order in which `distances` counts them: boxes, cylinders, then the walls
        (south, north, west, east) and the ceiling.
    """

    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    room: Room | None = None
    floor: bool = True
    names: tuple[str, ...] = field(init=False, compare=False)
    packed: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] = field(
        init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "boxes", tuple(self.boxes))
        object.__setattr__(self, "cylinders", tuple(self.cylinders))
        names = [*(b.name for b in self.boxes), *(c.name for c in self.cylinders)]
        object.__setattr__(self, "names", (*names, *_ROOM_FACES))
        object.__setattr__(self, "packed", _pack(self))

    @property
    def empty(self) -> bool:
        """Whether there is nothing to hit but the floor."""
        return not (self.boxes or self.cylinders or self.room)


def _pack(world: World) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Flat tables for the compiled loops: boxes (n, 8), cylinders (n, 5), limits (6,)."""
    boxes = np.array(
        [(*b.centre, *(0.5 * s for s in b.size), math.cos(b.yaw), math.sin(b.yaw)) for b in world.boxes]
    ).reshape(-1, 8)
    cylinders = np.array(
        [(*c.centre, c.radius, -(c.foot + c.height), -c.foot) for c in world.cylinders]
    ).reshape(-1, 5)
    r = world.room
    inside = (*r.north, *r.east, -r.height) if r else (-math.inf, math.inf, -math.inf, math.inf, -math.inf)
    limits = np.array([*inside, 0.0 if world.floor else math.inf])
    return boxes, cylinders, limits


def wall(
    start: tuple[float, float],
    end: tuple[float, float],
    *,
    height: float,
    thickness: float = 0.1,
    name: str = "wall",
) -> Box:
    """A free-standing wall on the floor, as a box.

    Parameters
    ----------
    start, end : (2,) tuples
        N, E of the two ends of its middle line (m).
    height, thickness : float
        Its height above the floor and its thickness (m).
    name : str
        What messages call it.

    Raises
    ------
    InputError
        The two ends coincide, or a length is not positive.
    """
    north, east = end[0] - start[0], end[1] - start[1]
    length = math.hypot(north, east)
    if not length > 0.0:
        raise InputError(name, "end", f"{end} is where the wall starts", "give two different ends")
    centre = (0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1]), -0.5 * height)
    return Box(centre, (length, thickness, height), math.atan2(east, north), name)
