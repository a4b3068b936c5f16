"""Where does it fly? A room with a floor, walls, boxes and cylinders, and the geometry of seeing and touching them."""

from mufly.world.obstacles import (
    Box,
    Cylinder,
    Room,
    World,
    contains,
    distance,
    distances,
    first_hit,
    nearest,
    ranges,
    wall,
)

__all__ = [
    "Box",
    "Cylinder",
    "Room",
    "World",
    "contains",
    "distance",
    "distances",
    "first_hit",
    "nearest",
    "ranges",
    "wall",
]
