"""The studies of one rotor, Secs 3.4.1 to 3.4.4: thrust per electrical power over the pitch at 0.4 N, one thing varied.

All are about the standard blade (NACA4412, R 60 mm, chord 20 mm), on muFly's motor at its nominal 7.2 V, the
gear adapted to every case so that full voltage gives just 0.4 N (``drive.gear``). That this is what was done is
supported by Table 3.3: with it, and blade element theory as the dissertation writes it, its four best airfoils
come out within 3 %. Each study is run with two models (``study.MODELS``): the one recommended here and the
dissertation's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.drive import load_drive
from mufly.rotor import load_rotor
from mufly.study import MODELS, Setup, sweep
from mufly.thesis.claims import CLAIMS, Verdict

__all__ = ["PITCH_DEG", "SWEEPS", "SweepStudy", "run_sweep", "standard_setup"]

Array = NDArray[np.float64]
Judge = Callable[[str, Array, Array], list[Verdict]]

THRUST_N = 0.4
PITCH_DEG = tuple(float(p) for p in range(6, 21))
VALUE = "thrust_per_power_N_W"


@dataclass(frozen=True)
class SweepStudy:
    """One figure.

    Attributes
    ----------
    title : str
    parameter : str
        What is varied.
    values : sequence
        In SI units, in the order of the figure's legend.
    labels : sequence of str
        The figure's.
    judge : callable
        ``judge(model, pitch_deg (p,), thrust_per_power (values, p))`` gives verdicts.
    """

    title: str
    parameter: str
    values: Sequence[float | str]
    labels: Sequence[str]
    judge: Judge


def standard_setup(model: str, *, flags: bool = False) -> Setup:
    """Return the standard blade on muFly's drive at 0.4 N with adapted gear."""
    return Setup(
        load_rotor("naca4412-r60-c20"),
        load_drive("mufly"),
        {"thrust": THRUST_N, "gear": "adapted"},
        corrections=MODELS[model],
        flags=flags,
    )


def run_sweep(study: SweepStudy, model: str) -> tuple[xr.Dataset, list[Verdict]]:
    """Compute a figure with one model, and judge it."""
    vary: Mapping[str, Sequence[float | str]] = {
        study.parameter: list(study.values),
        "pitch": [float(p) for p in np.radians(PITCH_DEG)],
    }
    data = sweep(standard_setup(model), vary)
    data = data.assign_coords(label=(study.parameter, list(study.labels)))
    return data, study.judge(model, np.array(PITCH_DEG), data[VALUE].values)


def _best(values: Array) -> Array:
    """Greatest value over the pitch of every line; nan where there is none."""
    filled = np.where(np.isfinite(values), values, -np.inf).max(axis=1)
    return np.where(np.isfinite(filled), filled, np.nan)


def _best_pitch(pitch: Array, values: Array) -> Array:
    return pitch[np.where(np.isfinite(values), values, -np.inf).argmax(axis=1)]


def _gain(values: Array, of: int, over: int) -> float:
    best = _best(values)
    return float(100.0 * (best[of] / best[over] - 1.0))


def _numbers(values: Array, form: str = "{:.4f}") -> str:
    return ", ".join(form.format(v) for v in values)


def _blades(model: str, pitch: Array, v: Array) -> list[Verdict]:
    others = np.nanmax(v[1:], axis=0)
    ahead = v[0] >= others
    until = float(pitch[ahead][-1]) if ahead.all() else float(pitch[np.argmin(ahead)] - (pitch[1] - pitch[0]))
    high = pitch > 16.0
    more = 100 * float(np.mean(np.maximum(v[1], v[2])[high] / v[0][high]) - 1)
    worst = bool(np.all(v[3] <= v[:3].min(axis=0) + 1e-12))
    return [
        Verdict(
            CLAIMS["blades-two"], model,
            f"two blades lead up to {until:g} deg" if ahead[0] else "two blades lead at no low pitch",
            abs(until - 16.0) <= 2.0 and bool(ahead[0]), "within 2 degrees",
        ),
        Verdict(
            CLAIMS["blades-more"], model, f"the better of three and four is {more:+.1f} % there",
            0.0 < more < 10.0, "better by less than 10 %",
        ),
        Verdict(
            CLAIMS["blades-five"], model, f"bests {_numbers(_best(v))} N/W for 2 to 5 blades", worst,
            "lowest at every pitch",
        ),
    ]  # fmt: skip


def _radius(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best, total = _best(v), _gain(v, 3, 0)
    steps = ", ".join(f"{100 * (b / a - 1):+.0f}" for a, b in pairwise(best))
    # At constant figure of merit the ideal power falls with 1/R: 60 % more thrust per power from 50 to 80 mm.
    ours = f"bests {_numbers(best)} N/W for R 50 to 80 mm"
    return [
        Verdict(CLAIMS["radius"], model, ours, bool(np.all(np.diff(best) > 0)), "rises at every step"),
        Verdict(
            CLAIMS["radius-size"], model, f"{total:+.0f} % ({steps} % a step of 10 mm; momentum theory alone: +60 %)",
            abs(total - CLAIMS["radius-size"].value) < 5.0, "within 5 % points",
        ),
    ]  # fmt: skip


def _chord(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best, at = _best(v), _best_pitch(pitch, v)
    spread = 100 * float(best[2:].max() / best[2:].min() - 1)
    return [
        Verdict(
            CLAIMS["chord-best"], model, f"bests {_numbers(best)} N/W for 10 to 30 mm", int(best.argmax()) == 4,
            "greatest at 30 mm",
        ),
        Verdict(CLAIMS["chord-flat"], model, f"{spread:.1f} % between 20, 25 and 30 mm", spread < 3.0, "below 3 %"),
        Verdict(
            CLAIMS["chord-pitch"], model, f"best pitch {_numbers(at, '{:g}')} deg",
            bool(np.all(np.diff(at) >= 0) and at[-1] > at[0]), "never falls, and rises",
        ),
    ]  # fmt: skip


def _thickness(model: str, pitch: Array, v: Array) -> list[Verdict]:
    gain = _gain(v, 0, 3)
    ours = f"bests {_numbers(_best(v))} N/W for 6 to 15 %, thinnest over thickest {gain:+.1f} %"
    return [Verdict(CLAIMS["thickness"], model, ours, gain > 10.0, "above 10 %")]


def _camber(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best = _best(v)
    ours = f"bests {_numbers(best)} N/W for 0, 2, 4 and 9 %"
    return [Verdict(CLAIMS["camber"], model, ours, int(best.argmax()) == 2, "greatest at 4 %")]


def _position(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best = _best(v)
    spread = 100 * float(best.max() / best.min() - 1)
    ours = f"bests {_numbers(best)} N/W for 20, 40, 70 and 90 %, spread {spread:.1f} %"
    return [Verdict(CLAIMS["camber-position"], model, ours, spread < 3.0, "bests within 3 %")]


def _taper(model: str, pitch: Array, v: Array) -> list[Verdict]:
    gain = _gain(v, 3, 0)
    ours = f"bests {_numbers(_best(v))} N/W from straight to 35-05, {gain:+.1f} %"
    return [Verdict(CLAIMS["taper"], model, ours, gain > 10.0, "above 10 %")]


def _twist(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best, at = _best(v), _best_pitch(pitch, v)
    ours = f"bests {_numbers(best)} N/W for 0 to 15 deg, {_gain(v, 3, 0):+.1f} %"
    falls = bool(np.all(np.diff(at) <= 0) and at[-1] < at[0])
    return [
        Verdict(CLAIMS["twist"], model, ours, int(best.argmax()) == 3, "greatest at 15 degrees"),
        Verdict(
            CLAIMS["twist-pitch"],
            model,
            f"best pitch {_numbers(at, '{:g}')} deg (at the tip)",
            falls,
            "never rises, and falls",
        ),
    ]


def _degrees(*values: float) -> list[float]:
    return [float(x) for x in np.radians(values)]


_THICKNESS = ["naca4406", "naca4409", "naca4412", "naca4415"]
_CAMBER = ["naca0012", "naca2412", "naca4412", "naca9412"]
_POSITION = ["naca4212", "naca4412", "naca4712", "naca4912"]
_TAPER = [1.0, 15 / 25, 10 / 30, 5 / 35]  # tip over hub chord

SWEEPS: dict[str, SweepStudy] = {
    "fig-3.26": SweepStudy(
        "Number of blades", "blades", [2.0, 3.0, 4.0, 5.0], [f"{n} blades" for n in (2, 3, 4, 5)], _blades
    ),
    "fig-3.27": SweepStudy(
        "Radius", "radius", [0.05, 0.06, 0.07, 0.08], ["R50", "R60", "R70", "R80"], _radius
    ),
    "fig-3.28": SweepStudy(
        "Chord", "chord", [0.010, 0.015, 0.020, 0.025, 0.030], ["c10", "c15", "c20", "c25", "c30"], _chord
    ),
    "fig-3.30": SweepStudy("Thickness", "airfoil", _THICKNESS, _THICKNESS, _thickness),
    "fig-3.31": SweepStudy("Camber", "airfoil", _CAMBER, _CAMBER, _camber),
    "fig-3.32": SweepStudy("Place of the camber", "airfoil", _POSITION, _POSITION, _position),
    "fig-3.35": SweepStudy(
        "Taper", "taper", _TAPER, ["straight", "taper2515", "taper3010", "taper3505"], _taper
    ),
    "fig-3.36": SweepStudy(
        "Twist", "twist", _degrees(0, 5, 10, 15), ["straight", "twist5", "twist10", "twist15"], _twist
    ),
}
