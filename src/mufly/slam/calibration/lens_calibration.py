"""Calibration of a camera's lens from pictures of a chessboard (Zhang 2000, by OpenCV), with standard deviations.

The result is a camera file: the calibrated lens, and all other values of the initial file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import field
from pathlib import Path

import numpy as np

from mufly.camera import Camera
from mufly.errors import ArgumentError, InputError
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.slam.datasets.dataset_readers import PICTURE_SUFFIXES, read_picture
from mufly.slam.image_tools import import_opencv
from mufly.vehicle.quantity import Quantity

MIN_BOARD_PICTURES = 5
"""Least number of pictures that show the board."""
_LENS_PARAMETERS = ("focal_x", "focal_y", "centre_x", "centre_y", "k1", "k2", "p1", "p2", "k3")


@result(json="values deviations residual_px used")
class LensCalibration:
    """Camera with calibrated lens, and the standard deviations of its parameters."""

    values: dict[str, float] = field(metadata={"unit": "1", "meaning": "as in the table lens of a camera file"})
    deviations: dict[str, float] = field(metadata={"unit": "1", "meaning": "one sigma of each"})
    residual_px: float = field(metadata={"unit": "1", "meaning": "rms of the corners' residuals (pixels)"})
    used: int = field(metadata={"unit": "1", "meaning": "pictures with a board in them"})
    picture_count: int = field(metadata={"unit": "1", "meaning": "pictures"})
    camera: Camera = field(repr=False, metadata={"unit": "", "meaning": "the file's camera with this lens"})

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the calibration as a sentence and a table."""
        rows = [(n, f"{self.values[n]:.4g}", f"{self.deviations[n]:.2g}") for n in self.values]
        return [
            make_lines_block(
                f"{self.used} of {self.picture_count} pictures show the board; residual {self.residual_px:.2f} pixels"
            ),
            make_table_block(("", "found", "sigma"), rows),
        ]


def calibrate_lens(
    pictures: Sequence[Path], camera: Camera, *, columns: int, rows: int, square_m: float = 0.025,
    on_picture: Callable[[int, int], None] | None = None,
) -> LensCalibration:  # fmt: skip
    """Calibrate the lens of a camera from pictures of a chessboard; return the camera with the calibrated lens.

    Parameters
    ----------
    pictures : sequence of Path
    camera : Camera
        Source of all values but the lens. Its size may differ: that of the first picture is taken
        (:func:`resize_camera`).
    columns, rows : int
        Inner corners of the board.
    square_m : float
        Side of a square (m).

    Raises
    ------
    InputError
        If fewer than five pictures show the board, they differ in size, or the lens is not observable from them.
    """
    cv2 = import_opencv()
    if not (3 <= columns <= 50 and 3 <= rows <= 50 and columns != rows):
        raise ArgumentError(
            "board",
            f"{columns}x{rows}",
            "is not a board size",
            "give the numbers of inner corners, which must differ: 9x6",
        )
    if not 1e-3 <= square_m <= 1.0:
        raise ArgumentError("square", f"{square_m:g} m", "is out of range", "give 0.001 to 1 m")
    board = np.zeros((rows * columns, 3), np.float32)
    board[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2) * square_m
    camera = resize_camera(camera, *_picture_size(pictures[0]))
    found = []
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    for k, file in enumerate(pictures):
        grey = read_picture(file, camera)
        there, at = cv2.findChessboardCorners(grey, (columns, rows))
        if there:
            found.append(cv2.cornerSubPix(grey, at.astype(np.float32), (5, 5), (-1, -1), stop))
        if on_picture is not None:
            on_picture(k + 1, len(pictures))
    if len(found) < MIN_BOARD_PICTURES:
        raise InputError(
            "pictures", "", f"the board of {columns} by {rows} inner corners is in {len(found)} of {len(pictures)}",
            f"give {MIN_BOARD_PICTURES} or more that show all of it, or the right --board",
        )  # fmt: skip
    size = (camera.sensor.width, camera.sensor.height)
    residual, m, k, _, _, deviations, *_ = cv2.calibrateCameraExtended([board] * len(found), found, size, None, None)
    values = [m[0, 0], m[1, 1], m[0, 2], m[1, 2], *np.ravel(k)[:5]]
    sigma = np.ravel(deviations)[:9]
    if not all(math.isfinite(v) for v in values) or sigma[0] > 0.1 * values[0]:
        raise InputError(
            "pictures", "", "the pictures do not determine the lens: all show the board from the same direction",
            "tilt the board by 20 to 40 degrees about both axes, and fill the picture",
        )  # fmt: skip
    note = f"chessboard, {len(found)} pictures, residual {residual:.2f} pixels"
    lens = {
        name: Quantity(value=float(v), unit="1", source="measured", note=note, std=float(s))
        for name, v, s in zip(_LENS_PARAMETERS, values, sigma, strict=True)
    }
    out = camera.model_copy(update={"lens": camera.lens.model_copy(update=lens)})
    return LensCalibration(
        dict(zip(_LENS_PARAMETERS, (float(v) for v in values), strict=True)),
        dict(zip(_LENS_PARAMETERS, (float(s) for s in sigma), strict=True)),
        float(residual),
        len(found),
        len(pictures),
        out,
    )


def resize_camera(camera: Camera, width: int, height: int) -> Camera:
    """Return a camera for pictures of another size: its lens and other lengths in pixels are scaled with the width."""
    if (width, height) == (camera.sensor.width, camera.sensor.height):
        return camera
    scale = width / camera.sensor.width

    def scale_quantity(quantity: Quantity) -> Quantity:
        return quantity.model_copy(update={"value": float(quantity) * scale, "std": None, "source": "estimated"})

    lens, quality = camera.lens, camera.quality
    middle_y = 0.5 * (height - 1) + scale * (float(lens.centre_y) - 0.5 * (camera.sensor.height - 1))
    return camera.model_copy(
        update={
            "sensor": camera.sensor.model_copy(update={"width": width, "height": height}),
            "lens": lens.model_copy(
                update={
                    "focal_x": scale_quantity(lens.focal_x), "focal_y": scale_quantity(lens.focal_y),
                    "centre_x": scale_quantity(lens.centre_x),
                    "centre_y": scale_quantity(lens.centre_y).model_copy(update={"value": middle_y}),
                }
            ),
            "quality": quality.model_copy(update={
                "blur": scale_quantity(quality.blur), "shaking": scale_quantity(quality.shaking),
            }),
        }
    )  # fmt: skip


def _picture_size(file: Path) -> tuple[int, int]:
    """Return width and height of a picture file."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(file) as opened:
            return opened.size
    except (OSError, UnidentifiedImageError) as error:
        raise InputError(str(file), "", f"is damaged: {error}", "take it out of the folder") from error


def list_board_pictures(folder: Path) -> list[Path]:
    """Return the paths of the chessboard pictures in a folder.

    Raises
    ------
    InputError
        If there is no picture.
    """
    if not folder.is_dir():
        raise InputError(str(folder), "", "no such folder", "give one with pictures of a chessboard")
    out = sorted(p for p in folder.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES)
    if not out:
        raise InputError(str(folder), "", "contains no pictures", f"give a folder with {', '.join(PICTURE_SUFFIXES)}")
    return out
