"""Readers of pictures with times from folders, videos and recordings, in mufly's, EuRoC's and TUM's layout.

| layout | pictures | motion | truth |
|---|---|---|---|
| mufly | `pictures.csv`, `pictures/` | `telemetry.csv` | `truth.txt` |
| euroc | `cam0/data.csv`, `cam0/data/` | `imu0/data.csv` | `state_groundtruth_estimate0/data.csv` |
| tum | `rgb.txt`, `rgb/` | `accelerometer.txt` | `groundtruth.txt` |
| plain | pictures whose names are times (s or ns) | | |
| recording | ``camera.mcap`` of a flight, or a similar MCAP | data of each picture, or state | ``flight.mcap`` |
| video | a file that OpenCV reads; times in a file beside it, or by its rate | a given recording | |

In EuRoC's and TUM's files axes are x forward, y left, z up; the world's z is up. With inertial data alone, a
complementary filter estimates the tilt (Mahony, Hamel and Pflimlin 2008, without the bias): gyroscopes, corrected to
the direction of the specific force within 2 s. With accelerometers alone, the tilt is that of their mean over half a
second. Height comes from `sonar.csv` (time, distance), if present, or is a number that the user gives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.camera import (
    PICTURE_RECORDING_FILE_NAME,
    Camera,
    LivePictures,
    check_picture_size,
    decode_grey_picture,
    read_pictures,
)
from mufly.errors import InputError
from mufly.files.text_table import read_text_table
from mufly.logs import read_log, read_recording
from mufly.slam.camera_frame import CameraFrame, FrameEstimate
from mufly.slam.image_tools import import_opencv
from mufly.slam.trajectory_evaluation import read_truth_trajectory

_Array = NDArray[np.float64]
DatasetLayout = Literal["mufly", "euroc", "tum", "plain"]
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm")
VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".mjpg", ".mjpeg")
_COMPLEMENTARY_TIME_S, _FORCE_MEAN_WINDOW_S = 2.0, 0.5
_UNKNOWN_TILT_SIGMA_RAD = math.radians(3.0)  # assumed for a vehicle without attitude data
_MAX_TELEMETRY_EXTRAPOLATION_S = 0.1
MAX_PICTURE_INTERVAL_S = 1.0
"""Longest time between pictures that odometry bridges (s)."""
STILL_PICTURE_REMEDY = "give a video or a faster sequence; still pictures need photogrammetry (COLMAP)"
_DEFAULT_PLACE_SIGMA_M, _DEFAULT_HEADING_SIGMA_RAD = 0.1, math.radians(2.0)  # of a recording that states none
_FLU_TO_FRD = np.array([1.0, -1.0, -1.0])  # x forward, y left, z up to body axes, and back


@dataclass(frozen=True)
class FrameSource:
    """Source of pictures with vehicle data and truth.

    Attributes
    ----------
    name : str
    frame_count : int
        Number of pictures.
    truth : tuple of (n,), (n, 3), (n,) arrays, or None
        Times (s), positions N-E-D (m), headings (rad).
    interval_s : float
        Median time between pictures of a folder (s); NaN for other sources.
    """

    name: str
    frame_count: int
    truth: tuple[_Array, _Array, _Array] | None
    _open_frames: Any
    interval_s: float = math.nan

    def check_picture_interval(self) -> None:
        """Raise InputError if the pictures are too far apart in time to be tracked, as those of a survey drone."""
        if self.interval_s > MAX_PICTURE_INTERVAL_S:
            raise InputError(
                self.name,
                "",
                f"the pictures are {self.interval_s:.2g} s apart, more than {MAX_PICTURE_INTERVAL_S:g} s",
                STILL_PICTURE_REMEDY,
            )  # fmt: skip

    def read_frames(self) -> Iterator[CameraFrame]:
        """Yield the pictures in order of time, read on demand.

        Raises
        ------
        InputError
            If a picture cannot be read or has another size.
        """
        yield from self._open_frames()


def open_picture_source(
    place: str | Path, camera: Camera, *, height_m: float | None = None, rate_Hz: float | None = None,
    times: Path | None = None, told: Callable[[_Array], list[FrameEstimate]] | None = None,
) -> FrameSource:  # fmt: skip
    """Open a folder, a video or a recording.

    Parameters
    ----------
    place : str or Path
        A folder in one of the layouts, a video file, or a recording with pictures (MCAP), or the recording's
        folder.
    camera : Camera
        Camera that took the pictures.
    height_m : float, optional
        Height of the vehicle above the floor (m), if the files lack it.
    rate_Hz : float, optional
        Rate of a video whose file lacks it (Hz).
    times : Path, optional
        For a video: a file with the time (s or ns) of each picture, one a row. The default is the file of the
        video's name that ends in ``.csv`` or ``.txt``, if present.
    told : callable, optional
        Vehicle's data at times (n,), in place of the files beside the pictures; :func:`read_telemetry_interpolator`.

    Raises
    ------
    InputError
        If there are no pictures, times do not increase, or the height is unknown.
    """
    where = Path(place)
    if where.is_dir() and (where / PICTURE_RECORDING_FILE_NAME).is_file():
        where = where / PICTURE_RECORDING_FILE_NAME
    if where.is_file():
        if where.suffix.lower() == ".mcap":
            return _open_recording(where, camera, told)
        if where.suffix.lower() not in VIDEO_SUFFIXES:
            raise InputError(
                str(where),
                "",
                "is not a video",
                f"give a folder of pictures, a recording (.mcap), or one of {', '.join(VIDEO_SUFFIXES)}",
            )
        return _open_video(
            where, camera, rate_Hz, times, told or make_estimate_function_from_height(height_m, str(where))
        )
    if not where.is_dir():
        raise InputError(str(where), "", "no such folder or video", "give one with pictures")
    layout = detect_dataset_layout(where)
    names, at, files = _list_pictures(where, layout)
    at = at - float(camera.shutter.delay)
    tellings = _read_frame_estimates(where, layout, at, height_m) if told is None else told(at)

    def generate_frames() -> Iterator[CameraFrame]:
        for file, t, one in zip(files, at, tellings, strict=True):
            yield CameraFrame(float(t), read_picture(file, camera), one)

    interval_s = float(np.median(np.diff(at))) if len(at) > 1 else math.nan
    return FrameSource(
        f"{where.name} ({layout})", len(names), read_truth_trajectory(where), generate_frames, interval_s
    )


def open_live_pictures(live: LivePictures, told: Callable[[_Array], Sequence[FrameEstimate | None]]) -> FrameSource:
    """Return live pictures as a source with an unknown number of frames.

    Parameters
    ----------
    live : LivePictures
    told : callable
        Returns the vehicle's data for times (n,), as :func:`make_estimate_function_from_height` or
        :func:`read_telemetry_interpolator` give it. Pictures with None are skipped.
    """

    def generate_frames() -> Iterator[CameraFrame]:
        for t, picture in live.iterate_pictures():
            if (one := told(np.array([t]))[0]) is not None:
                yield CameraFrame(t, picture, one)

    return FrameSource(live.name, 0, None, generate_frames)


def make_estimate_function_from_height(height_m: float | None, where: str) -> Callable[[_Array], list[FrameEstimate]]:
    """Return a function that gives vehicle data from the height alone: level with a deviation of 3 degrees.

    Raises
    ------
    InputError
        If the height is missing or out of range.
    """
    if height_m is None:
        raise InputError(where, "", "does not state the height above the floor", "give --height or --telemetry")
    if not 0.02 <= height_m <= 1000.0:
        raise InputError("--height", "", f"{height_m:g} m is out of range", "give the height above the floor in metres")
    return lambda times: [
        FrameEstimate(0.0, 0.0, height_m, tilt_sigma=_UNKNOWN_TILT_SIGMA_RAD, height_sigma=0.02) for _ in times
    ]


def detect_dataset_layout(folder: Path) -> DatasetLayout:
    """Return the layout of a folder of pictures: mufly, EuRoC, TUM or pictures named by time."""
    if (folder / "pictures.csv").is_file():
        return "mufly"
    if (folder / "mav0").is_dir() or (folder / "cam0").is_dir():
        return "euroc"
    return "tum" if (folder / "rgb.txt").is_file() else "plain"


def read_picture(file: Path, camera: Camera) -> NDArray[np.uint8]:
    """Read a picture file in grey levels, and check its size against the camera.

    Raises
    ------
    InputError
        If the file is missing, damaged, or of another size.
    """
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError(
            str(file), "", f"cannot be read ({error.strerror})", "give an unchanged copy of the folder"
        ) from error
    return _decode_picture(data, camera, str(file))


def _decode_picture(data: bytes, camera: Camera, where: str) -> NDArray[np.uint8]:
    try:
        picture = decode_grey_picture(data)
    except ValueError as error:
        raise InputError(where, "", f"is damaged: {error}", "take it out of the list, or give another copy") from error
    check_picture_size(camera, picture.shape, where)
    return picture


def _find_euroc_folder(folder: Path) -> Path:
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def _list_pictures(folder: Path, layout: DatasetLayout) -> tuple[list[str], _Array, list[Path]]:
    if layout == "plain":
        found = sorted(p for p in folder.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES)
        try:
            pairs = sorted((float(p.stem), p.name) for p in found)
        except ValueError:
            bad = next(p.name for p in found if not _parses_as_number(p.stem))
            raise InputError(
                str(folder),
                bad,
                "is not a time",
                "name pictures by their times (s or ns), or add pictures.csv (time, file)",
            ) from None
        base, names, where = folder, [n for _, n in pairs], str(folder)
        times = np.array([t for t, _ in pairs])
    else:
        file, base = {
            "mufly": (folder / "pictures.csv", folder / "pictures"),
            "euroc": (_find_euroc_folder(folder) / "cam0" / "data.csv", _find_euroc_folder(folder) / "cam0" / "data"),
            "tum": (folder / "rgb.txt", folder),
        }[layout]
        where, table = str(file), read_text_table(file)
        if len(table.header) < 2:
            raise InputError(where, "", "has rows without time and file", "write a time and a file name in each row")
        times, names = table.read_numbers(0), table.read_texts(1)
    if not names:
        raise InputError(where, "", "contains no pictures", f"give a folder with {', '.join(PICTURE_SUFFIXES)}")
    if times[0] > 1e12:
        times = times * 1e-9  # nanoseconds
    _check_rising_times(times, names, where)
    return names, times, [base / n for n in names]


def _check_rising_times(times: _Array, names: list[str], where: str) -> None:
    back = np.nonzero(np.diff(times) <= 0.0)[0]
    if len(back):
        k = int(back[0]) + 1
        raise InputError(
            where, names[k], f"its time, {times[k]:.6f} s, is not after {times[k - 1]:.6f} s of the picture before",
            "sort the pictures, or correct their times",
        )  # fmt: skip


def _parses_as_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _read_frame_estimates(
    folder: Path, layout: DatasetLayout, times: _Array, height_m: float | None
) -> list[FrameEstimate]:
    """Return the vehicle's data at the times of the pictures."""
    if (folder / "telemetry.csv").is_file():
        return _read_telemetry_estimates(folder / "telemetry.csv", times)
    heights = _read_heights(folder, times, height_m)
    imu, accelerometer = find_inertial_file(folder, layout), folder / "accelerometer.txt"
    if imu is not None:
        t, rates, force = read_inertial_data(imu)
        roll, pitch = complementary_filter(t, rates, force)
        sigma = math.radians(1.0)
        turning = np.stack([np.interp(times, t, c) for c in rates.T], axis=1)
    elif layout == "tum" and accelerometer.is_file():
        rows = read_text_table(accelerometer).read_matrix(4)
        t, force = rows[:, 0], rows[:, 1:] * _FLU_TO_FRD
        n = max(1, round(_FORCE_MEAN_WINDOW_S / max(float(np.median(np.diff(t))), 1e-4)))
        pad, mean = (n // 2, n - 1 - n // 2), np.ones(n) / n
        force = np.stack([np.convolve(np.pad(c, pad, mode="edge"), mean, "valid") for c in force.T], axis=1)
        roll = np.arctan2(-force[:, 1], -force[:, 2])
        pitch = np.arctan2(force[:, 0], np.hypot(force[:, 1], force[:, 2]))
        sigma, turning = math.radians(2.0), np.zeros((len(times), 3))
    else:
        t, roll, pitch = times[:1], np.zeros(1), np.zeros(1)
        sigma, turning = _UNKNOWN_TILT_SIGMA_RAD, np.zeros((len(times), 3))
    roll, pitch = np.interp(times, t, roll), np.interp(times, t, pitch)
    return [
        FrameEstimate(
            float(roll[k]),
            float(pitch[k]),
            float(heights[k]),
            turning[k],
            tilt_sigma=sigma,
            height_sigma=0.02,
        )
        for k in range(len(times))
    ]


def find_inertial_file(folder: Path, layout: DatasetLayout) -> Path | None:
    """Return the file with rates and specific force of a folder, if it has one."""
    file = _find_euroc_folder(folder) / "imu0" / "data.csv" if layout == "euroc" else folder / "imu.csv"
    return file if layout in ("euroc", "mufly") and file.is_file() else None


def read_inertial_data(file: Path) -> tuple[_Array, _Array, _Array]:
    """Return times (n,) (s), rates (n, 3) (rad/s) and specific force (n, 3) (m/s^2), body axes.

    ``data.csv`` has EuRoC's axes (x forward, y left, z up), other files those of mufly.

    Raises
    ------
    InputError
        If there are fewer than two rows or times do not rise.
    """
    rows = read_text_table(file).read_matrix(7)
    if len(rows) < 2 or (np.diff(rows[:, 0]) <= 0.0).any():
        raise InputError(str(file), "time", "does not increase", "write two rows or more, sorted by time")
    t = rows[:, 0] * (1e-9 if rows[0, 0] > 1e12 else 1.0)
    axes = _FLU_TO_FRD if file.name == "data.csv" else np.ones(3)
    rates, force = (part * axes for part in np.split(rows[:, 1:], 2, axis=1))
    return t, rates, force


def complementary_filter(t: _Array, rates: _Array, force: _Array) -> tuple[_Array, _Array]:
    """Return roll and pitch (n,) from gyroscopes, corrected by the direction of the specific force.

    ``rates`` and ``force`` are (n, 3), in body axes.
    """
    down = -force[0] / np.linalg.norm(force[0])
    out = np.empty_like(rates)
    for k in range(len(t)):
        dt = min(max(t[k] - t[k - 1], 0.0), 0.1) if k else 0.0
        down = down - np.cross(rates[k], down) * dt
        f = -force[k] / max(float(np.linalg.norm(force[k])), 1e-9)
        down = down + (dt / _COMPLEMENTARY_TIME_S) * (f - down)
        down = down / np.linalg.norm(down)
        out[k] = down
    return np.arctan2(out[:, 1], out[:, 2]), -np.arcsin(np.clip(out[:, 0], -1.0, 1.0))


def _read_heights(folder: Path, times: _Array, height_m: float | None) -> _Array:
    file = folder / "sonar.csv"
    if height_m is not None or not file.is_file():
        return np.array([t.height_m for t in make_estimate_function_from_height(height_m, str(folder))(times)])
    a = read_text_table(file).read_matrix(2)
    if not len(a):
        raise InputError(str(file), "", "has no rows of two numbers", "write time and distance (s, m)")
    if len(times) and (times[-1] < a[0, 0] or times[0] > a[-1, 0]):
        raise InputError(
            str(file), "time_s",
            f"goes from {a[0, 0]:.9g} to {a[-1, 0]:.9g} s, but the pictures begin at {times[0]:.9g} s",
            "use the clock of the pictures (s), or omit this file and give --height",
        )  # fmt: skip
    return np.interp(times, a[:, 0], a[:, 1])


TELEMETRY_COLUMNS = (
    "time_s", "roll_rad", "pitch_rad", "height_m", "p_rad_s", "q_rad_s", "r_rad_s", "rotor_upper_rad_s",
    "rotor_lower_rad_s", "tilt_sigma_rad", "height_sigma_m",
)  # fmt: skip
_ROLL_COLUMN, _PITCH_COLUMN, _HEIGHT_COLUMN, _TILT_SIGMA_COLUMN, _HEIGHT_SIGMA_COLUMN = (
    1,
    2,
    3,
    9,
    10,
)  # columns of telemetry
_RATE_COLUMNS, _ROTOR_SPEED_COLUMNS, _ROTOR_PHASE_COLUMNS = slice(4, 7), slice(7, 9), slice(11, 13)
_MOTION_VELOCITY_COLUMNS, _MOTION_VELOCITY_SIGMA_COLUMN, _MOTION_PLACE_COLUMNS = (
    slice(0, 3),
    3,
    slice(4, 7),
)  # columns of a motion
_MOTION_HEADING_COLUMN, _MOTION_PLACE_SIGMA_COLUMN, _MOTION_HEADING_SIGMA_COLUMN = 6, 7, 8
ROTOR_PHASE_COLUMNS = ("rotor_upper_rad", "rotor_lower_rad")
"""Optional columns of the telemetry; phases are continuous."""


def read_telemetry_interpolator(file: Path, offset_s: float = 0.0) -> Callable[[_Array], list[FrameEstimate]]:
    """Return the vehicle's data as a function of picture times (n,), from a ``telemetry.csv`` or a recording.

    Parameters
    ----------
    file : Path
        A ``telemetry.csv``, or a recording (:func:`mufly.logs.read_log`) with estimated, measured or true attitude and
        position. Its velocity and heading are used if it has them.
    offset_s : float
        Clock of the file minus clock of the pictures (s).

    Raises
    ------
    InputError
        If attitude or position is missing, or a picture's time is outside the data.
    """
    if file.suffix.lower() == ".csv" and read_text_table(file, short_rows="drop").header[: len(TELEMETRY_COLUMNS)] == [
        *TELEMETRY_COLUMNS
    ]:
        return lambda times: _read_telemetry_estimates(file, times + offset_s)
    a, motion = _telemetry_from_recording(file)

    def estimates_at(times: _Array) -> list[FrameEstimate]:
        t = times + offset_s
        if t[0] < a[0, 0] - _MAX_TELEMETRY_EXTRAPOLATION_S or t[-1] > a[-1, 0] + _MAX_TELEMETRY_EXTRAPOLATION_S:
            raise InputError(
                str(file), "",
                f"covers {a[0, 0]:.3f} to {a[-1, 0]:.3f} s, but the pictures {t[0]:.3f} to {t[-1]:.3f} s",
                "give --offset: clock of the recording minus clock of the pictures",
            )  # fmt: skip
        b = np.stack([np.interp(t, a[:, 0], c) for c in a.T], axis=1)
        infos = [_make_frame_estimate(r) for r in b]
        if motion is None:
            return infos
        c = np.stack([np.interp(t, a[:, 0], column) for column in motion.T], axis=1)
        return [
            replace(
                one,
                velocity=m[_MOTION_VELOCITY_COLUMNS],
                velocity_sigma=m[_MOTION_VELOCITY_SIGMA_COLUMN],
                place=m[_MOTION_PLACE_COLUMNS],
                place_sigma=(m[_MOTION_PLACE_SIGMA_COLUMN], m[_MOTION_HEADING_SIGMA_COLUMN]),
            )
            for one, m in zip(infos, c, strict=True)
        ]

    return estimates_at


def _telemetry_from_recording(file: Path) -> tuple[_Array, _Array | None]:
    """Return a recording's :data:`TELEMETRY_COLUMNS` (n, 11), and its velocity and position with deviations (n, 9).

    The motion is velocity N, E, D (m/s) and its deviation, N, E (m), heading (rad), and the deviations of both; None
    where the recording has no velocity or no heading.
    """
    ds = read_log(file)

    def first_recorded_signal(what: str, *whose: str) -> _Array | None:
        there = (ds[f"{who}_{what}"].values.astype(np.float64) for who in whose if f"{who}_{what}" in ds)
        return next((values for values in there if np.isfinite(values).any()), None)

    who = ("estimated", "measured", "truth")
    attitude, position = first_recorded_signal("attitude", *who), first_recorded_signal("position", *who)
    if attitude is None or position is None:
        what = "attitude" if attitude is None else "position"
        raise InputError(str(file), what, "is missing", "give a recording with it, or leave out --telemetry")
    n = len(attitude)
    rates, rotors = first_recorded_signal("rates", *who), first_recorded_signal("rotor_speed", "measured", "truth")
    tilt, height = (
        first_recorded_signal("attitude_sigma", "estimated"),
        first_recorded_signal("position_sigma", "estimated"),
    )
    rows = np.column_stack([
        ds["time"].values, attitude[:, :2], np.maximum(0.02, -position[:, 2]),
        np.zeros((n, 3)) if rates is None else rates, np.zeros((n, 2)) if rotors is None else rotors,
        np.full(n, math.radians(0.5)) if tilt is None else np.maximum(math.radians(0.15), tilt[:, :2].max(axis=1)),
        np.full(n, 0.02) if height is None else np.maximum(0.006, height[:, 2]),
    ])  # fmt: skip
    # Rotor speeds are sampled more slowly; where they are unknown, vibration is averaged, not modelled.
    for k in range(1, rows.shape[1]):
        good = np.isfinite(rows[:, k])
        rows[:, k] = np.interp(rows[:, 0], rows[good, 0], rows[good, k]) if good.any() else 0.0
    velocity, known = (
        first_recorded_signal("velocity", *who),
        np.isfinite(attitude[:, 2]) & np.isfinite(position).all(axis=1),
    )
    if velocity is None or not known.any():
        return rows, None
    known &= np.isfinite(velocity).all(axis=1)
    speed = first_recorded_signal("velocity_sigma", "estimated")
    motion = np.column_stack([
        velocity, np.full(n, 0.05) if speed is None else np.maximum(0.01, speed[:, :2].max(axis=1)), position[:, :2],
        np.zeros(n),
        np.full(n, _DEFAULT_PLACE_SIGMA_M) if height is None else np.maximum(0.01, height[:, :2].max(axis=1)),
        np.full(n, _DEFAULT_HEADING_SIGMA_RAD) if tilt is None else np.maximum(0.005, tilt[:, 2]),
    ])  # fmt: skip
    motion[known, _MOTION_HEADING_COLUMN] = np.unwrap(attitude[known, 2])
    time = rows[:, 0]
    return rows, np.stack([np.interp(time, time[known], c[known]) for c in motion.T], axis=1)


def _open_recording(path: Path, camera: Camera, told: Callable[[_Array], list[FrameEstimate]] | None) -> FrameSource:
    """Open the pictures of a recorded flight.

    The vehicle's data are those of ``told``, else those stored with the pictures, else the recorded state.
    """
    kept = read_pictures(path)
    times = np.array(kept.times_s)
    _check_rising_times(times, [f"picture {k + 1}" for k in range(len(times))], str(kept.path))
    if told is None and kept.frame_infos:
        try:
            tellings = [FrameEstimate.from_mapping(one) for one in kept.frame_infos]
        except (TypeError, ValueError) as error:
            raise InputError(str(kept.path), "/camera/told", f"is damaged ({error})", "give --telemetry") from None
    else:
        tellings = (told or read_telemetry_interpolator(path))(times)
    flight, truth = kept.path.with_name("flight.mcap"), None
    if flight.is_file():
        ds = read_recording(flight)
        truth = ds["time"].values, ds["truth_position"].values, ds["truth_attitude"].values[:, 2]

    def generate_frames() -> Iterator[CameraFrame]:
        for t, jpeg, one in zip(times, kept.iterate_jpegs(), tellings, strict=True):
            yield CameraFrame(float(t), _decode_picture(jpeg, camera, f"{kept.path}: picture at {t:.3f} s"), one)

    return FrameSource(f"{kept.path.name} (recording)", len(times), truth, generate_frames)


def _read_telemetry_estimates(file: Path, times: _Array) -> list[FrameEstimate]:
    table = read_text_table(file)
    phased = table.header == [*TELEMETRY_COLUMNS, *ROTOR_PHASE_COLUMNS]
    if not phased and table.header != [*TELEMETRY_COLUMNS]:
        raise InputError(str(file), "", "has an unexpected first row", f"write {', '.join(TELEMETRY_COLUMNS)}")
    a = table.read_matrix()
    if not len(a) or (np.diff(a[:, 0]) <= 0).any():
        raise InputError(str(file), "time_s", "does not increase", "sort it by time")
    b = np.stack([np.interp(times, a[:, 0], c) for c in a.T], axis=1)
    return [_make_frame_estimate(r, r[_ROTOR_PHASE_COLUMNS].copy() if phased else None) for r in b]


def _make_frame_estimate(row: _Array, rotor_phase: _Array | None = None) -> FrameEstimate:
    """Return the vehicle's estimate from one ``row`` with the columns :data:`TELEMETRY_COLUMNS`."""
    return FrameEstimate(
        float(row[_ROLL_COLUMN]),
        float(row[_PITCH_COLUMN]),
        float(row[_HEIGHT_COLUMN]),
        row[_RATE_COLUMNS].copy(),
        row[_ROTOR_SPEED_COLUMNS].copy(),
        rotor_phase,
        float(row[_TILT_SIGMA_COLUMN]),
        float(row[_HEIGHT_SIGMA_COLUMN]),
    )


def _open_video(
    file: Path, camera: Camera, rate_Hz: float | None, times: Path | None,
    told: Callable[[_Array], list[FrameEstimate]],
) -> FrameSource:  # fmt: skip
    cv2 = import_opencv()
    video = cv2.VideoCapture(str(file))
    if not video.isOpened():
        raise InputError(
            str(file), "", "cannot be opened as a video", "give a file that OpenCV reads (MJPEG in AVI, MP4)"
        )
    count, rate = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), rate_Hz or float(video.get(cv2.CAP_PROP_FPS))
    video.release()
    names = (times, file.with_suffix(".csv"), file.with_suffix(".txt"))
    beside = next((f for f in names if f is not None and (f is times or f.is_file())), None)
    listed = None if beside is None else _read_video_times(beside)
    if listed is None and not 0.1 <= rate <= 1000.0:
        raise InputError(
            str(file), "", f"states an implausible rate of {rate:g} pictures per second", "give --rate or --times"
        )
    if listed is not None and count > 0 and len(listed) != count:
        raise InputError(
            str(beside),
            "",
            f"has {len(listed)} times, but the video has {count} pictures",
            "give one time for each picture",
        )
    clock = np.arange(max(count, 1)) / rate if listed is None else listed
    tellings = told(clock)

    def generate_frames() -> Iterator[CameraFrame]:
        again = cv2.VideoCapture(str(file))
        for k in range(len(clock) if count > 0 or listed is not None else 10**9):
            there, picture = again.read()
            if not there:
                if k < count:
                    raise InputError(
                        str(file),
                        f"picture {k + 1}",
                        f"cannot be read, although the video states {count} pictures",
                        "give another copy",
                    )
                return
            grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
            check_picture_size(camera, grey.shape, str(file))
            known = k < len(clock)
            t = float(clock[k]) if known else k / rate
            yield CameraFrame(t, grey, tellings[k] if known else told(np.array([t]))[0])

    return FrameSource(file.name, max(count, 0), None, generate_frames)


def _read_video_times(file: Path) -> _Array:
    """Return times (s) of a video's pictures, one a row; further columns and a header row are ignored."""
    times = read_text_table(file).read_numbers(0)
    if not len(times):
        raise InputError(str(file), "", "contains no times", "write a time (s or ns) in each row")
    times = times * 1e-9 if times[0] > 1e12 else times
    _check_rising_times(times, [f"row {k + 1}" for k in range(len(times))], str(file))
    return times
