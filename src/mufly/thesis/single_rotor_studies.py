"""Studies of one rotor, Secs 3.4.1 to 3.4.4: thrust per electrical power over the pitch at 0.4 N, one parameter varied.

All have the standard blade (NACA4412, R 60 mm, chord 20 mm) on muFly's motor at its nominal 7.2 V. The gear is adapted
to every case so that full voltage gives exactly 0.4 N (``drive.gear``). Table 3.3 supports this assumption: with blade
element theory as in the dissertation, its four best airfoils agree within 3 %. Each study is run with two models
(``study.BEMT_MODELS``): the recommended one, and the dissertation's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.drive import RotorLoad, find_gear_optima, load_drive, make_coefficient_load, sweep_gear_ratio
from mufly.rotor import Rotor, load_rotor
from mufly.study import (
    BEMT_MODELS,
    TABLE_3_3_AIRFOILS,
    StudySetup,
    list_thesis_airfoils,
    rank_airfoils,
    sweep_parameters,
)
from mufly.study.sweeps import ProgressCallback
from mufly.thesis.claims import CLAIMS, TABLE_3_3_VALUES, Verdict, judge
from mufly.vehicle import load_vehicle

Array = NDArray[np.float64]
JudgeFunction = Callable[[str, Array, Array], list[Verdict]]

STUDY_THRUST_N = 0.4
PITCH_SETTINGS_DEG = tuple(float(p) for p in range(6, 21))
RANKED_OUTPUT_NAME = "thrust_per_power_N_W"


@dataclass(frozen=True)
class SweepStudy:
    """Study of a rotor for one figure: the varied parameter, its values, and the function that judges the results.

    Attributes
    ----------
    title : str
    parameter : str
        Parameter that is varied.
    values : sequence
        Values in SI units, in the order of the figure's legend.
    labels : sequence of str
        Labels of the figure's legend.
    judge : callable
        ``judge(model, pitch_deg (p,), thrust_per_power (values, p))`` returns verdicts.
    """

    title: str
    parameter: str
    values: Sequence[float | str]
    labels: Sequence[str]
    judge: JudgeFunction


def make_standard_setup(model: str, rotor: str | Rotor = "naca4412-r60-c20") -> StudySetup:
    """Return the study of a blade on muFly's drive at a thrust of 0.4 N, with the gear ratio adapted to it.

    The adapted ratio is that of least power at which the drive holds the speed at full voltage.
    """
    return StudySetup(
        load_rotor(rotor) if isinstance(rotor, str) else rotor,
        load_drive("mufly"),
        {"thrust": STUDY_THRUST_N, "gear": "adapted"},
        corrections=BEMT_MODELS[model],
        with_outside_share=False,
    )


def compute_sweep_and_verdicts(study: SweepStudy, model: str) -> tuple[xr.Dataset, list[Verdict]]:
    """Compute the figure of a sweep with one model, with the verdicts on its claims.

    Thesis: Figs 3.26 to 3.28, 3.30 to 3.32, 3.35, 3.36.
    """
    vary: Mapping[str, Sequence[float | str]] = {
        study.parameter: list(study.values),
        "pitch": [float(p) for p in np.radians(PITCH_SETTINGS_DEG)],
    }
    data = sweep_parameters(make_standard_setup(model), vary)
    data = data.assign_coords(label=(study.parameter, list(study.labels)))
    return data, study.judge(model, np.array(PITCH_SETTINGS_DEG), data[RANKED_OUTPUT_NAME].values)


def _find_best_over_pitch(values: Array) -> Array:
    """Return the greatest finite value of each row over the pitch (axis 1); nan where there is none."""
    filled = np.where(np.isfinite(values), values, -np.inf).max(axis=1)
    return np.where(np.isfinite(filled), filled, np.nan)


def _pitch_at_best(pitch: Array, values: Array) -> Array:
    return pitch[np.where(np.isfinite(values), values, -np.inf).argmax(axis=1)]


def _gain_percent(values: Array, of: int, over: int) -> float:
    best = _find_best_over_pitch(values)
    return float(100.0 * (best[of] / best[over] - 1.0))


def _format_numbers(values: Array, form: str = "{:.4f}") -> str:
    return ", ".join(form.format(v) for v in values)


def _judge_blade_count(model: str, pitch: Array, v: Array) -> list[Verdict]:
    others = np.nanmax(v[1:], axis=0)
    ahead = v[0] >= others
    until = float(pitch[ahead][-1]) if ahead.all() else float(pitch[np.argmin(ahead)] - (pitch[1] - pitch[0]))
    high = pitch > 16.0
    more = 100 * float(np.mean(np.maximum(v[1], v[2])[high] / v[0][high]) - 1)
    *fewer, most = v
    worst = bool(np.all(most <= np.min(fewer, axis=0) + 1e-12))
    return [
        judge(
            "blades-two",
            model,
            f"two blades lead up to {until:g} deg" if ahead[0] else "two blades lead at no low pitch",
            until=until,
            holds=ahead[0],
        ),
        judge("blades-more", model, f"the better of three and four is {more:+.1f} % there", more=more),
        judge(
            "blades-five",
            model,
            f"bests {_format_numbers(_find_best_over_pitch(v))} N/W for 2 to 5 blades",
            holds=worst,
        ),
    ]


def _judge_radius(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best, total = _find_best_over_pitch(v), _gain_percent(v, 3, 0)
    steps = ", ".join(f"{100 * (b / a - 1):+.0f}" for a, b in pairwise(best))
    # At constant figure of merit the ideal power falls with 1/R: 60 % more thrust per power from 50 to 80 mm.
    ours = f"bests {_format_numbers(best)} N/W for R 50 to 80 mm"
    return [
        judge("radius", model, ours, best=np.diff(best)),
        judge(
            "radius-size",
            model,
            f"{total:+.0f} % ({steps} % a step of 10 mm; momentum theory alone: +60 %)",
            total=abs(total - CLAIMS["radius-size"].value),
        ),
    ]


def _judge_chord(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best, at = _find_best_over_pitch(v), _pitch_at_best(pitch, v)
    spread = 100 * float(best[2:].max() / best[2:].min() - 1)
    return [
        judge(
            "chord-best", model, f"bests {_format_numbers(best)} N/W for 10 to 30 mm", best_argmax=int(best.argmax())
        ),
        judge("chord-flat", model, f"{spread:.1f} % between 20, 25 and 30 mm", spread=spread),
        judge(
            "chord-pitch", model, f"best pitch {_format_numbers(at, '{:g}')} deg", at=np.diff(at), holds=at[-1] > at[0]
        ),
    ]


def _judge_thickness(model: str, pitch: Array, v: Array) -> list[Verdict]:
    gain = _gain_percent(v, 0, 3)
    ours = f"bests {_format_numbers(_find_best_over_pitch(v))} N/W for 6 to 15 %, thinnest over thickest {gain:+.1f} %"
    return [judge("thickness", model, ours, gain=gain)]


def _judge_camber(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best = _find_best_over_pitch(v)
    ours = f"bests {_format_numbers(best)} N/W for 0, 2, 4 and 9 %"
    return [judge("camber", model, ours, best_argmax=int(best.argmax()))]


def _judge_camber_position(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best = _find_best_over_pitch(v)
    spread = 100 * float(best.max() / best.min() - 1)
    ours = f"bests {_format_numbers(best)} N/W for 20, 40, 70 and 90 %, spread {spread:.1f} %"
    return [judge("camber-position", model, ours, spread=spread)]


def _judge_taper(model: str, pitch: Array, v: Array) -> list[Verdict]:
    gain = _gain_percent(v, 3, 0)
    ours = f"bests {_format_numbers(_find_best_over_pitch(v))} N/W from straight to 35-05, {gain:+.1f} %"
    return [judge("taper", model, ours, gain=gain)]


def _judge_twist(model: str, pitch: Array, v: Array) -> list[Verdict]:
    best, at = _find_best_over_pitch(v), _pitch_at_best(pitch, v)
    ours = f"bests {_format_numbers(best)} N/W for 0 to 15 deg, {_gain_percent(v, 3, 0):+.1f} %"
    falls = bool(np.all(np.diff(at) <= 0) and at[-1] < at[0])
    return [
        judge("twist", model, ours, best_argmax=int(best.argmax())),
        judge("twist-pitch", model, f"best pitch {_format_numbers(at, '{:g}')} deg (at the tip)", holds=falls),
    ]


_THICKNESS_AIRFOILS = ["naca4406", "naca4409", "naca4412", "naca4415"]
_CAMBER_AIRFOILS = ["naca0012", "naca2412", "naca4412", "naca9412"]
_CAMBER_POSITION_AIRFOILS = ["naca4212", "naca4412", "naca4712", "naca4912"]
_TAPER_RATIOS = [1.0, 15 / 25, 10 / 30, 5 / 35]  # tip over hub chord

SWEEP_STUDIES: dict[str, SweepStudy] = {
    "fig-3.26": SweepStudy(
        "Number of blades",
        "blades",
        [2.0, 3.0, 4.0, 5.0],
        [f"{n} blades" for n in (2, 3, 4, 5)],
        _judge_blade_count,
    ),
    "fig-3.27": SweepStudy("Radius", "radius", [0.05, 0.06, 0.07, 0.08], ["R50", "R60", "R70", "R80"], _judge_radius),
    "fig-3.28": SweepStudy(
        "Chord",
        "chord",
        [0.010, 0.015, 0.020, 0.025, 0.030],
        ["c10", "c15", "c20", "c25", "c30"],
        _judge_chord,
    ),
    "fig-3.30": SweepStudy("Thickness", "airfoil", _THICKNESS_AIRFOILS, _THICKNESS_AIRFOILS, _judge_thickness),
    "fig-3.31": SweepStudy("Camber", "airfoil", _CAMBER_AIRFOILS, _CAMBER_AIRFOILS, _judge_camber),
    "fig-3.32": SweepStudy(
        "Place of the camber",
        "airfoil",
        _CAMBER_POSITION_AIRFOILS,
        _CAMBER_POSITION_AIRFOILS,
        _judge_camber_position,
    ),
    "fig-3.35": SweepStudy(
        "Taper", "taper", _TAPER_RATIOS, ["straight", "taper2515", "taper3010", "taper3505"], _judge_taper
    ),
    "fig-3.36": SweepStudy(
        "Twist",
        "twist",
        [float(x) for x in np.radians((0, 5, 10, 15))],
        ["straight", "twist5", "twist10", "twist15"],
        _judge_twist,
    ),
}


# ----------------------------------------------------------------------------
# Fig. 3.7, gear ratios of muFly, and Fig. 3.25, coefficients over speed (Secs 3.1.4, 3.3.4).
#
# Rotor and voltage of Fig. 3.7 are not stated. The figure is computed for both rotors of prototype 1.1 with the
# constant coefficients of Table 5.3, at the nominal 7.2 V and at the 6.4 V of the dissertation's linear model
# (docs/thesis/thesis-errata.md, point 6). With constant coefficients the optimal ratios grow with the cube root of the
# voltage.


GEAR_RATIOS = np.round(np.arange(0.5, 8.01, 0.1), 3)
REQUIRED_THRUST_N = 0.6
SUPPLY_VOLTAGES_V = (7.2, 6.4)
ROTOR_NAMES = ("upper", "lower")


def compute_vehicle_rotor_load(which: str) -> RotorLoad:
    """Return thrust and torque over speed of prototype 1.1's ``upper`` or ``lower`` rotor, by Table 5.3."""
    v = load_vehicle("mufly-1.1")
    one = v.rotors.upper if which == "upper" else v.rotors.lower
    return make_coefficient_load(
        float(one.thrust_coefficient), float(one.torque_coefficient), radius_m=float(v.rotors.radius),
        density_kg_m3=float(v.air.density),
    )  # fmt: skip


def compute_gear_ratio_study() -> tuple[xr.Dataset, list[Verdict]]:
    """Compute Fig. 3.7 for both rotors; dimensions are voltage, rotor and gear ratio."""
    drive, verdicts, sheets = load_drive("mufly"), [], []
    for volt in SUPPLY_VOLTAGES_V:
        loads = [compute_vehicle_rotor_load(which) for which in ROTOR_NAMES]
        curves = [sweep_gear_ratio(drive, load, GEAR_RATIOS, supply_V=volt) for load in loads]
        best = [find_gear_optima(drive, load, thrust_N=REQUIRED_THRUST_N, supply_V=volt) for load in loads]
        at_two = [float(curve.thrust_N.sel(gear_ratio=2.0)) for curve in curves]
        sheets.append(xr.concat(curves, xr.Variable("rotor", list(ROTOR_NAMES)), combine_attrs="drop_conflicts"))
        for key, field, note in (
            ("gear-power", "mechanical_power", ""),
            ("gear-efficiency", "efficiency", ""),
            ("gear-thrust-per-power", "thrust_per_power", ""),
            (
                "gear-thrust",
                "for_required_thrust",
                f"; at a ratio of 2 they give {at_two[0]:.2f} and {at_two[1]:.2f} N",
            ),
        ):
            ours = [float(getattr(b, field)) for b in best]
            text = f"{ours[0]:.2f} with the upper rotor, {ours[1]:.2f} with the lower{note}"
            verdicts.append(judge(key, f"constant coefficients, {volt:g} V", text, ratios=ours))
    data = xr.concat(
        sheets,
        xr.Variable("voltage", list(SUPPLY_VOLTAGES_V), {"units": "V"}),
        combine_attrs="drop_conflicts",
    )
    return data, verdicts


def compute_coefficients_over_speed(model: str) -> tuple[xr.Dataset, list[Verdict]]:
    """Compute Fig. 3.25, thrust and torque coefficient of the standard blade over the speed at four pitch settings.

    Thesis: Fig. 3.25.
    """
    setup = StudySetup(load_rotor("naca4412-r60-c20"), corrections=BEMT_MODELS[model], with_outside_share=False)
    speed = [float(x) * math.pi / 30 for x in np.arange(3000, 7001, 500)]
    data = sweep_parameters(setup, {"pitch": [math.radians(p) for p in (12, 14, 16, 18)], "speed": speed})
    change_q = 100 * (data.c_Q.values[:, -1] / data.c_Q.values[:, 0] - 1)
    change_t = 100 * (data.c_T.values[:, -1] / data.c_T.values[:, 0] - 1)

    def format_changes(change: np.ndarray) -> str:
        return f"{', '.join(f'{c:+.1f}' for c in change)} % from 3 000 to 7 000 rpm at 12, 14, 16, 18 deg"

    return data, [
        judge("coefficients-torque", model, format_changes(change_q), change_q=np.abs(change_q)),
        judge(
            "coefficients-thrust",
            model,
            format_changes(change_t),
            change_t=change_t,
            holds=np.all(np.abs(change_t) > np.abs(change_q)),
        ),
    ]


# ----------------------------------------------------------------------------
# Table 3.3 and Figs 3.29, 3.33 and 3.34: 247 airfoils on the standard blade, and the sections that are drawn.
#
# ``study.sweeps`` describes the choice of the 247; only the eight that the dissertation names are certain.


SECTION_FIGURES: dict[str, tuple[str, Sequence[str]]] = {
    "fig-3.29": ("Four-digit NACA sections", ["naca0012", "naca4412", "naca9412", "naca9712"]),
    "fig-3.33": ("The four best airfoils of Table 3.3", ["goe394", "goe342", "gm15sm", "goe142"]),
    "fig-3.34": ("The four worst airfoils of Table 3.3", ["naca6415", "n64015", "naca25016", "lnv109a"]),
}


def compute_airfoil_ranking(model: str, progress: ProgressCallback | None = None) -> tuple[xr.Dataset, list[Verdict]]:
    """Rank the 247 airfoils with one model, with the verdicts on Table 3.3.

    Thesis: Table 3.3.
    """
    pitch = [float(p) for p in np.radians(PITCH_SETTINGS_DEG)]
    ranking = rank_airfoils(make_standard_setup(model), list_thesis_airfoils(), pitch, progress=progress)
    n = ranking.sizes["airfoil"]

    def ranking_row(name: str) -> tuple[int, float, float]:
        one = ranking.sel(airfoil=TABLE_3_3_AIRFOILS[name])
        return int(one["rank"]), float(one["thrust_per_power_N_W"]), float(one["electrical_power_W"])

    def describe_rankings(names: Sequence[str]) -> str:
        parts = []
        for name in names:
            place, value, _ = ranking_row(name)
            change = 100 * (value / TABLE_3_3_VALUES[name][1] - 1)
            parts.append(f"{name} rank {place}, {value:.4f} N/W ({change:+.1f} %)")
        return "; ".join(parts)

    names = list(TABLE_3_3_VALUES)
    top, bottom = names[:4], names[-4:]
    worst_power, best_power = ranking_row("NACA6415")[2], ranking_row(names[0])[2]
    return ranking, [
        judge("airfoils-top", model, describe_rankings(top), holds=all(ranking_row(k)[0] <= n // 10 for k in top)),
        judge(
            "airfoils-bottom",
            model,
            describe_rankings(bottom),
            holds=all(ranking_row(k)[0] > n - n // 10 for k in bottom),
        ),
        judge(
            "airfoils-spread",
            model,
            f"{best_power:.2f} W and {worst_power:.2f} W: {worst_power - best_power:.2f} W more",
            worst_power=abs(worst_power - best_power - CLAIMS["airfoils-spread"].value),
        ),
    ]


OUR_CFD_BLADE_FORMS: dict[str, dict[str, tuple[float, float]]] = {
    "medium": {
        "square": (0.22150, 2.6511),
        "thesis-1": (0.20880, 2.4214),
        "thesis-2": (0.18136, 2.1507),
        "gurney 1 %": (0.24876, 3.0490),
    },
    "coarse": {
        "square": (0.2190, 2.663),
        "winglet-1": (0.2263, 3.148),
        "winglet-2": (0.2617, 3.946),
        "winglet-3": (0.1671, 2.154),
    },
}
"""Thrust (N) and torque (mN m) by mesh, the finest first: 16 degrees, 5 000 rpm, laminar, settled.

docs/log/2026-11-28-cfd-tips.md has the cases.
"""


def compute_blade_form_gain_percent(name: str) -> float:
    """Return the gain (%) in T^1.5/P, thrust per power at a given thrust, of a blade form over the square blade.

    It is the gain on the finest mesh of the form.
    """
    forms = next(mesh for mesh in OUR_CFD_BLADE_FORMS.values() if name in mesh)
    (t, q), (t0, q0) = forms[name], forms["square"]
    return 100.0 * ((t / t0) ** 1.5 * q0 / q - 1.0)


def judge_blade_forms(names: tuple[str, ...], key: str) -> Verdict:
    """Return the verdict whether any blade form is better than the square blade beyond the uncertainty of the mesh.

    Parameters
    ----------
    names : tuple of str
        Names of :data:`OUR_CFD_BLADE_FORMS`.
    key : str
        Key of the verdict; its limit is the uncertainty of the difference from the square blade due to the mesh.
    """
    gains = [compute_blade_form_gain_percent(name) for name in names]
    return judge(
        key,
        "CFD, laminar (docs/explanation/cfd.md)",
        ", ".join(f"{name} {g:+.1f} %" for name, g in zip(names, gains, strict=True))
        + " of T^1.5/P at 16 degrees and 5 000 rpm",
        gain=gains,
    )
