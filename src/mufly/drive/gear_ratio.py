"""Gear ratios for a rotor and a motor: curves over the gear ratio as in Fig. 3.7, and optima in closed form.

At a given rotor speed Omega and torque Q (so at a given thrust) the motor balance of eq. 3.18 is a quadratic in
the gear ratio i. With A = kM U / R - Mf and B = kM kE / R + dR

    B Omega i^2 - A i + Q / eta = 0,     i = [A +- sqrt(A^2 - 4 B Omega Q / eta)] / (2 B Omega).

Both roots give the required thrust at full voltage U. The larger root has a faster motor, less current and less power.
It is the gear *adapted* to a thrust, as in the dissertation's studies (Sec. 3.4). There is no root if the rotor needs
more than the motor's greatest power, Q Omega > eta A^2 / (4 B).

At lower voltage (duty below 1) every i between the roots is possible. The input power then is, with a = Q / (eta kM)
and b = dR Omega / kM,

    I = a / i + b i,     P = R I^2 + kE Omega i I,     dP/di = 0  at  i^4 = R a^2 / (R b^2 + kE Omega b),

convex in i: the *best* gear is that value, clipped to the interval. Constant friction adds Mf / kM to I; P remains
convex, and the root of the polynomial dP/di i^3 = 0 is found by Newton's method from that value. Own derivation.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from mufly.drive.drive_train import DriveTrain, MotorConstants
from mufly.drive.operating_point import RotorLoad, find_operating_point
from mufly.errors import InputError
from mufly.results import result

Array = NDArray[np.float64]

_MAX_NEWTON_STEPS = 20  # the start is an upper bound, above which the polynomial is convex: no step overshoots

GEAR_CURVE_LABELS = {
    "input_power_W": ("W", "electrical input power"),
    "mechanical_power_W": ("W", "mechanical power at the rotor"),
    "thrust_N": ("N", "thrust"),
    "efficiency": ("1", "mechanical over electrical power"),
    "thrust_per_power_N_W": ("N/W", "thrust per electrical power"),
    "torque_Nm": ("N m", "rotor torque"),
    "speed_rad_s": ("rad/s", "rotor speed"),
    "motor_speed_rad_s": ("rad/s", "motor speed"),
    "motor_current_A": ("A", "motor current"),
}


def _solve_gear_quadratic(
    c: MotorConstants, speed: ArrayLike, torque: ArrayLike, voltage: ArrayLike
) -> tuple[Array, Array]:
    w, q = np.asarray(speed, dtype=np.float64), np.asarray(torque, dtype=np.float64)
    a = np.asarray(c.torque_Nm_A) * np.asarray(voltage) / c.resistance_ohm - c.friction_Nm
    b = (np.asarray(c.torque_Nm_A) * c.back_emf_V_s / c.resistance_ohm + c.friction_Nm_s) * w
    inside = np.where(a > 0, a**2, 0.0) - 4.0 * b * q / c.gear_efficiency
    with np.errstate(invalid="ignore", divide="ignore"):
        large = 0.5 * (a + np.sqrt(np.where(inside >= 0, inside, np.nan))) / b
        return q / (c.gear_efficiency * b * large), large


def find_full_voltage_gear_ratio(c: MotorConstants, speed: ArrayLike, torque: ArrayLike, voltage: ArrayLike) -> Array:
    """Return the gear ratio of least power at which the drive holds a rotor's speed at full voltage.

    Parameters
    ----------
    c : MotorConstants
        Motor constants; their gear ratio is ignored.
    speed, torque : array_like
        Speed and torque of the rotor (rad/s, N m).
    voltage : array_like
        Voltage at the motor (V).

    Returns
    -------
    array of the broadcast shape
        Gear ratio; nan if the motor's power is insufficient.
    """
    return _solve_gear_quadratic(c, speed, torque, voltage)[1]


def find_least_power_gear_ratio(c: MotorConstants, speed: ArrayLike, torque: ArrayLike, voltage: ArrayLike) -> Array:
    """Return the gear ratio of least power at any duty up to full voltage; arguments as for
    :func:`find_full_voltage_gear_ratio`."""
    small, large = _solve_gear_quadratic(c, speed, torque, voltage)
    w = np.asarray(speed, dtype=np.float64)
    a = np.asarray(torque) / (np.asarray(c.gear_efficiency) * c.torque_Nm_A)
    b = np.asarray(c.friction_Nm_s) * w / c.torque_Nm_A
    with np.errstate(divide="ignore", invalid="ignore"):
        free = (c.resistance_ohm * a**2 / (c.resistance_ohm * b**2 + c.back_emf_V_s * w * b)) ** 0.25
    rub = np.asarray(c.friction_Nm) / c.torque_Nm_A
    if np.any(rub > 0):
        r, e, free = np.asarray(c.resistance_ohm), c.back_emf_V_s * w, np.minimum(free, large)
        for _ in range(_MAX_NEWTON_STEPS):
            slope = 2 * r * (a + b * free**2 + rub * free) * (b * free**2 - a) + e * (2 * b * free + rub) * free**3
            steeper = 2 * r * ((2 * b * free + rub) * (b * free**2 - a) + (a + b * free**2 + rub * free) * 2 * b * free)
            free = free - slope / (steeper + e * (8 * b * free + 3 * rub) * free**2)
    return np.clip(free, small, large)


def sweep_gear_ratio(
    drive: DriveTrain, load: RotorLoad, ratios: ArrayLike, *, duty: float = 1.0, supply_V: float | None = None
) -> xr.Dataset:
    """Return power, thrust and efficiency over the gear ratio at constant motor voltage (Fig. 3.7).

    Parameters
    ----------
    drive : DriveTrain
    load : RotorLoad
    ratios : (n,) array_like
        Gear ratios, above 0.
    duty : float
        Motor voltage over supply voltage.
    supply_V : float, optional
        Default: the battery's nominal voltage.

    Thesis: Fig. 3.7; Sec. 3.1.4.
    """
    ratio = np.atleast_1d(np.asarray(ratios, dtype=np.float64))
    if ratio.ndim != 1 or ratio.size == 0:
        raise InputError("gear", "ratio", "is not a list of numbers", "give gear ratios, as in 0.5:8:0.1")
    point = find_operating_point(drive, load, duty=duty, supply_V=supply_V, gear_ratio=ratio)
    return xr.Dataset(
        {
            name: ("gear_ratio", getattr(point, name), {"units": unit, "long_name": text})
            for name, (unit, text) in GEAR_CURVE_LABELS.items()
        },
        coords={"gear_ratio": ("gear_ratio", ratio, {"units": "1", "long_name": "gear ratio"})},
        attrs={"drive": drive.name, "motor_voltage_V": float(point.motor_voltage_V[0])},
    )


@result
class GearOptima:
    """Optimal gear ratios of a drive at full voltage, each for one criterion.

    ``for_required_thrust`` is the largest ratio that gives the required thrust; nan if there is none or no thrust is
    required.
    """

    mechanical_power: float
    thrust: float
    efficiency: float
    thrust_per_power: float
    for_required_thrust: float


def find_gear_optima(
    drive: DriveTrain,
    load: RotorLoad,
    *,
    thrust_N: float | None = None,
    duty: float = 1.0,
    supply_V: float | None = None,
) -> GearOptima:
    """Find the optima of :func:`sweep_gear_ratio` and the largest gear ratio that gives a thrust.

    Parameters
    ----------
    drive, load, duty, supply_V
        As for :func:`sweep_gear_ratio`.
    thrust_N : float, optional
        Required thrust.

    Notes
    -----
    The curve is sampled at 400 ratios from 0.2 to 30 in geometric progression; optima are the vertices of parabolas
    through the three points around the greatest sample, and the crossing is interpolated. Both are accurate to 1e-4
    of the ratio.
    """
    ratio = np.geomspace(0.2, 30.0, 400)
    curve = sweep_gear_ratio(drive, load, ratio, duty=duty, supply_V=supply_V)
    x = np.log(ratio)

    def find_peak(name: str) -> float:
        y = curve[name].values
        k = int(np.clip(np.argmax(y), 1, y.size - 2))
        left, right = y[k] - y[k - 1], y[k] - y[k + 1]
        step = x[1] - x[0]
        shift = 0.5 * (left - right) / (left + right) if left + right > 0 else 0.0
        return float(np.exp(x[k] + shift * step))

    found = np.nan
    if thrust_N is not None:
        over = np.flatnonzero(curve.thrust_N.values >= thrust_N)
        if over.size and over[-1] < ratio.size - 1:
            k = over[-1]
            y = curve.thrust_N.values
            found = float(np.exp(x[k] + (y[k] - thrust_N) / (y[k] - y[k + 1]) * (x[k + 1] - x[k])))
    return GearOptima(
        find_peak("mechanical_power_W"),
        find_peak("thrust_N"),
        find_peak("efficiency"),
        find_peak("thrust_per_power_N_W"),
        found,
    )
