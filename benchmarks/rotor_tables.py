"""Tables and published loads that ``validate_rotors.py`` and ``rotor_checks.py`` share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

LIFT = {
    5.0: {0.50: 0.1070, 0.68: 0.1241, 0.80: 0.1517, 0.89: 0.1181, 0.96: 0.1519},
    8.0: {0.50: 0.2343, 0.68: 0.2815, 0.80: 0.2886, 0.89: 0.3143, 0.96: 0.2883},
}
"""Lift coefficients that Caradonna and Tung measured, by pitch (deg) and r/R, over the pressure of Omega r.

F. X. Caradonna, C. Tung, NASA TM-81232 (1981), Tables 10 and 17, as transcribed by github.com/mcroomp/dynbem. The lift
agrees to 2 % with readings of Fig. 14 by others, except at 0.96 R (0.274). Lower sides and the station at 0.80 R are
damaged in transcription and not used for pressures.
"""


def show_table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a Markdown table."""
    print(f"**{title}**\n\n| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print(flush=True)


def percent(ours: float, theirs: float) -> str:
    """Return the relative deviation in per cent."""
    return f"{100 * (ours / theirs - 1):+.1f}"


def sizes(errors: np.ndarray) -> str:
    """Return up to five errors, their mean size and their bias, in per cent."""
    known = 100 * errors[np.isfinite(errors)]
    if not known.size:
        return "none"
    each = ", ".join(f"{v:+.1f}" for v in 100 * errors) + ": " if errors.size <= 5 else ""
    return f"{each}{np.abs(known).mean():.1f} ({known.mean():+.1f})"


def bootstrap_share(inside: list[np.ndarray], groups: list[str], *, draws: int = 5000) -> tuple[float, float]:
    """Return the 5 and 95 % quantiles of the share of points inside, over groups drawn with replacement.

    The points of a group share its error; the share of all points is as uncertain as that of so many groups (Efron,
    Ann. Stat. 7, 1979). ``inside``: 1 or 0 by point of each rotor, ``groups``: the group of each rotor.
    """
    names = list(dict.fromkeys(groups))
    held = np.zeros((len(names), 2))
    for values, group in zip(inside, groups, strict=True):
        held[names.index(group)] += values.sum(), values.size
    drawn = held[np.random.default_rng(0).integers(0, len(names), (draws, len(names)))].sum(axis=1)
    low, high = np.percentile(drawn[:, 0] / drawn[:, 1], (5, 95)).tolist()
    return low, high
