"""A flight in a 3-D viewer: the well-known messages that Foxglove's 3-D panel draws.

Field names and schema names are those of the Foxglove message schemas (docs.foxglove.dev, message schemas):
``foxglove.FrameTransforms``, ``foxglove.PoseInFrame``, ``foxglove.SceneUpdate``, ``foxglove.Log``.

Frames: ``world`` has z up, as viewers like it (x north, y west); ``ned`` is the inertial frame of mufly, half a
turn about x away from it; ``body`` is the helicopter, x forward, y right, z down, at its position and attitude
in ``ned``. What is drawn here is rounded to a micrometre; the numbers of record are in the other topics.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import orjson
from numpy.typing import ArrayLike, NDArray

from mufly.logs.messages import json_schema, stamp
from mufly.world import World

__all__ = [
    "SCHEMAS",
    "quaternions",
    "scene_message",
    "track_message",
    "transform_pieces",
]

BODY_COLOUR = (0.20, 0.20, 0.20, 1.0)
ROTOR_COLOUR = (0.00, 0.45, 0.70, 0.45)
OBSTACLE_COLOUR = (0.55, 0.55, 0.55, 0.60)
WAYPOINT_COLOUR = (0.84, 0.37, 0.00, 0.90)
TRACK_COLOUR = (0.00, 0.45, 0.70, 1.0)


def _array(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_number, _text, _flag = {"type": "number"}, {"type": "string"}, {"type": "boolean"}
_integer = {"type": "integer"}
_time = json_schema({"sec": _integer, "nsec": _integer}, "time")
_duration = json_schema({"sec": _integer, "nsec": _integer}, "duration")
_vector = json_schema(dict.fromkeys("xyz", _number), "foxglove.Vector3")
_point = json_schema(dict.fromkeys("xyz", _number), "foxglove.Point3")
_quaternion = json_schema(dict.fromkeys("xyzw", _number), "foxglove.Quaternion")
_colour = json_schema(dict.fromkeys("rgba", _number), "foxglove.Color")
_pose = json_schema({"position": _vector, "orientation": _quaternion}, "foxglove.Pose")
_transform = json_schema(
    {
        "timestamp": _time,
        "parent_frame_id": _text,
        "child_frame_id": _text,
        "translation": _vector,
        "rotation": _quaternion,
    },
    "foxglove.FrameTransform",
)
_solid = {"pose": _pose, "size": _vector, "color": _colour}
_line = {
    "type": _integer,
    "pose": _pose,
    "thickness": _number,
    "scale_invariant": _flag,
    "points": _array(_point),
    "color": _colour,
    "colors": _array(_colour),
    "indices": _array(_integer),
}
_label = {
    "pose": _pose,
    "billboard": _flag,
    "font_size": _number,
    "scale_invariant": _flag,
    "color": _colour,
    "text": _text,
}
_entity = json_schema(
    {
        "timestamp": _time,
        "frame_id": _text,
        "id": _text,
        "lifetime": _duration,
        "frame_locked": _flag,
        "metadata": _array(json_schema({"key": _text, "value": _text})),
        "cubes": _array(json_schema(_solid, "foxglove.CubePrimitive")),
        "spheres": _array(json_schema(_solid, "foxglove.SpherePrimitive")),
        "cylinders": _array(
            json_schema(
                _solid | {"bottom_scale": _number, "top_scale": _number}, "foxglove.CylinderPrimitive"
            )
        ),
        "lines": _array(json_schema(_line, "foxglove.LinePrimitive")),
        "texts": _array(json_schema(_label, "foxglove.TextPrimitive")),
    },
    "foxglove.SceneEntity",
)
_deletion = json_schema({"timestamp": _time, "type": _integer, "id": _text}, "foxglove.SceneEntityDeletion")

SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.FrameTransforms": json_schema({"transforms": _array(_transform)}, "foxglove.FrameTransforms"),
    "foxglove.PoseInFrame": json_schema(
        {"timestamp": _time, "frame_id": _text, "pose": _pose}, "foxglove.PoseInFrame"
    ),
    "foxglove.SceneUpdate": json_schema(
        {"deletions": _array(_deletion), "entities": _array(_entity)}, "foxglove.SceneUpdate"
    ),
}
"""JSON schemas of the messages written here, by name."""


def quaternions(attitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (x, y, z, w) that turn body axes into N-E-D.

    Parameters
    ----------
    attitude : (n, 3) array
        Roll, pitch, yaw (rad), in the aviation order (yaw, then pitch, then roll).

    Returns
    -------
    (n, 4) array
        Product of the three half-angle rotations.
    """
    half = 0.5 * attitude
    (c1, c2, c3), (s1, s2, s3) = np.cos(half).T, np.sin(half).T
    return np.column_stack(
        (
            s1 * c2 * c3 - c1 * s2 * s3,
            c1 * s2 * c3 + s1 * c2 * s3,
            c1 * c2 * s3 - s1 * s2 * c3,
            c1 * c2 * c3 + s1 * s2 * s3,
        )
    )


def transform_pieces() -> tuple[list[bytes], list[bytes]]:
    """Constant text around the numbers of a ``/tf`` and of a pose message.

    Returns
    -------
    transforms, pose : list of bytes
        Between them go sec, nsec, (``/tf``: sec, nsec again,) x, y, z, qx, qy, qz, qw.
    """
    place = [b',"y":', b',"z":', b'},"ROTATION":{"x":', b',"y":', b',"z":', b',"w":']
    rotation = [part.replace(b"ROTATION", b"rotation") for part in place]
    orientation = [part.replace(b"ROTATION", b"orientation") for part in place]
    transforms = [
        b'{"transforms":[{"timestamp":{"sec":',
        b',"nsec":',
        b'},"parent_frame_id":"world","child_frame_id":"ned","translation":{"x":0,"y":0,"z":0},'
        b'"rotation":{"x":1,"y":0,"z":0,"w":0}},{"timestamp":{"sec":',
        b',"nsec":',
        b'},"parent_frame_id":"ned","child_frame_id":"body","translation":{"x":',
        *rotation,
        b"}}]}",
    ]
    pose = [
        b'{"timestamp":{"sec":',
        b',"nsec":',
        b'},"frame_id":"ned","pose":{"position":{"x":',
        *orientation,
        b"}}}",
    ]
    return transforms, pose


def _xyz(values: ArrayLike) -> dict[str, float]:
    return dict(zip("xyz", (round(float(v), 6) for v in np.asarray(values).ravel()), strict=True))


def _rgba(colour: Sequence[float]) -> dict[str, float]:
    return dict(zip("rgba", colour, strict=True))


def _place(position: ArrayLike, yaw: float = 0.0) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}
    return {"position": _xyz(position), "orientation": turn}


def _entity_of(time_ns: int, frame: str, name: str, **primitives: list[dict[str, Any]]) -> dict[str, Any]:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": stamp(time_ns),
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        **{kind: primitives.get(kind, []) for kind in kinds},
    }


def _cylinder(position: ArrayLike, diameter: float, height: float, colour: Sequence[float]) -> dict[str, Any]:
    return {
        "pose": _place(position),
        "size": _xyz((diameter, diameter, height)),
        "bottom_scale": 1.0,
        "top_scale": 1.0,
        "color": _rgba(colour),
    }


def scene_message(
    time_ns: int,
    *,
    waypoints: Sequence[ArrayLike] = (),
    world: World | None = None,
    rotor_radius: float = 0.0875,
) -> bytes:
    """What stands still (waypoints, obstacles) and the helicopter's shape, as one ``foxglove.SceneUpdate``.

    Parameters
    ----------
    time_ns : int
        Time of the message.
    waypoints : sequence of (3,)
        N, E, D (m).
    world : World, optional
        Its boxes and cylinders are drawn.
    rotor_radius : float
        Scales the drawn helicopter (m).
    """
    r = rotor_radius
    entities = [
        _entity_of(
            time_ns,
            "body",
            "helicopter",
            cylinders=[
                _cylinder((0, 0, 0.1 * r), 0.5 * r, 1.4 * r, BODY_COLOUR),
                _cylinder((0, 0, -0.65 * r), 2 * r, 0.02 * r, ROTOR_COLOUR),
                _cylinder((0, 0, -1.0 * r), 2 * r, 0.02 * r, ROTOR_COLOUR),
            ],
            cubes=[
                {
                    "pose": _place((0.35 * r, 0, 0.5 * r)),
                    "size": _xyz((0.5 * r, 0.12 * r, 0.12 * r)),
                    "color": _rgba(WAYPOINT_COLOUR),
                }
            ],
        )
    ]
    for number, waypoint in enumerate(waypoints, 1):
        sphere = {
            "pose": _place(waypoint),
            "size": _xyz((0.1, 0.1, 0.1)),
            "color": _rgba(WAYPOINT_COLOUR),
        }
        label = {
            "pose": _place(np.subtract(waypoint, (0.0, 0.0, 0.15))),
            "billboard": True,
            "font_size": 14.0,
            "scale_invariant": True,
            "color": _rgba((0.0, 0.0, 0.0, 1.0)),
            "text": str(number),
        }
        entities.append(_entity_of(time_ns, "ned", f"waypoint {number}", spheres=[sphere], texts=[label]))
    world = world or World()
    cubes = [
        {"pose": _place(box.centre, box.yaw), "size": _xyz(box.size), "color": _rgba(OBSTACLE_COLOUR)}
        for box in world.boxes
    ]
    posts = [
        _cylinder(
            (*post.centre, -post.foot - 0.5 * post.height), 2 * post.radius, post.height, OBSTACLE_COLOUR
        )
        for post in world.cylinders
    ]
    if cubes or posts:
        entities.append(_entity_of(time_ns, "ned", "obstacles", cubes=cubes, cylinders=posts))
    return orjson.dumps({"deletions": [], "entities": entities})


def track_message(time_ns: int, track: NDArray[np.float64]) -> bytes:
    """The track flown so far as one line, ``foxglove.SceneUpdate``.

    Parameters
    ----------
    time_ns : int
        Time of the message.
    track : (n, 3) array
        N, E, D (m).
    """
    points = [dict(zip("xyz", p, strict=True)) for p in np.round(track, 4).tolist()]
    line = {
        "type": 0,
        "pose": _place((0, 0, 0)),
        "thickness": 2.0,
        "scale_invariant": True,
        "points": points,
        "color": _rgba(TRACK_COLOUR),
        "colors": [],
        "indices": [],
    }
    return orjson.dumps({"deletions": [], "entities": [_entity_of(time_ns, "ned", "track", lines=[line])]})
