"""Camera models, floor textures, and pictures rendered along a motion."""

from mufly.camera.camera_model import (
    Camera,
    body_from_camera_rotation,
    camera_matrix,
    check_picture_size,
    distortion_coefficients,
    list_builtin_cameras,
    load_camera,
    parse_camera,
    project_points,
    unproject_pixels,
)
from mufly.camera.floor_pictures import PACKAGE_FLOORS, FloorSource, copy_package_floors, find_floor
from mufly.camera.floor_texture import FLOOR_KINDS, Floor, load_floor_picture, make_random_floor
from mufly.camera.live_pictures import LivePictures, is_live_source
from mufly.camera.mjpeg_stream import (
    StreamServer,
    is_local_host,
    iterate_jpeg_parts,
    parse_address,
    parse_boundary,
)
from mufly.camera.picture_recording import (
    PICTURE_RECORDING_FILE_NAME,
    PictureRecorder,
    RecordedPictures,
    load_recording_camera,
    read_pictures,
)
from mufly.camera.renderer import Renderer, VehicleMotion, decode_grey_picture, encode_jpeg

__all__ = [
    "FLOOR_KINDS",
    "PACKAGE_FLOORS",
    "PICTURE_RECORDING_FILE_NAME",
    "Camera",
    "Floor",
    "FloorSource",
    "LivePictures",
    "PictureRecorder",
    "RecordedPictures",
    "Renderer",
    "StreamServer",
    "VehicleMotion",
    "body_from_camera_rotation",
    "camera_matrix",
    "check_picture_size",
    "copy_package_floors",
    "decode_grey_picture",
    "distortion_coefficients",
    "encode_jpeg",
    "find_floor",
    "is_live_source",
    "is_local_host",
    "iterate_jpeg_parts",
    "list_builtin_cameras",
    "load_camera",
    "load_floor_picture",
    "load_recording_camera",
    "make_random_floor",
    "parse_address",
    "parse_boundary",
    "parse_camera",
    "project_points",
    "read_pictures",
    "unproject_pixels",
]
