"""Writers of data sets and trajectories in the layouts of mufly, EuRoC and TUM.

:mod:`mufly.slam.datasets.dataset_readers` reads them.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from mufly.camera import Camera, VehicleMotion, encode_jpeg
from mufly.dynamics import GRAVITY
from mufly.rotations import quaternion_from_euler
from mufly.slam.camera_frame import CameraFrame
from mufly.slam.datasets.dataset_readers import ROTOR_PHASE_COLUMNS, TELEMETRY_COLUMNS
from mufly.slam.datasets.synthetic_datasets import VehiclePath

_Array = NDArray[np.float64]
WRITABLE_DATASET_LAYOUTS = ("mufly", "euroc", "tum")
_FLU_TO_FRD = np.array([1.0, -1.0, -1.0])
_JPEG_QUALITY = 95


def write_dataset(
    folder: Path,
    camera: Camera,
    path: VehiclePath,
    made: Iterable[tuple[CameraFrame, VehicleMotion]],
    layout: str = "mufly",
    on_picture: Callable[[int], None] = lambda k: None,
    imu: _Array | None = None,
) -> int:
    """Write a data set and return the number of its pictures.

    Parameters
    ----------
    folder : Path
    camera : Camera
    path : VehiclePath
        Source of inertial data and truth.
    made : iterable of (CameraFrame, VehicleMotion)
        Pictures of :func:`mufly.slam.datasets.synthetic_datasets.render_frames`.
    layout : str
        One of :data:`WRITABLE_DATASET_LAYOUTS`.
    on_picture : callable
        Called with the number of each picture.
    imu : (n, 7) array, optional
        Time, rates and specific force to write instead of error-free ones; the layout mufly then has no telemetry.

    Stamps of pictures are late by the camera's ``shutter.delay``.
    """
    base = {"mufly": folder / "pictures", "tum": folder / "rgb", "euroc": folder / "mav0" / "cam0" / "data"}[layout]
    base.mkdir(parents=True, exist_ok=True)
    (folder / "camera.toml").write_text(format_camera_toml(camera), encoding="utf-8")
    listed, told, sonar, last = [], [], [], -1.0
    with contextlib.suppress(GeneratorExit):
        for k, (frame, _) in enumerate(made):
            stamp = frame.time_s + float(camera.shutter.delay)
            ns = round(stamp * 1e9) + 10**18
            name = {"mufly": f"{k:06d}.jpg", "tum": f"{stamp:.6f}.jpg", "euroc": f"{ns}.jpg"}[layout]
            (base / name).write_bytes(encode_jpeg(frame.picture, _JPEG_QUALITY))
            listed.append((f"{stamp:.6f}", name, ns))
            t = frame.vehicle_estimate
            told.append(
                (
                    frame.time_s,
                    t.roll,
                    t.pitch,
                    t.height_m,
                    *t.rates,
                    *t.rotor_speed,
                    t.tilt_sigma,
                    t.height_sigma,
                    *(() if t.rotor_phase is None else t.rotor_phase),
                )
            )
            if frame.time_s > last + 0.05:
                last = frame.time_s
                at = round(frame.time_s * 1e9) + 10**18
                clock = f"{at // 10**9}.{at % 10**9 // 1000:06d}" if layout == "euroc" else f"{frame.time_s:.6f}"
                sonar.append(f"{clock},{t.height_m:.2f}")
            on_picture(k)
    rows = ideal_imu_rows(path) if imu is None else imu
    (folder / "sonar.csv").write_text("\n".join(["time_s,distance_m", *sonar]) + "\n", encoding="utf-8")
    if layout == "mufly":
        lines = ["time_s,file", *(f"{t},{name}" for t, name, _ in listed)]
        (folder / "pictures.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        if imu is None:
            phased = told and len(told[0]) > len(TELEMETRY_COLUMNS)
            _write_csv_table(
                folder / "telemetry.csv", TELEMETRY_COLUMNS + ROTOR_PHASE_COLUMNS if phased else TELEMETRY_COLUMNS, told
            )
        _write_csv_table(
            folder / "imu.csv",
            ("time_s", "p_rad_s", "q_rad_s", "r_rad_s", "ax_m_s2", "ay_m_s2", "az_m_s2"),
            rows,
        )
        write_tum_trajectory(
            folder / "truth.txt",
            path.time_s[::2],
            path.position_m[::2],
            path.attitude_rad[::2],
            "N-E-D, metres",
        )
    elif layout == "tum":
        lines = ["# timestamp filename", *(f"{t} rgb/{name}" for t, name, _ in listed)]
        (folder / "rgb.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
        force = [f"{r[0]:.6f} {r[4]:.6f} {-r[5]:.6f} {-r[6]:.6f}" for r in rows]
        (folder / "accelerometer.txt").write_text("\n".join(["# timestamp ax ay az", *force]) + "\n", encoding="utf-8")
        up = path.position_m[::2] * _FLU_TO_FRD
        write_tum_trajectory(
            folder / "groundtruth.txt",
            path.time_s[::2],
            up,
            path.attitude_rad[::2] * _FLU_TO_FRD,
            "x north, y west, z up",
        )
    else:
        _write_euroc(folder / "mav0", path, [(name, ns) for _, name, ns in listed], rows)
    return len(listed)


def _write_euroc(base: Path, path: VehiclePath, listed: list[tuple[str, int]], imu: _Array) -> None:
    lines = ["#timestamp [ns],filename", *(f"{ns},{name}" for name, ns in listed)]
    (base / "cam0" / "data.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    head = _csv_header("#timestamp [ns]", "w_RS_S_{} [rad s^-1]", "a_RS_S_{} [m s^-2]")
    (base / "imu0").mkdir(parents=True, exist_ok=True)
    rows = []
    for r in imu:
        w, a = r[1:4] * _FLU_TO_FRD, r[4:7] * _FLU_TO_FRD
        rows.append(f"{round(r[0] * 1e9) + 10**18}," + ",".join(f"{x:.6f}" for x in (*w, *a)))
    (base / "imu0" / "data.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    quaternion = "q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    head = _csv_header("#timestamp", "p_RS_R_{} [m]") + f",{quaternion}" + _csv_header("", "v_RS_R_{} [m s^-1]")
    rows = []
    for t, x, e, v in zip(
        path.time_s[::2], path.position_m[::2], path.attitude_rad[::2], path.velocity_m_s[::2], strict=True
    ):
        q = quaternion_from_euler(*(e * _FLU_TO_FRD))
        values = (*(x * _FLU_TO_FRD), *q, *(v * _FLU_TO_FRD))
        rows.append(f"{round(t * 1e9) + 10**18}," + ",".join(f"{a:.6f}" for a in values))
    (base / "state_groundtruth_estimate0").mkdir(parents=True, exist_ok=True)
    (base / "state_groundtruth_estimate0" / "data.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")


def _csv_header(first: str, *forms: str) -> str:
    """Return a CSV header of EuRoC's form: ``first``, then each of ``forms`` filled with x, y and z."""
    return ",".join([first, *(form.format(axis) for form in forms for axis in "xyz")])


def ideal_imu_rows(path: VehiclePath) -> _Array:
    """Return rows of time, rates and specific force of an error-free inertial unit, body axes."""
    a = np.gradient(path.velocity_m_s, path.time_s, axis=0)
    roll, pitch, yaw = path.attitude_rad.T
    cr, sr, cp, sp, cy, sy = (
        np.cos(roll),
        np.sin(roll),
        np.cos(pitch),
        np.sin(pitch),
        np.cos(yaw),
        np.sin(yaw),
    )
    n, e, d = a[:, 0], a[:, 1], a[:, 2] - GRAVITY
    force = np.stack(
        [
            cp * cy * n + cp * sy * e - sp * d,
            (sr * sp * cy - cr * sy) * n + (sr * sp * sy + cr * cy) * e + sr * cp * d,
            (cr * sp * cy + sr * sy) * n + (cr * sp * sy - sr * cy) * e + cr * cp * d,
        ],
        axis=1,
    )
    return np.column_stack([path.time_s, path.body_rates_rad_s, force])


def _write_csv_table(file: Path, head: Iterable[str], rows: Any) -> None:
    lines = [",".join(head), *(",".join(f"{x:.9g}" for x in r) for r in rows)]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def format_camera_toml(camera: Camera) -> str:
    """Return a camera as the text of its file."""
    return tomli_w.dumps(camera.model_dump(exclude_none=True))


def write_tum_trajectory(
    file: Path, time: _Array, position: _Array, attitude: _Array, axes: str, covariance: _Array | None = None
) -> None:
    """Write a trajectory as a text file in the format of the TUM data sets: a line ``t x y z qx qy qz qw`` for each
    pose.

    With a covariance, each row also has its upper triangle over N, E, D and heading (10 numbers).
    """
    more = "" if covariance is None else " cov(N,E,D,heading: upper triangle, row by row)"
    lines = [f"# timestamp tx ty tz qx qy qz qw{more}", f"# {axes}"]
    upper = np.triu_indices(4)
    for k in range(len(time)):
        w, x, y, z = quaternion_from_euler(*attitude[k])
        tail = "" if covariance is None else "".join(f" {c:.4e}" for c in covariance[k][upper])
        p = position[k]
        if math.isfinite(p[0]):
            lines.append(f"{time[k]:.6f} {p[0]:.6f} {p[1]:.6f} {p[2]:.6f} {x:.7f} {y:.7f} {z:.7f} {w:.7f}{tail}")
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
