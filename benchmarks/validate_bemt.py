"""Blade element momentum theory beside every measurement in ../shared/data (untuned), as Markdown tables.

    python benchmarks/validate_bemt.py             # all tables, half a minute
    python benchmarks/validate_bemt.py --short     # Table 3.2 and the propellers only
    python benchmarks/validate_bemt.py --pairs     # coaxial pairs only
    python benchmarks/validate_bemt.py --record    # and write the figures to docs/figures.json

The data stays outside the project; without it the script says so and stops. What is assumed of sections that
nobody recorded stands in ``mufly.study.benchmark.rotor_cases``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
from figure_record import RECORD_HELP, make_recorder
from rotor_cases import DATA, blading_of, errors, others, propellers, table_3_2

from mufly.rotor import (
    TEXTBOOK_CORRECTIONS,
    Blading,
    Corrections,
    OperatingCondition,
    RotorSystem,
    SolverMethod,
    calibrate_blading,
    compare_measurements,
    fit_rotor,
    predict_interval,
    solve_rotor_batch,
    solve_system,
)
from mufly.study.benchmark import RotorCase
from mufly.study.benchmark.rotor_cases import T_MOTOR_AIR, load_t_motor_28
from mufly.text_table import read_text_table
from mufly.units import RPM


def _mean(v: np.ndarray) -> float:
    return 100 * float(np.nanmean(np.abs(v))) if np.isfinite(v).any() else float("nan")


def _bias(v: np.ndarray) -> float:
    return 100 * float(np.nanmean(v)) if np.isfinite(v).any() else float("nan")


def summary(
    cases: list[RotorCase], corrections: Corrections | None = None, n_crit: float = 0.1
) -> dict[str, tuple[float, float]]:
    """Mean absolute error (%) of thrust and torque of each group: mean over rotors of the mean over points."""
    found: dict[str, list[tuple[float, float]]] = {}
    for case in cases:
        t, q = errors(case, corrections, n_crit)
        found.setdefault(case.group, []).append((_mean(t), _mean(q)))
    return {k: tuple(np.mean(v, axis=0)) for k, v in found.items()}


VARIANTS: list[tuple[str, Corrections]] = [
    ("all (default)", Corrections()),
    ("plain BEMT: no finite chord, no rotation", TEXTBOOK_CORRECTIONS),
    ("without finite chord", Corrections(lifting_surface=False)),
    ("without rotation", Corrections(rotation="none")),
    ("rotation after Snel", Corrections(rotation="snel")),
    ("rotation after Chaviaropoulos, Hansen", Corrections(rotation="chaviaropoulos-hansen")),
    ("without swirl", Corrections(swirl=False)),
    ("without hub loss", Corrections(hub_loss=False)),
    ("without tip loss", Corrections(tip_loss="none")),
    ("effective radius (eq. 3.13)", Corrections(tip_loss="effective_radius")),
]


def _print_table(head: list[str], rows: list[list[str]]) -> None:
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print()


def report_table_3_2(case: RotorCase, record: Callable[..., None]) -> None:
    """Four points, untuned and calibrated on the first."""
    blading = blading_of(case)
    untuned = compare_measurements(blading, case.measured)
    tuned_blading = calibrate_blading(blading, case.measured)
    tuned = compare_measurements(tuned_blading, case.measured)
    print("## Table 3.2, untuned; and calibrated on the first point\n")
    m = case.measured
    _print_table(
        ["pitch", "rpm", "thrust N", "torque mN m", "predicted", "", "calibrated: thrust", "torque"],
        [
            [f"{np.degrees(m.pitch_rad[i]):.0f}", f"{m.speed_rad_s[i] / RPM:.0f}", f"{m.thrust_N[i]:.3f}",
             f"{1e3 * m.torque_Nm[i]:.1f}", f"{untuned.thrust_N[i]:.3f} ({100 * untuned.thrust_error[i]:+.1f} %)",
             f"{1e3 * untuned.torque_Nm[i]:.2f} ({100 * untuned.torque_error[i]:+.1f} %)",
             f"{100 * tuned.thrust_error[i]:+.1f} %", f"{100 * tuned.torque_error[i]:+.1f} %"]
            for i in range(m.thrust_N.size)
        ],
    )  # fmt: skip
    fixes = tuned_blading.corrections
    print(f"Factors: lift {fixes.lift_factor:.3f}, drag {fixes.drag_factor:.3f}\n")
    t, q = np.abs(untuned.thrust_error), np.abs(untuned.torque_error)
    record("bemt_table_mean", 100 * t.mean(), 100 * q.mean())
    record("bemt_table_worst", 100 * t.max(), 100 * q.max())


def report_propellers(cases: list[RotorCase], record: Callable[..., None]) -> None:
    """Every propeller, the worst first."""
    print("## UIUC propellers, worst first\n")
    rows = []
    for case in cases:
        t, q = errors(case)
        rows.append((_mean(t) + _mean(q), case, t, q))
    rows.sort(key=lambda row: -row[0])
    _print_table(
        ["propeller", "section", "c_T error", "bias", "c_P error", "bias"],
        [
            [case.name, Path(case.rotor.airfoil_names()[0]).stem + ("" if case.section_known else " (guess)"),
             f"{_mean(t):.1f} %", f"{_bias(t):+.1f}", f"{_mean(q):.1f} %", f"{_bias(q):+.1f}"]
            for _, case, t, q in rows
        ],
    )  # fmt: skip
    known = [r for r in rows if r[1].section_known]
    for label, key, chosen in (("all 17", "bemt_uiuc", rows), ("6 of known section", "bemt_known", known)):
        t, q = (np.mean([_mean(r[i]) for r in chosen]) for i in (2, 3))
        print(f"Mean absolute error, {label}: c_T {t:.1f} %, c_P {q:.1f} %")
        record(key, t, q)
    print()


def report_others(cases: list[RotorCase], record: Callable[..., None]) -> None:
    """Single rotors of other sizes."""
    print("## Other rotors\n")
    rows = []
    for case in cases:
        t, q = errors(case)
        torque = f"{_mean(q):.1f} %, {_bias(q):+.1f}" if np.isfinite(q).any() else "not measured"
        rows.append(
            [
                case.name,
                ", ".join(f"{100 * v:+.1f}" for v in t[:: max(1, t.size // 4)]) + " %",
                f"{_mean(t):.1f} %",
                torque,
            ]
        )
    _print_table(["rotor", "thrust errors", "mean", "torque: mean, bias"], rows)
    dji, caradonna, t_motor = (errors(case) for case in cases)
    record("bemt_dji", _mean(dji[0]))
    record("bemt_caradonna", _mean(caradonna[0]))
    record("bemt_tmotor", _mean(t_motor[0]), _mean(t_motor[1]))


def report_variants(cases: list[RotorCase]) -> None:
    """What each correction, transition and section assumption does."""
    print("## What each term does: mean absolute error of thrust / torque, %\n")
    groups = list(dict.fromkeys(c.group for c in cases))

    def line(label: str, result: dict[str, tuple[float, float]]) -> list[str]:
        return [label] + [f"{result[g][0]:.1f} / {result[g][1]:.1f}".replace(" / nan", "") for g in groups]

    rows = [line(label, summary(cases, fixes)) for label, fixes in VARIANTS]
    rows += [line(f"n_crit {n:g}", summary(cases, n_crit=n)) for n in (1.0, 4.0, 9.0)]
    _print_table(["", *groups], rows)
    print("Propellers of guessed section, with one section for all of them: c_T / c_P error, %\n")
    guessed = [c for c in cases if c.group == "UIUC micro" and not c.section_known]
    out = []
    for section in ("naca2408", "clarky", "naca4412", "naca4503", "naca5503", "naca6503", "goe417a"):
        scores = np.array([[_mean(v) for v in errors(c, section=section)] for c in guessed])
        out.append([section, f"{scores[:, 0].mean():.1f} / {scores[:, 1].mean():.1f}"])
    _print_table(["section", "11 propellers"], out)


def report_intervals(cases: list[RotorCase]) -> None:
    """How often the 90 % interval holds."""
    print("## 90 % intervals\n")
    rows = []
    count = {}
    for case in cases:
        m = case.measured
        band = predict_interval(
            case.rotor, pitch_rad=m.pitch_rad, speed_rad_s=m.speed_rad_s, air=case.air,
            section="known" if case.section_known else "guessed",
        )  # fmt: skip
        t = (m.thrust_N >= band.thrust_low_N) & (m.thrust_N <= band.thrust_high_N)
        q = ((m.torque_Nm >= band.torque_low_Nm) & (m.torque_Nm <= band.torque_high_Nm))[np.isfinite(m.torque_Nm)]
        key = f"{case.group}, section {'known' if case.section_known else 'guessed'}"
        half = 100 * np.mean((band.thrust_high_N - band.thrust_low_N) / 2 / band.thrust_N)
        half_q = 100 * np.mean((band.torque_high_Nm - band.torque_low_Nm) / 2 / band.torque_Nm)
        count.setdefault(key, []).append((t.sum(), t.size, q.sum(), q.size, half, half_q))
    for key, values in count.items():
        v = np.array(values)
        torque = f"{v[:, 2].sum():.0f} of {v[:, 3].sum():.0f}" if v[:, 3].sum() else "not measured"
        rows.append(
            [
                key,
                f"{v[:, 0].sum():.0f} of {v[:, 1].sum():.0f}",
                f"{v[:, 4].mean():.0f} %",
                torque,
                f"{v[:, 5].mean():.0f} %",
            ]
        )
    _print_table(["rotors", "thrust inside", "half width", "torque inside", "half width"], rows)
    v = np.concatenate([np.array(x) for x in count.values()])
    print(
        f"All: thrust {100 * v[:, 0].sum() / v[:, 1].sum():.0f} %, torque {100 * v[:, 2].sum() / v[:, 3].sum():.0f} %\n"
    )


def report_fits(cases: list[RotorCase], record: Callable[..., None]) -> None:
    """Sections fitted to the middle point, and to every other point; errors and intervals at the others."""
    print("## Sections fitted to a part of each sweep (`mufly rotor fit`), scored on the rest\n")
    rows, all_of = [], {"one point": [], "every other": []}
    inside = {key: np.zeros(3) for key in all_of}
    for case in cases:
        m, n = case.measured, case.measured.thrust_N.size
        row = [case.name]
        for key, seen in (("one point", np.array([n // 2])), ("every other", np.arange(0, n, 2))):
            part = m.select_points(seen)
            found = fit_rotor(case.rotor, part, section="known" if case.section_known else "guessed", air=case.air)
            rest = np.setdiff1d(np.arange(n), seen)
            thrust, torque = m.thrust_N[rest], m.torque_Nm[rest]
            band = predict_interval(
                found.rotor, pitch_rad=m.pitch_rad[rest], speed_rad_s=m.speed_rad_s[rest], air=case.air
            )
            score = _mean(band.thrust_N / thrust - 1), _mean(band.torque_Nm / torque - 1)
            all_of[key].append(score)
            held = np.abs(thrust - band.thrust_N) <= band.thrust_high_N - band.thrust_N
            held_q = np.abs(torque - band.torque_Nm) <= band.torque_high_Nm - band.torque_Nm
            inside[key] += (held.sum(), held_q.sum(), rest.size)
            first = found.fit.candidates[0]
            row += [
                f"{score[0]:.1f} / {score[1]:.1f}",
                f"{Path(first.airfoils[0]).stem} {100 * first.probability:.0f} %",
            ]
        rows.append(row)
    _print_table(["propeller", "one point: c_T / c_P error, %", "section", "every other point", "section"], rows)
    for key, scores in all_of.items():
        t, q = np.mean(scores, axis=0)
        share = 100 * inside[key][:2] / inside[key][2]
        print(f"{key}: c_T {t:.1f} %, c_P {q:.1f} %; inside the 90 % intervals {share[0]:.0f} and {share[1]:.0f} %")
        record("bemt_one_point" if key == "one point" else "bemt_half", t, q)
    print()


PAIR_METHODS: tuple[SolverMethod, ...] = ("bemt", "tubes")


def report_coaxial(case: RotorCase, record: Callable[..., None], data: Path = DATA) -> None:
    """The dissertation's pair (its vortex method) and the 28 inch pair (measured)."""
    print("## Coaxial pairs\n")
    pair, deg = blading_of(case), np.radians
    rows = []
    alone = solve_rotor_batch(pair, pitch_rad=deg(14), speed_rad_s=6000 * RPM)
    for method, h in product(PAIR_METHODS, (0.01, 0.02, 0.03, 0.04)):
        system = RotorSystem.coaxial_pair(pair, pair, spacing_m=h)
        both = solve_system(system, OperatingCondition(deg(14), 6000 * RPM), method)
        row = [f"{method}, {1e3 * h:.0f} mm", f"{both.upper.thrust_N / alone.thrust_N:.2f}",
               f"{both.lower.thrust_N / both.upper.thrust_N:.2f}",
               f"{both.lower.torque_Nm / both.upper.torque_Nm:.2f}"]  # fmt: skip
        for lower in (14, 16, 18):
            trim = solve_system(system, OperatingCondition((deg(14), deg(lower)), (6000 * RPM, None)), method)
            row.append(
                f"{trim.lower.speed_rad_s / RPM:.0f} rpm, {trim.lower.thrust_N:.3f} N, {trim.lower.power_W:.2f} W"
            )
        rows.append(row)
    rows.append(
        [
            "dissertation",
            "> 1",
            "0.55",
            "0.80",
            "6650 rpm, 0.195 N, 2.05 W",
            "5750 rpm, 0.182 N, 1.74 W",
            "5025 rpm, 0.171 N, 1.53 W",
        ]
    )
    _print_table(
        [
            "spacing",
            "upper / alone",
            "lower / upper thrust",
            "torque",
            "trim, lower 14 deg",
            "16 deg",
            "18 deg",
        ],
        rows,
    )
    rotor = load_t_motor_28(data)
    for method, n_crit in product(PAIR_METHODS, (0.1, 4.0, 9.0)):
        label = f"28 inch pair, {method}, n_crit {n_crit:g}"
        mean = _report_28_inch(blading_of(rotor, n_crit=n_crit), label, data, method)
        if (method, n_crit) == ("tubes", 0.1):
            record("tubes_upper", *mean[:2])
            record("tubes_lower", *mean[2:4])


def _report_28_inch(big: Blading, label: str, data: Path, method: SolverMethod) -> np.ndarray:
    """Print a table; return mean absolute errors (%): upper thrust, torque, lower ones, both together."""
    found, system = [], RotorSystem.coaxial_pair(big, big, spacing_m=0.115)
    for rpm_l, t_l, q_l, _, t_u, q_u, _, rpm_u in read_text_table(data / "tmotor28_coaxial.csv").read_matrix():
        r = solve_system(system, OperatingCondition(0.0, (rpm_u * RPM, rpm_l * RPM), air=T_MOTOR_AIR), method)
        found.append([r.upper.thrust_N / t_u, r.upper.torque_Nm / q_u, r.lower.thrust_N / t_l, r.lower.torque_Nm / q_l,
                      r.thrust_N / (t_u + t_l), (r.upper.torque_Nm + r.lower.torque_Nm) / (q_u + q_l)])  # fmt: skip
    error = 100 * (np.array(found) - 1)
    _print_table(
        [label, "upper T", "upper Q", "lower T", "lower Q", "T together", "Q together"],
        [
            ["bias"] + [f"{v:+.1f} %" for v in error.mean(axis=0)],
            ["mean error"] + [f"{v:.1f} %" for v in np.abs(error).mean(axis=0)],
        ],
    )
    return np.abs(error).mean(axis=0)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--pairs", action="store_true")
    parser.add_argument("--record", action="store_true", help=RECORD_HELP)
    args = parser.parse_args()
    record = make_recorder(args.record)
    if not DATA.is_dir():
        sys.exit("validate_bemt: the measurements (../shared/data/aero) are not here; nothing to compare with")
    if args.pairs:
        report_coaxial(table_3_2(), record)
        return
    thesis, props = table_3_2(), propellers()
    report_table_3_2(thesis, record)
    report_propellers(props, record)
    if args.short:
        return
    rest = others()
    report_others(rest, record)
    report_variants([thesis, *props, *rest])
    report_intervals([thesis, *props, *rest])
    report_fits(props, record)
    report_coaxial(thesis, record)


if __name__ == "__main__":
    main()
