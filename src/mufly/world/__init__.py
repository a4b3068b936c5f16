"""Environment of the vehicle: a room with floor, walls, boxes and cylinders, and its ranges and collisions."""

from mufly.world.obstacles import (
    Box,
    Cylinder,
    Room,
    World,
    cast_ranges,
    compute_first_hit_distance,
    compute_obstacle_distances,
    compute_packed_obstacle_distances,
    find_nearest_obstacle,
    make_wall,
)

__all__ = [
    "Box",
    "Cylinder",
    "Room",
    "World",
    "cast_ranges",
    "compute_first_hit_distance",
    "compute_obstacle_distances",
    "compute_packed_obstacle_distances",
    "find_nearest_obstacle",
    "make_wall",
]
