"""Model of a down-looking camera: lens, shutter, image degradation, and the radio link to the ground station.

Projection is a pinhole with the distortion of Brown (1966), in the form of OpenCV and most calibrations. The camera's
axes are x to the right of the picture, y down it, z along the axis. A point at (X, Y, Z) has x = X / Z, y = Y / Z.

With r^2 = x^2 + y^2 and the radial factor R = 1 + k1 r^2 + k2 r^4 + k3 r^6,

    x_d = x R + 2 p1 x y + p2 (r^2 + 2 x^2),    u = f_x x_d + c_x
    y_d = y R + p1 (r^2 + 2 y^2) + 2 p2 x y,    v = f_y y_d + c_y

and (u, v) = (0, 0) is the middle of the first pixel. The inverse has no closed form; Newton's method solves the two
equations. The top of the picture points to the vehicle's nose: picture x is body y, picture y is body -x, and the
axis is body z. ``mount.turn``, ``mount.pitch`` and ``mount.roll`` rotate the camera, as yaw, pitch and roll of the
vehicle (z-y-x).
"""

from __future__ import annotations

import re
import tomllib
import warnings
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from mufly.camera.calibration_files import convert_foreign_calibration
from mufly.errors import InputError
from mufly.files.input_files import builtin_file_names, make_validation_error, read_toml, validate_model
from mufly.files.text_table import decode_text
from mufly.logs import LogWarning
from mufly.rotations import body_to_ned_matrices
from mufly.vehicle.quantity import BodyPoints, ParameterGroup, Quantity, declare_parameter

_Array = NDArray[np.float64]
_BUILTIN_FOLDER = resources.files("mufly.camera") / "builtin"


class Sensor(ParameterGroup):
    """Number of pixels of the camera's pictures, and time between pictures."""

    width: int = Field(ge=32, le=8192, strict=True, description="pixels in a row")
    height: int = Field(ge=32, le=8192, strict=True, description="rows")
    period: Quantity = declare_parameter("s", "T_pic", "between pictures", at_least=0.001, at_most=10)


class Lens(ParameterGroup):
    """Pinhole parameters and distortion; lengths in pixels."""

    focal_x: Quantity = declare_parameter("1", "f_x", "focal length, in pixels", above=1, at_most=1e5)
    focal_y: Quantity = declare_parameter("1", "f_y", "focal length along a column, in pixels", above=1, at_most=1e5)
    centre_x: Quantity = declare_parameter(
        "1", "c_x", "principal point, in pixels from the middle of the first pixel", at_least=-1e4, at_most=1e5
    )
    centre_y: Quantity = declare_parameter("1", "c_y", "the same, along a column", at_least=-1e4, at_most=1e5)
    k1: Quantity = declare_parameter("1", "k1", "radial distortion", at_least=-2, at_most=2, absent=0.0)
    k2: Quantity = declare_parameter("1", "k2", "radial distortion", at_least=-5, at_most=5, absent=0.0)
    k3: Quantity = declare_parameter("1", "k3", "radial distortion", at_least=-10, at_most=10, absent=0.0)
    p1: Quantity = declare_parameter("1", "p1", "tangential distortion", at_least=-0.5, at_most=0.5, absent=0.0)
    p2: Quantity = declare_parameter("1", "p2", "tangential distortion", at_least=-0.5, at_most=0.5, absent=0.0)


class Mount(ParameterGroup):
    """Position and rotation of the camera on the vehicle; without pitch and roll the camera looks along body z."""

    place: BodyPoints = declare_parameter("m", "r_cam", "one point, in body axes", at_least=-10, at_most=10)
    turn: Quantity = declare_parameter(
        "rad",
        "psi_cam",
        "turn of the picture's top from the nose, towards body y",
        at_least=-3.2,
        at_most=3.2,
        absent=0.0,
    )
    pitch: Quantity = declare_parameter(
        "rad", "theta_cam", "turn of the mount about body y, nose up", at_least=-0.8, at_most=0.8, absent=0.0
    )
    roll: Quantity = declare_parameter(
        "rad", "phi_cam", "turn of the mount about body x, right side down", at_least=-0.8, at_most=0.8, absent=0.0
    )

    @model_validator(mode="after")
    def _check_single_position(self) -> Mount:
        if len(self.place.value) != 1:
            raise make_validation_error(
                f"has {len(self.place.value)} points", "give one point, [[x, y, z]]", "mount.place"
            )
        return self


class ShutterTiming(ParameterGroup):
    exposure: Quantity = declare_parameter("s", "T_exp", "of each row", at_least=0, at_most=1)
    readout: Quantity = declare_parameter(
        "s", "T_roll", "readout time from the first row to the last; 0: global shutter", at_least=0, at_most=1
    )
    delay: Quantity = declare_parameter(
        "s", "T_stamp", "delay of a data set's time stamps behind the exposure", at_least=-1, at_most=1, absent=0.0
    )


class ImageQuality(ParameterGroup):
    """Degradation of the picture by lens, vibration, light and noise."""

    blur: Quantity = declare_parameter(
        "1", "s_b", "radius of the lens's spot, in pixels, one sigma", at_least=0, at_most=20
    )
    noise: Quantity = declare_parameter(
        "1", "n_g", "noise of a pixel, in grey levels of 255, one sigma", at_least=0, at_most=100
    )
    shaking: Quantity = declare_parameter(
        "1",
        "a_s",
        "amplitude of the picture's vibration at the hover speed of the rotors, in pixels",
        at_least=0,
        at_most=100,
    )
    vignette: Quantity = declare_parameter("1", "e_v", "share of light missing in the corners", at_least=0, at_most=1)
    jpeg: int = Field(ge=0, le=100, strict=True, description="quality of the JPEG; 0: no compression")
    strips_lost: Quantity = declare_parameter(
        "1", "p_s", "share of strips of 16 rows lost on the radio link", at_least=0, at_most=1, absent=0.0
    )


class RadioLink(ParameterGroup):
    """Radio link that carries pictures down to the ground station and position fixes up to the vehicle."""

    latency: Quantity = declare_parameter("s", "L_r", "both ways, without processing time", at_least=0, at_most=10)
    jitter: Quantity = declare_parameter("s", "j_r", "of it, one sigma", at_least=0, at_most=10)
    loss: Quantity = declare_parameter("1", "p_r", "share of pictures lost on the radio link", at_least=0, at_most=1)


class Camera(ParameterGroup):
    """Model of a camera, as its file states it: sensor, lens, mounting, image quality and radio link."""

    name: str = Field(min_length=1, description="what it is called")
    description: str = Field(default="", description="one line")
    sensor: Sensor
    lens: Lens
    mount: Mount
    shutter: ShutterTiming
    quality: ImageQuality
    radio: RadioLink

    @model_validator(mode="after")
    def _check_consistency(self) -> Camera:
        if float(self.shutter.exposure) > float(self.sensor.period):
            raise make_validation_error(
                f"{float(self.shutter.exposure):g} s is longer than the period between pictures",
                "give a shorter exposure",
                "shutter.exposure",
            )
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
        corners *= [self.sensor.width - 1, self.sensor.height - 1]
        back = project_points(self, unproject_pixels(self, corners))
        if not np.abs(back - corners).max() < 0.01:
            raise make_validation_error(
                "makes the projection ambiguous inside the picture",
                "give the coefficients of a calibration",
                "lens.k1",
            )
        return self


def list_builtin_cameras() -> list[str]:
    """Return the names of the cameras that come with mufly."""
    return builtin_file_names(_BUILTIN_FOLDER)


_MISSING_VALUES_CAMERA = "webcam"
"""Built-in camera that supplies the values another program's calibration lacks."""


def load_camera(name_or_path: str | Path) -> Camera:
    """Read a camera by built-in name or from a file: a camera file (TOML) or another program's calibration.

    A calibration (Kalibr, ROS camera_info, OpenCV, EuRoC, ORB-SLAM, VINS, COLMAP) gives lens and size. A
    :class:`mufly.logs.LogWarning` names the source of the other values.

    Raises
    ------
    InputError
        If there is no such file, or its content is invalid.
    """
    path = Path(name_or_path)
    if str(name_or_path) not in list_builtin_cameras() and path.suffix.lower() != ".toml" and path.is_file():
        text = decode_text(path.read_bytes())
        if not _is_camera_toml(text):
            rest, _ = read_toml(_MISSING_VALUES_CAMERA, _BUILTIN_FOLDER, "camera")
            tables, whose = convert_foreign_calibration(text, str(path), rest)
            note = (
                f"is {whose}: lens and size are read; mount, shutter, radio and all else are those of "
                f"{_MISSING_VALUES_CAMERA}"
            )
            warnings.warn(f"{path.name}: {note}; camera_toml writes a file to change", LogWarning, stacklevel=2)
            return validate_model(Camera, tables, str(path))
    tables, where = read_toml(name_or_path, _BUILTIN_FOLDER, "camera")
    return validate_model(Camera, tables, where)


def _is_camera_toml(text: str) -> bool:
    """Return whether a text is a camera file of mufly, even an invalid one."""
    if re.search(r"^\s*\[(sensor|lens|mount)\]", text, re.MULTILINE):
        return True
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True


def parse_camera(text: str, where: str) -> Camera:
    """Read a camera from the text of its file; ``where`` names the file in errors.

    Raises
    ------
    InputError
        If the text is no valid camera file.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, "", f"is not valid TOML ({error})", "give --camera") from error
    return validate_model(Camera, tables, where)


def camera_matrix(camera: Camera) -> _Array:
    """Return the camera matrix (3, 3), in pixels."""
    lens = camera.lens
    return np.array(
        [
            [float(lens.focal_x), 0.0, float(lens.centre_x)],
            [0.0, float(lens.focal_y), float(lens.centre_y)],
            [0.0, 0.0, 1.0],
        ]
    )


def distortion_coefficients(camera: Camera) -> _Array:
    """Return k1, k2, p1, p2, k3, in OpenCV's order."""
    lens = camera.lens
    return np.array([float(k) for k in (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3)])


def body_from_camera_rotation(camera: Camera) -> _Array:
    """Return the rotation matrix (3, 3) from the camera's to the body's axes."""
    mount = camera.mount
    turn: _Array = body_to_ned_matrices(np.array([float(mount.roll), float(mount.pitch), float(mount.turn)]))
    return turn @ BODY_FROM_DOWN_CAMERA


BODY_FROM_DOWN_CAMERA = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation matrix from the camera's to the body's axes for a mount without turn, pitch and roll."""


def _distort_rays(k: _Array, x: _Array, y: _Array) -> tuple[_Array, _Array]:
    k1, k2, p1, p2, k3 = k
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def project_points(camera: Camera, points: ArrayLike) -> _Array:
    """Return pixels (..., 2) of points (..., 3) in the camera's axes or of rays x, y (..., 2) with z = 1."""
    p = np.asarray(points, dtype=np.float64)
    x, y = (p[..., 0] / p[..., 2], p[..., 1] / p[..., 2]) if p.shape[-1] == 3 else (p[..., 0], p[..., 1])
    x, y = _distort_rays(distortion_coefficients(camera), x, y)
    m = camera_matrix(camera)
    return np.stack([m[0, 0] * x + m[0, 2], m[1, 1] * y + m[1, 2]], axis=-1)


def unproject_pixels(camera: Camera, pixels: ArrayLike) -> _Array:
    """Return x, y (..., 2) of the undistorted rays with z = 1 through pixels (..., 2), accurate to 1e-10."""
    p = np.asarray(pixels, dtype=np.float64)
    m, k = camera_matrix(camera), distortion_coefficients(camera)
    k1, k2, p1, p2, k3 = k
    wanted_x, wanted_y = (p[..., 0] - m[0, 2]) / m[0, 0], (p[..., 1] - m[1, 2]) / m[1, 1]
    x, y = wanted_x.copy(), wanted_y.copy()
    for _ in range(20 if k.any() else 0):
        at_x, at_y = _distort_rays(k, x, y)
        off_x, off_y = at_x - wanted_x, at_y - wanted_y
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * k1 + r2 * (4 * k2 + 6 * k3 * r2)  # d radial / d r, over r
        xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
        xy = slope * x * y + 2 * p1 * x + 2 * p2 * y
        yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
        with np.errstate(all="ignore"):
            det = xx * yy - xy * xy
            x = x - (yy * off_x - xy * off_y) / det
            y = y - (xx * off_y - xy * off_x) / det
        if not max(np.abs(off_x).max(), np.abs(off_y).max()) > 1e-11:
            break
    return np.stack([x, y], axis=-1)


def check_picture_size(camera: Camera, shape: tuple[int, ...], where: str) -> None:
    """Raise InputError if a picture (rows, columns) does not have the camera's size."""
    wanted = (camera.sensor.height, camera.sensor.width)
    if tuple(shape[:2]) != wanted:
        raise InputError(
            where, "", f"is {shape[1]} by {shape[0]} pixels, the camera file states {wanted[1]} by {wanted[0]}",
            "give the camera file of these pictures",
        )  # fmt: skip
