"""Fig. 3.7, gear ratios of muFly, and Fig. 3.25, coefficients over speed (Secs 3.1.4, 3.3.4).

Which rotor Fig. 3.7 was drawn for, and at which voltage, is not said. It is computed here for both rotors of
prototype 1.1 with the constant coefficients of Table 5.3, at the nominal 7.2 V and at the 6.4 V that the
dissertation's linear model shows (docs/thesis-errata.md, point 6). With constant coefficients the optimal
ratios grow with the cube root of the voltage.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from mufly.drive import RotorLoad, coefficient_load, gear_curve, gear_optima, load_drive
from mufly.rotor import load_rotor
from mufly.study import MODELS, Setup, sweep
from mufly.thesis.claims import CLAIMS, Verdict
from mufly.vehicle import load_vehicle

__all__ = ["coefficients_over_speed", "muflys_gear", "vehicle_load"]

RATIOS = np.round(np.arange(0.5, 8.01, 0.1), 3)
WANTED_N = 0.6
VOLTAGES = (7.2, 6.4)
ROTORS = ("upper", "lower")


def vehicle_load(which: str) -> RotorLoad:
    """Return the load of the ``upper`` or ``lower`` rotor of prototype 1.1 with the coefficients of Table 5.3."""
    v = load_vehicle("mufly-1.1")
    one = v.rotors.upper if which == "upper" else v.rotors.lower
    return coefficient_load(
        float(one.thrust_coefficient), float(one.torque_coefficient), radius_m=float(v.rotors.radius),
        density_kg_m3=float(v.air.density),
    )  # fmt: skip


def muflys_gear() -> tuple[xr.Dataset, list[Verdict]]:
    """Compute Fig. 3.7 for both rotors; dimensions are voltage, rotor and gear ratio."""
    drive, verdicts, sheets = load_drive("mufly"), [], []
    for volt in VOLTAGES:
        loads = [vehicle_load(which) for which in ROTORS]
        curves = [gear_curve(drive, load, RATIOS, supply_V=volt) for load in loads]
        best = [gear_optima(drive, load, thrust_N=WANTED_N, supply_V=volt) for load in loads]
        at_two = [float(curve.thrust_N.sel(gear_ratio=2.0)) for curve in curves]
        sheets.append(xr.concat(curves, xr.Variable("rotor", list(ROTORS)), combine_attrs="drop_conflicts"))
        for claim, field, tolerance, note in (
            ("gear-power", "mechanical_power", 0.15, ""),
            ("gear-efficiency", "efficiency", 0.3, ""),
            ("gear-thrust-per-power", "thrust_per_power", 0.4, ""),
            (
                "gear-thrust",
                "for_thrust",
                0.15,
                f"; at a ratio of 2 they give {at_two[0]:.2f} and {at_two[1]:.2f} N",
            ),
        ):
            ours, value = [float(getattr(b, field)) for b in best], CLAIMS[claim].value
            verdicts.append(
                Verdict(
                    CLAIMS[claim], f"constant coefficients, {volt:g} V",
                    f"{ours[0]:.2f} with the upper rotor, {ours[1]:.2f} with the lower{note}",
                    min(ours) - tolerance <= value <= max(ours) + tolerance,
                    f"between ours, or within {tolerance:g} of them",
                )
            )  # fmt: skip
    data = xr.concat(
        sheets, xr.Variable("voltage", list(VOLTAGES), {"units": "V"}), combine_attrs="drop_conflicts"
    )
    return data, verdicts


def coefficients_over_speed(model: str) -> tuple[xr.Dataset, list[Verdict]]:
    """Compute Fig. 3.25, thrust and torque coefficient of the standard blade over the speed at four pitch settings."""
    setup = Setup(load_rotor("naca4412-r60-c20"), corrections=MODELS[model], flags=False)
    speed = [float(x) * math.pi / 30 for x in np.arange(3000, 7001, 500)]
    data = sweep(setup, {"pitch": [math.radians(p) for p in (12, 14, 16, 18)], "speed": speed})
    change_q = 100 * (data.c_Q.values[:, -1] / data.c_Q.values[:, 0] - 1)
    change_t = 100 * (data.c_T.values[:, -1] / data.c_T.values[:, 0] - 1)

    def text(change: np.ndarray) -> str:
        return f"{', '.join(f'{c:+.1f}' for c in change)} % from 3 000 to 7 000 rpm at 12, 14, 16, 18 deg"

    return data, [
        Verdict(
            CLAIMS["coefficients-torque"], model, text(change_q), bool(np.all(np.abs(change_q) < 10)), "less than 10 %"
        ),
        Verdict(
            CLAIMS["coefficients-thrust"], model, text(change_t),
            bool(np.all(change_t > 0) and np.all(np.abs(change_t) > np.abs(change_q))),
            "grows, and more than c_Q changes",
        ),
    ]  # fmt: skip
