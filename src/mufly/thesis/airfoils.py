"""Table 3.3 and Figs 3.29, 3.33 and 3.34: 247 airfoils on the standard blade, and the sections that are drawn.

The 247 are chosen by the rule of ``study.airfoils``; only the eight that the dissertation names are surely its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from mufly.study import TABLE_3_3, rank_airfoils, thesis_airfoils
from mufly.study.sweep import Progress
from mufly.thesis.claims import CLAIMS, TABLE_3_3_VALUES, Verdict
from mufly.thesis.single import PITCH_DEG, standard_setup

__all__ = ["SECTIONS", "airfoil_ranking"]

SECTIONS: dict[str, tuple[str, Sequence[str]]] = {
    "fig-3.29": ("Four-digit NACA sections", ["naca0012", "naca4412", "naca9412", "naca9712"]),
    "fig-3.33": ("The four best airfoils of Table 3.3", ["goe394", "goe342", "gm15sm", "goe142"]),
    "fig-3.34": ("The four worst airfoils of Table 3.3", ["naca6415", "n64015", "naca25016", "lnv109a"]),
}


def airfoil_ranking(model: str, progress: Progress | None = None) -> tuple[xr.Dataset, list[Verdict]]:
    """Rank the 247 airfoils with one model, and judge Table 3.3."""
    pitch = [float(p) for p in np.radians(PITCH_DEG)]
    ranking = rank_airfoils(standard_setup(model), thesis_airfoils(), pitch, progress=progress)
    n = ranking.sizes["airfoil"]

    def row(name: str) -> tuple[int, float, float]:
        one = ranking.sel(airfoil=TABLE_3_3[name])
        return int(one["rank"]), float(one["thrust_per_power_N_W"]), float(one["electrical_power_W"])

    def text(names: Sequence[str]) -> str:
        parts = []
        for name in names:
            place, value, _ = row(name)
            change = 100 * (value / TABLE_3_3_VALUES[name][1] - 1)
            parts.append(f"{name} rank {place}, {value:.4f} N/W ({change:+.1f} %)")
        return "; ".join(parts)

    names = list(TABLE_3_3_VALUES)
    top, bottom = names[:4], names[4:]
    worst_power, best_power = row("NACA6415")[2], row(names[0])[2]
    return ranking, [
        Verdict(
            CLAIMS["airfoils-top"], model, text(top), all(row(k)[0] <= n // 10 for k in top),
            "all four in the best tenth",
        ),
        Verdict(
            CLAIMS["airfoils-bottom"], model, text(bottom), all(row(k)[0] > n - n // 10 for k in bottom),
            "all four in the worst tenth",
        ),
        Verdict(
            CLAIMS["airfoils-spread"], model,
            f"{best_power:.2f} W and {worst_power:.2f} W: {worst_power - best_power:.2f} W more",
            abs(worst_power - best_power - CLAIMS["airfoils-spread"].value) < 1.0, "within 1 W",
        ),
    ]  # fmt: skip
