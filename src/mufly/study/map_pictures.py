"""Picture of a coefficient map: both rotors over the ratio of speeds, and over the climb velocity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mufly.rotor.map_kernel import at

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mufly.vehicle import CoefficientMap

__all__ = ["map_picture"]

_LABELS = ("$c_T$ (1)", "$c_Q$ (1)")
_STYLES = (("upper", "-", "o"), ("lower", "--", "s"))


def map_picture(coefficients: CoefficientMap) -> Figure:
    """Draw thrust and torque coefficients of both rotors at the middle of the mean speeds.

    Left over the ratio of speeds, for three climbs; right over the climb velocity, for three ratios. Lines are what the
    flight model interpolates, dots the points of the map, crosses those that were filled from their neighbours.
    """
    from matplotlib.figure import Figure

    t = coefficients.tables()
    k = t.shape[0] // 2
    mean = float(t.mean_speed_rad_s[k])
    tip = mean * coefficients.radius_m
    hover = int(np.argmin(np.abs(t.climb_ratio)))
    even = int(np.argmin(np.abs(t.ratio - 1.0)))
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    axes = figure.subplots(2, 2, sharey="row")
    tables = ((t.cT_upper, t.cT_lower), (t.cQ_upper, t.cQ_lower))
    for row in range(2):
        for side, chosen in (
            (0, sorted({0, hover, t.shape[2] - 1})),
            (1, sorted({0, even, t.shape[1] - 1})),
        ):
            panel = axes[row, side]
            axis = t.ratio if side == 0 else t.climb_ratio
            fine = np.linspace(float(axis[0]), float(axis[-1]), 201)
            for colour, n in enumerate(chosen):
                other = float(t.climb_ratio[n] if side == 0 else t.ratio[n])
                place = (fine, other) if side == 0 else (other, fine)
                values, _ = at(coefficients, mean, *place)
                for which, (name, line, mark) in enumerate(_STYLES):
                    points = tables[row][which][k, :, n] if side == 0 else tables[row][which][k, n, :]
                    good = t.solved[k, :, n] if side == 0 else t.solved[k, n, :]
                    label = f"climb {other * tip:+.2f} m/s" if side == 0 else f"ratio {other:.2f}"
                    scale = 1.0 if side == 0 else tip
                    panel.plot(
                        fine * scale, values[:, 2 * which + row], line, color=f"C{colour}",
                        label=f"{name}, {label}",
                    )  # fmt: skip
                    panel.plot(axis[good] * scale, points[good], mark, color=f"C{colour}", markersize=3)
                    panel.plot(axis[~good] * scale, points[~good], "x", color=f"C{colour}", markersize=7)
            panel.grid(alpha=0.3)
            if side == 0:
                panel.set_ylabel(_LABELS[row])
            if row == 1:
                panel.set_xlabel("lower over upper speed (1)" if side == 0 else "climb velocity (m/s)")
            else:
                panel.legend(fontsize=7)
    figure.suptitle(
        f"{coefficients.name}: {coefficients.description}\nat a mean speed of {mean * 30 / np.pi:.0f} rpm; "
        "x: filled from neighbours",
        fontsize=8,
    )
    return figure
