"""What would a camera see? A camera as its file says it, floors, and pictures rendered from a motion."""

from mufly.camera.floor import KINDS as FLOORS
from mufly.camera.floor import Floor, floor_of_picture, make_floor
from mufly.camera.live import LivePictures, is_live
from mufly.camera.model import (
    Camera,
    body_from_camera,
    builtin_cameras,
    camera_from,
    check_size,
    distortion,
    load_camera,
    matrix,
    project,
    rays,
)
from mufly.camera.recording import NAME as CAMERA_RECORDING
from mufly.camera.recording import PictureRecorder, RecordedPictures, read_pictures
from mufly.camera.render import Motion, Renderer, decode, encode
from mufly.camera.stream import StreamServer, boundary_of, is_local, parse_address, parts

__all__ = [
    "CAMERA_RECORDING",
    "FLOORS",
    "Camera",
    "Floor",
    "LivePictures",
    "Motion",
    "PictureRecorder",
    "RecordedPictures",
    "Renderer",
    "StreamServer",
    "body_from_camera",
    "boundary_of",
    "builtin_cameras",
    "camera_from",
    "check_size",
    "decode",
    "distortion",
    "encode",
    "floor_of_picture",
    "is_live",
    "is_local",
    "load_camera",
    "make_floor",
    "matrix",
    "parse_address",
    "parts",
    "project",
    "rays",
    "read_pictures",
]
