"""Environment of the vehicle: a room with floor, walls, boxes and cylinders, and its ranges and collisions."""

from mufly.world.obstacles import (
    Box,
    Cylinder,
    Room,
    World,
    cast_ranges,
    first_hit_distance,
    make_wall,
    obstacle_distance,
    obstacle_distances,
    packed_obstacle_distances,
)

__all__ = [
    "Box",
    "Cylinder",
    "Room",
    "World",
    "cast_ranges",
    "first_hit_distance",
    "make_wall",
    "obstacle_distance",
    "obstacle_distances",
    "packed_obstacle_distances",
]
