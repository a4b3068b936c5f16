"""Density of moist air by the CIPM-2007 formula, and its uncertainty from sensor errors.

    rho = p M_a / (Z R T) (1 - x_v (1 - M_v / M_a)) = 3.483740e-3 p / (Z T) (1 - 0.3780 x_v),    x_v = h f p_sv / p

with relative humidity h, enhancement factor f, saturation pressure p_sv and compressibility Z (Picard, Davis, Glaeser
and Fujii, Metrologia 45, 2008, 149-155; CO2 0.04 %). For 600 to 1100 hPa and 15 to 27 degC its own relative uncertainty
is 2.2e-5; here the formula is used from 5 to 40 degC.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def compute_moist_air_density(pressure_Pa: ArrayLike, temperature_K: ArrayLike, humidity: ArrayLike = 0.0) -> Array:
    """Return the density of air (kg/m3).

    Parameters
    ----------
    pressure_Pa, temperature_K, humidity : array_like
        Pressure, temperature and relative humidity (0 to 1), broadcast against each other.

    Source: CIPM-2007, eqs 1 to A1.4.
    """
    p, kelvin, h = np.broadcast_arrays(
        *(np.asarray(v, dtype=np.float64) for v in (pressure_Pa, temperature_K, humidity))
    )
    t = kelvin - 273.15
    saturation = np.exp(1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6.3431645e3 / kelvin)
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t**2
    x = h * enhancement * saturation / p
    z = (
        1.0
        - p / kelvin * (
            1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2 + (5.707e-6 - 2.051e-8 * t) * x
            + (1.9898e-4 - 2.376e-6 * t) * x**2
        )
        + (p / kelvin) ** 2 * (1.83e-11 - 0.765e-8 * x**2)
    )  # fmt: skip
    return 3.483740e-3 * p / (z * kelvin) * (1.0 - 0.3780 * x)


def compute_relative_density_std(
    pressure_Pa: float, temperature_K: float, humidity: float, *, pressure_std_Pa: float,
    temperature_std_K: float, humidity_std: float,
) -> float:  # fmt: skip
    """Return u(rho) / rho from standard uncertainties of the three sensors (GUM 5.1.2, derivatives by differences)."""
    at = (pressure_Pa, temperature_K, humidity)
    std = (pressure_std_Pa, temperature_std_K, humidity_std)
    total = 0.0
    for k, (s, step) in enumerate(zip(std, (10.0, 0.01, 1e-3), strict=True)):
        up, down = [list(at) for _ in range(2)]
        up[k] += step
        down[k] -= step
        slope = float(compute_moist_air_density(*up) - compute_moist_air_density(*down)) / (2.0 * step)
        total += (slope * s) ** 2
    return float(np.sqrt(total)) / float(compute_moist_air_density(*at))
