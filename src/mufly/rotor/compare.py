"""Prediction beside measurement, and the calibration of a rotor on one measured point.

A measurement file is a CSV with a header; lines that begin with ``#`` are skipped::

    pitch_deg,speed_rpm,thrust_N,torque_Nm
    12,5000,0.151,0.0015

``torque_Nm`` may be left out. Errors are prediction over measurement less one.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mufly.errors import InputError, MuflyError
from mufly.rotor.blading import Blading, as_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.hover import Air, hover_batch

__all__ = ["Comparison", "Measurements", "calibrate", "compare", "read_measurements"]

Array = NDArray[np.float64]

_RPM = math.pi / 30.0


@dataclass(frozen=True, eq=False)
class Measurements:
    """Points of a test bench.

    Attributes
    ----------
    pitch_rad, speed_rad_s, thrust_N, torque_Nm : (n,) arrays
        Setting and result; torque is nan where it was not measured.
    source : str
        File or paper.
    """

    pitch_rad: Array
    speed_rad_s: Array
    thrust_N: Array
    torque_Nm: Array
    source: str


@dataclass(frozen=True, eq=False)
class Comparison:
    """A prediction beside a measurement.

    Attributes
    ----------
    measured : Measurements
        The bench.
    thrust_N, torque_Nm : (n,) arrays
        Prediction.
    thrust_error, torque_error : (n,) arrays
        Prediction / measurement - 1; nan without a measurement.
    calibrated : bool
        True if the prediction was scaled to a measurement.
    """

    measured: Measurements
    thrust_N: Array
    torque_Nm: Array
    thrust_error: Array
    torque_error: Array
    calibrated: bool

    @property
    def mean_thrust_error(self) -> float:
        """Mean absolute error of thrust."""
        return float(np.mean(np.abs(self.thrust_error)))

    @property
    def mean_torque_error(self) -> float:
        """Mean absolute error of torque; nan if none was measured."""
        known = np.isfinite(self.torque_error)
        return float(np.mean(np.abs(self.torque_error[known]))) if known.any() else math.nan

    def __str__(self) -> str:
        head = "calibrated on measurements" if self.calibrated else "not calibrated"
        lines = [
            f"{self.measured.source}: {head}",
            "pitch_deg speed_rpm  thrust_N measured  error   torque_Nm measured  error",
        ]
        m = self.measured
        for i in range(m.thrust_N.size):
            torque = f"{self.torque_Nm[i]:9.5f}"
            if np.isfinite(m.torque_Nm[i]):
                torque += f" {m.torque_Nm[i]:8.5f} {100 * self.torque_error[i]:+5.1f}%"
            lines.append(
                f"{math.degrees(m.pitch_rad[i]):9.2f} {m.speed_rad_s[i] / _RPM:9.0f} {self.thrust_N[i]:9.4f} "
                f"{m.thrust_N[i]:8.4f} {100 * self.thrust_error[i]:+5.1f}% {torque}"
            )
        mean = f"mean absolute error: thrust {100 * self.mean_thrust_error:.1f} %"
        if math.isfinite(self.mean_torque_error):
            mean += f", torque {100 * self.mean_torque_error:.1f} %"
        return "\n".join([*lines, mean])


def read_measurements(path: str | Path) -> Measurements:
    """Read a measurement file.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, or a value is not a number (thrust: not zero; speed:
        above zero).
    """
    where = str(path)
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(where, "", f"cannot be read ({error})", "give a CSV file") from error
    numbered = [
        (i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")
    ]
    if len(numbered) < 2:
        raise InputError(where, "", "holds no measurements", "give a header and at least one line")
    header = [name.strip() for name in next(csv.reader([numbered[0][1]]))]
    for name in ("pitch_deg", "speed_rpm", "thrust_N"):
        if name not in header:
            raise InputError(where, name, "is not among the columns", f"the header is {', '.join(header)}")
    rows = []
    for number, line in numbered[1:]:
        cells = dict(zip(header, next(csv.reader([line])), strict=False))
        row = []
        for name in ("pitch_deg", "speed_rpm", "thrust_N", "torque_Nm"):
            cell = (cells.get(name) or "").strip()
            try:
                value = math.nan if name == "torque_Nm" and not cell else float(cell)
            except ValueError:
                raise InputError(
                    where, f"line {number}, {name}", f"{cell!r} is not a number", "give one"
                ) from None
            if name != "torque_Nm" and not math.isfinite(value):
                raise InputError(where, f"line {number}, {name}", f"is {value:g}", "give a finite number")
            row.append(value)
        if not row[1] > 0.0 or row[2] == 0.0 or row[3] == 0.0:
            raise InputError(where, f"line {number}", "has no speed, thrust or torque", "leave it out")
        rows.append(row)
    pitch, rpm, thrust, torque = np.array(rows).T
    return Measurements(np.radians(pitch), rpm * _RPM, thrust, torque, Path(path).name)


def compare(
    blading: Blading | Rotor, measurements: Measurements | str | Path, *, air: Air | None = None
) -> Comparison:
    """Predict every measured point.

    Parameters
    ----------
    blading : Blading or Rotor
        The rotor, the first of a batch.
    measurements : Measurements, str or Path
        Points, or the file that holds them.
    air : Air, optional
        Density and viscosity at the bench.
    """
    bench = measurements if isinstance(measurements, Measurements) else read_measurements(measurements)
    blading = as_blading(blading)
    out = hover_batch(blading, pitch_rad=bench.pitch_rad, speed_rad_s=bench.speed_rad_s, air=air)
    return Comparison(
        bench,
        out.thrust_N,
        out.torque_Nm,
        out.thrust_N / bench.thrust_N - 1.0,
        out.torque_Nm / bench.torque_Nm - 1.0,
        blading.corrections.calibrated,
    )


def calibrate(
    blading: Blading, measurements: Measurements, point: int = 0, *, air: Air | None = None
) -> Blading:
    """Scale lift and drag of all sections so that one measured point is met, as the dissertation did (sec. 3.3.1).

    Two numbers are found: a factor on the lift coefficient that gives the thrust, then one on the drag
    coefficient that gives the torque; the pair is repeated until both hold to 1e-6. Results of the blading
    returned say ``calibrated``.

    Parameters
    ----------
    blading : Blading
        The rotor.
    measurements : Measurements
        The bench.
    point : int
        Which of its points.

    Raises
    ------
    MuflyError
        If no factors between 0.2 and 5 meet the point.
    """
    pitch, speed = measurements.pitch_rad[point], measurements.speed_rad_s[point]
    wanted = measurements.thrust_N[point], measurements.torque_Nm[point]
    lift, drag = 1.0, 1.0

    def scaled(lift: float, drag: float) -> Blading:
        return replace(blading, corrections=replace(blading.corrections, lift_factor=lift, drag_factor=drag))

    def error(lift: float, drag: float) -> tuple[float, float]:
        out = hover_batch(scaled(lift, drag), pitch_rad=pitch, speed_rad_s=speed, air=air)
        return float(out.thrust_N / wanted[0] - 1.0), float(out.torque_Nm / wanted[1] - 1.0)

    try:
        for _ in range(30):
            lift = brentq(lambda x, d=drag: error(x, d)[0], 0.2, 5.0, xtol=1e-10)
            if math.isfinite(wanted[1]):
                drag = brentq(lambda x, c=lift: error(c, x)[1], 0.2, 5.0, xtol=1e-10)
            thrust_error, torque_error = error(lift, drag)
            if abs(thrust_error) < 1e-6 and not abs(torque_error) > 1e-6:
                return scaled(lift, drag)
    except ValueError:
        pass
    raise MuflyError(
        f"{measurements.source}: no factors on lift and drag between 0.2 and 5 meet point {point + 1} "
        f"({math.degrees(pitch):g} deg, {speed / _RPM:.0f} rpm); check the rotor and the units"
    )
