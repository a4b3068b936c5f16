"""The world as the 3-D scene draws it: boxes, cylinders and a room, in N-E-D metres."""

from __future__ import annotations

import math
from typing import Any

from mufly.world import World

__all__ = ["drawn_world"]


def drawn_world(world: World | None) -> dict[str, Any]:
    """Return what stands in the world, with lists and numbers only.

    Boxes are ``{name, c: [N, E, D], s: [x, y, z], yaw}``, cylinders ``{name, c: [N, E], r, h, foot}``, the room
    ``{n: [least, greatest], e: [...], h: height or None}``.
    """
    if world is None:
        return {"boxes": [], "cylinders": [], "room": None}
    room = world.room
    return {
        "boxes": [{"name": b.name, "c": list(b.centre), "s": list(b.size), "yaw": b.yaw} for b in world.boxes],
        "cylinders": [
            {"name": c.name, "c": list(c.centre), "r": c.radius, "h": c.height, "foot": c.foot}
            for c in world.cylinders
        ],
        "room": room and {
            "n": list(room.north), "e": list(room.east), "h": room.height if math.isfinite(room.height) else None,
        },
    }  # fmt: skip
