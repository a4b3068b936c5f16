"""Where does it fly? A room with a floor, walls, boxes and cylinders, and the geometry of seeing and touching them."""

from mufly.world.geometry import contains, distance, distances, ranges
from mufly.world.model import Box, Cylinder, Room, World, wall

__all__ = ["Box", "Cylinder", "Room", "World", "contains", "distance", "distances", "ranges", "wall"]
