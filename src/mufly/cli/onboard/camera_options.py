"""Options of an onboard camera and of the floor below it, shared by flights, campaigns and rendered data sets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from mufly.cli.options import define_option
from mufly.errors import ArgumentError, InputError

if TYPE_CHECKING:
    from mufly.flight.fixes.camera_sensor import CameraConfig
    from mufly.mission import Mission

FlightCameraOption = Annotated[
    str,
    define_option(
        "--camera NAME|FILE",
        "Camera of --position camera or --stream: mufly-2.0, webcam, worst or a camera file. Default: mufly-2.0.",
    ),
]
FloorOption = Annotated[
    str,
    define_option(
        "--floor NAME|PICTURE",
        "Floor below the camera: rich, poor, tiles, plain, a name of `mufly slam floors`, or a picture file. "
        "Default: the mission's, or rich.",
    ),
]
FloorWidthOption = Annotated[
    float | None,
    define_option(
        "--floor-width",
        "Width of the floor's picture, from west to east. Default: that of floors.toml beside it, or 2 m.",
        unit="m",
    ),
]


def make_flight_camera(
    camera: str, floor: str, floor_width: float | None, mission: Mission, mission_file: str
) -> CameraConfig:
    """Return the settings of a flight's camera, with the floor that it sees, after a check that this floor exists.

    Raises
    ------
    InputError
        If the camera, or the floor of the options or of the mission, is invalid.
    """
    from mufly.camera import find_floor, load_camera
    from mufly.flight.fixes.camera_sensor import CameraConfig, default_to_mission_floor

    lens = load_camera(camera or "mufly-2.0")
    if not floor and floor_width is not None and mission.floor is None:
        raise InputError("--floor-width", "", "there is no picture", "give --floor PICTURE, or leave it out")
    config = default_to_mission_floor(CameraConfig(lens, floor or None, floor_width), mission)
    try:
        find_floor(config.floor_name, config.floor_width_m)
    except ArgumentError as error:
        if floor:
            raise
        named = "floor.texture" if error.argument == "floor" else "floor.width_m"
        raise InputError(mission_file, named, f"{error.key}: {error.problem}", error.remedy) from error
    return config


def make_position_camera(
    position: str, sensors: str, camera: str, floor: str, floor_width: float | None, mission: Mission,
    mission_file: str, faults: Sequence[str] | None = None, stream: str = "",
) -> CameraConfig | None:  # fmt: skip
    """Return the camera that ``--position`` and the camera options request; None if they request none."""
    if position == "link" and sensors == "ideal":
        raise InputError("--position", "", "the true state needs no position fixes", "leave out --sensors ideal")
    # Behind a link an external program processes the pictures, if they are sent.
    lacking = {"fix": "needs --position camera", "camera": ""}.get(
        position, "" if stream else "pictures are sent only with --stream"
    )
    given = {
        "--camera": camera, "--floor": floor, "--floor-width": floor_width, "--camera-fault": faults,
        "--stream": stream,
    }  # fmt: skip
    for name, one in given.items():
        if one and lacking:
            raise InputError(name, "", lacking, "add that option, or leave this one out")
    if position != "camera" and not stream:
        return None
    if sensors == "ideal":
        raise InputError("--position", "", "the true state needs no camera", "leave out --sensors ideal")
    from mufly.camera import parse_address
    from mufly.flight.fixes.onboard_camera import parse_camera_fault
    from mufly.slam import import_opencv

    if position == "camera":
        import_opencv()
    return replace(
        make_flight_camera(camera, floor, floor_width, mission, mission_file),
        camera_faults=tuple(parse_camera_fault(f) for f in faults or ()),
        stream_address=parse_address(stream) if stream else None,
    )
