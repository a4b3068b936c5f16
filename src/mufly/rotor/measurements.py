"""Measured points of a rotor, as the files of test benches and propeller data sites give them.

A measurement file is a CSV with a header; lines that begin with ``#`` are skipped::

    pitch_deg,speed_rpm,thrust_N,torque_Nm
    12,5000,0.151,0.0015

Columns go by several names, case does not matter, and others are passed over:

=========  ==================================================================================================
pitch      ``pitch_deg``; without it the blades stand as in the rotor file (0)
speed      ``speed_rpm``, ``rpm``
thrust     ``thrust_N``, ``T_N``, ``T(N)``, ``T_meas_N``, or ``CT`` = T / (rho n^2 D^4), n in revolutions a second
torque     ``torque_Nm``, ``Q_Nm``, ``Q(Nm)``, ``Q_meas_Nm``, ``power_W``, ``P(W)``, or ``CP`` = P / (rho n^3 D^5);
           it may be left out
=========  ==================================================================================================

The coefficients are those of propellers (UIUC's data, for one) and need diameter and density.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mufly.errors import InputError, MuflyError
from mufly.rotor.bemt import Air, hover_batch
from mufly.rotor.blading import Blading, as_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.system import hover_wake, solve_thrust
from mufly.rotor.wake.result import WakeSettings, WakeSolution

Array = NDArray[np.float64]

_RPM = math.pi / 30.0
_TORQUE = ("torque_nm", "q_nm", "q(nm)", "q_meas_nm", "power_w", "p(w)", "cp")
_NAMES = {
    "pitch_deg": ("pitch_deg",),
    "speed_rpm": ("speed_rpm", "rpm"),
    "thrust_N": ("thrust_n", "t_n", "t(n)", "t_meas_n", "ct"),
    "torque_Nm": _TORQUE,
}


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


def read_measurements(
    path: str | Path, *, diameter_m: float | None = None, density_kg_m3: float | None = None
) -> Measurements:
    """Read a measurement file.

    Parameters
    ----------
    path : str or Path
    diameter_m, density_kg_m3 : float, optional
        Of the rotor and of the air at the bench; needed where the file gives coefficients.

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
    columns = _columns(where, header)
    if {"ct", "cp"} & {header[c].lower() for c in columns.values()} and not (diameter_m and density_kg_m3):
        raise InputError(
            where, "CT", "is a coefficient", "say to which rotor and air it belongs, or give thrust_N"
        )
    rows = []
    for number, line in numbered[1:]:
        cells = next(csv.reader([line]))
        row = {name: _number(where, number, header[c], cells, c) for name, c in columns.items()}
        if not (row["speed_rpm"] > 0.0 and row["thrust_N"] != 0.0 and row.get("torque_Nm", 1.0) != 0.0):
            raise InputError(where, f"line {number}", "has no speed, thrust or torque", "leave it out")
        rows.append(
            [row.get("pitch_deg", 0.0), row["speed_rpm"], row["thrust_N"], row.get("torque_Nm", math.nan)]
        )
    pitch, rpm, thrust, torque = np.array(rows).T
    speed = rpm * _RPM
    named = header[columns["thrust_N"]].lower()
    to_thrust = _thrust_from(named, diameter_m or math.nan, density_kg_m3 or math.nan)
    if "torque_Nm" in columns:
        named = header[columns["torque_Nm"]].lower()
        torque = _torque_from(named, diameter_m or math.nan, density_kg_m3 or math.nan)(torque, speed)
    return Measurements(np.radians(pitch), speed, to_thrust(thrust, speed), torque, Path(path).name)


def _columns(where: str, header: list[str]) -> dict[str, int]:
    lower = [name.lower() for name in header]
    found = {
        quantity: lower.index(next(n for n in names if n in lower))
        for quantity, names in _NAMES.items()
        if any(n in lower for n in names)
    }
    for quantity in ("speed_rpm", "thrust_N"):
        if quantity not in found:
            raise InputError(
                where, quantity, "is not among the columns", f"the header is {', '.join(header)}"
            )
    return found


def _number(where: str, number: int, column: str, cells: list[str], index: int) -> float:
    cell = cells[index].strip() if index < len(cells) else ""
    optional = column.lower() in _TORQUE
    try:
        value = math.nan if optional and not cell else float(cell)
    except ValueError:
        raise InputError(where, f"line {number}, {column}", f"{cell!r} is not a number", "give one") from None
    if not (math.isfinite(value) or (optional and not cell)):
        raise InputError(where, f"line {number}, {column}", f"is {value:g}", "give a finite number")
    return value


_Convert = Callable[[Array, Array], Array]


def _thrust_from(column: str, diameter: float, density: float) -> _Convert:
    if column == "ct":
        return lambda value, speed: value * density * (speed / (2 * np.pi)) ** 2 * diameter**4
    return lambda value, speed: value


def _torque_from(column: str, diameter: float, density: float) -> _Convert:
    if column == "cp":
        return lambda value, speed: value * density * (speed / (2 * np.pi)) ** 3 * diameter**5 / speed
    if column in ("power_w", "p(w)"):
        return lambda value, speed: value / speed
    return lambda value, speed: value


# ----------------------------------------------------------------------------
# Prediction beside measurement, and the calibration of a rotor on one measured point.
#
# Errors are prediction over measurement less one. :mod:`mufly.rotor.measurements` reads the files.


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
        """Mean absolute error of thrust, over the points that have a prediction; nan if none has."""
        known = np.isfinite(self.thrust_error)
        return float(np.mean(np.abs(self.thrust_error[known]))) if known.any() else math.nan

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
    blading = as_blading(blading)
    bench = (
        measurements
        if isinstance(measurements, Measurements)
        else read_measurements(
            measurements,
            diameter_m=2.0 * float(blading.radius_m[0]),
            density_kg_m3=(air or Air()).density_kg_m3,
        )
    )
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


# ----------------------------------------------------------------------------
# What is asked of a wake other than one point: a thrust, or every point of a measurement.
#
# The wake is dear and blade element momentum theory (BEMT) is not, and the ratio of the two hardly changes from one
# point to a near one. So BEMT, scaled to the wake at the last point, finds the next one: with T_w / T_b the ratio
# there,
# the point is sought at which BEMT gives T_wanted T_b / T_w. Two or three wakes are enough.


Progress = Callable[[int, float, float], None]

_REACHED = 1e-3  # of the thrust: what a converged wake can tell
_TRIES = 8


def solve_thrust_wake(
    blading: Blading | Rotor,
    *,
    thrust_N: float,
    pitch_rad: float | None = None,
    speed_rad_s: float | None = None,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    which: int = 0,
    settings: WakeSettings | None = None,
    progress: Progress | None = None,
) -> WakeSolution:
    """Find the speed (at given pitch) or the pitch (at given speed) for a thrust, to 0.1 % or the wake's tolerance.

    Arguments as for :func:`mufly.rotor.solve_thrust`. A wake on the way that does not converge is returned as it is,
    marked so.

    Raises
    ------
    InputError
        If neither or both of pitch and speed are given, or the thrust is out of reach.
    MuflyError
        If eight tries do not find it.
    """
    if not 0.0 < thrust_N < math.inf:
        raise InputError("rotor", "thrust", f"is {thrust_N:g} N", "give a number above 0")
    case, how = as_blading(blading), settings or WakeSettings()
    enough = max(_REACHED, how.tolerance)
    wanted, known, reached = thrust_N, None, math.nan
    for _ in range(_TRIES):
        b = solve_thrust(
            case, thrust_N=wanted, pitch_rad=pitch_rad, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=air,
            which=which,
        )  # fmt: skip
        known = hover_wake(
            case, pitch_rad=b.pitch_rad, speed_rad_s=b.speed_rad_s, climb_m_s=climb_m_s, air=air, which=which,
            settings=how, start=known, progress=progress,
        )  # fmt: skip
        reached = known.rotors[0].thrust_N
        if not known.converged or abs(reached / thrust_N - 1.0) <= enough:
            return known
        if not reached > 0.0:
            break
        wanted = thrust_N * b.thrust_N / reached
    raise MuflyError(
        f"rotor: {thrust_N:g} N is not found in {_TRIES} tries; the last wake gives {reached:.4g} N"
    )


def compare_wake(
    blading: Blading | Rotor,
    measured: Measurements,
    *,
    air: Air | None = None,
    settings: WakeSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Comparison, list[str]]:
    """Predict every measured point by the wake method.

    Parameters
    ----------
    blading : Blading or Rotor
    measured : Measurements
    air : Air, optional
        Density and viscosity at the bench.
    settings : WakeSettings, optional
    progress : callable, optional
        Called with points done and points in all.

    Returns
    -------
    comparison : Comparison
        Points whose wake did not converge hold nan.
    faults : list of str
        Why not, for each point; empty where it did.
    """
    case, n = as_blading(blading), measured.thrust_N.size
    thrust, torque, faults = np.full(n, np.nan), np.full(n, np.nan), [""] * n
    known: WakeSolution | None = None
    # Neighbours in pitch and speed one after the other: each wake starts from the one before.
    for done, k in enumerate(np.lexsort((measured.speed_rad_s, measured.pitch_rad)).tolist()):
        if progress is not None:
            progress(done, n)
        pitch, speed = float(measured.pitch_rad[k]), float(measured.speed_rad_s[k])
        now = hover_wake(case, pitch_rad=pitch, speed_rad_s=speed, air=air, settings=settings, start=known)
        if not now.converged and known is not None:
            now = hover_wake(case, pitch_rad=pitch, speed_rad_s=speed, air=air, settings=settings)
        if now.converged:
            known = now
            thrust[k], torque[k] = now.rotors[0].thrust_N, now.rotors[0].torque_Nm
        else:
            faults[k] = now.message
    if progress is not None:
        progress(n, n)
    return (
        Comparison(
            measured,
            thrust,
            torque,
            thrust / measured.thrust_N - 1.0,
            torque / measured.torque_Nm - 1.0,
            case.corrections.calibrated,
        ),
        faults,
    )
