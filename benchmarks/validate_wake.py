"""The wake method beside every single rotor in ../shared/data, untuned, as Markdown tables.

    python benchmarks/validate_wake.py                      # all: 15 minutes on two idle cores
    python benchmarks/validate_wake.py table others         # Table 3.2; the three larger rotors
    python benchmarks/validate_wake.py --keep solved        # a stopped run goes on where it was
    python benchmarks/validate_wake.py --record             # and write the figures to docs/figures.json

Coaxial pairs: validate_wake_pairs.py. What is assumed of the rotors: mufly.study.benchmark.rotor_cases, for both
methods. Transition: n_crit 0.1 is the default everywhere; the other values show what it does. For the 28 inch rotor
n_crit 9 is what clean air at Re 1e5 to 3e5 suggests; all three values had been looked at before it was named.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from figure_record import make_recorder
from rotor_cases import DATA, blading_of, others, propellers, table_3_2
from wake_cases import Answer, Solver, arguments, farewell, percent, table

from mufly.rotor import OperatingCondition, RotorSystem, solve_rotor_batch, solve_system
from mufly.rotor.wake import WakeSettings, momentum_thrust
from mufly.text_table import read_text_table
from mufly.units import RPM

OFFSET_DEG = 0.8  # pitch error of the bench that would explain Table 3.2; shown, never applied


def report_table_3_2(solver: Solver, record: Callable[..., None]) -> None:
    """Four points: default settings, the dissertation's four CFD models, and what the open choices do."""
    case = table_3_2()
    m = case.measured
    cfd = read_text_table(DATA / "thesis_table_3_2.csv").read_matrix()[:, 4:]
    n = m.thrust_N.size

    def points(offset_deg: float = 0.0, **kw: object) -> list[Answer]:
        return [
            solver.single(case, m.pitch_rad[i] + np.radians(offset_deg), m.speed_rad_s[i], **kw)  # type: ignore[arg-type]
            for i in range(n)
        ]

    ours = points()
    bemt = solve_rotor_batch(blading_of(case), pitch_rad=m.pitch_rad, speed_rad_s=m.speed_rad_s)
    for label, unit, scale, measured, mine, quick, first in (
        ("thrust", "N", 1.0, m.thrust_N, [a.thrust[0] for a in ours], bemt.thrust_N, 0),
        ("torque", "mN m", 1e3, m.torque_Nm, [a.torque[0] for a in ours], bemt.torque_Nm, 1),
    ):
        table(
            f"Table 3.2, {label}: deviation from the measurement, %",
            ["pitch, rpm", f"measured {unit}", f"wake {unit}", "wake", "BEMT", "CFD laminar", "k-epsilon", "k-omega",
             "BSL", "wake / mean of the first three CFD"],
            [
                [f"{np.degrees(m.pitch_rad[i]):.0f}, {m.speed_rad_s[i] / RPM:.0f}", f"{scale * measured[i]:.4g}",
                 f"{scale * mine[i]:.4g}{ours[i].mark()}", percent(mine[i], measured[i]),
                 percent(quick[i], measured[i]), *(percent(v, measured[i]) for v in cfd[i, first::2]),
                 percent(mine[i], float(np.mean(cfd[i, first:6:2])))]
                for i in range(n)
            ],
        )  # fmt: skip

    worst = [
        max(abs(100 * (v / w - 1)) for v, w in zip(found, measured, strict=True))
        for found, measured in (([a.thrust[0] for a in ours], m.thrust_N), ([a.torque[0] for a in ours], m.torque_Nm))
    ]
    record("wake_table", *worst)

    def row(label: str, found: list[Answer]) -> list[str]:
        t = [percent(a.thrust[0], v) + a.mark() for a, v in zip(found, m.thrust_N, strict=True)]
        q = [percent(a.torque[0], v) for a, v in zip(found, m.torque_Nm, strict=True)]
        return [label, *t, *q]

    rows = [row("default", ours)]
    rows += [row(f"n_crit {x:g}", points(n_crit=x)) for x in (1.0, 4.0, 9.0)]
    rows += [row(f"hub cut-out {x:g} R", points(cutout=x)) for x in (0.1, 0.2)]
    rows += [
        row("inviscid", points(settings=WakeSettings(inviscid=True))),
        row("prescribed wake", points(settings=WakeSettings(model="prescribed"))),
        row(f"pitch {OFFSET_DEG:+.1f} deg (not applied)", points(OFFSET_DEG)),
    ]
    table("Table 3.2: what the choices do, deviation in thrust (four points), in torque, %",
          ["", *(["thrust"] + [""] * 3), *(["torque"] + [""] * 3)], rows)  # fmt: skip


def report_others(solver: Solver, record: Callable[..., None]) -> None:
    """Caradonna and Tung, DJI 9443, the 28 inch rotor alone, at three transitions."""
    rows = []
    for case in others():
        m = case.measured
        size = m.thrust_N.size
        chosen = np.arange(size) if size < 6 else np.linspace(0, size - 1, 5).round().astype(int)
        for n_crit in (0.1, 4.0, 9.0):
            found = [solver.single(case, m.pitch_rad[i], m.speed_rad_s[i], n_crit=n_crit) for i in chosen]
            t = np.array([a.thrust[0] for a in found]) / m.thrust_N[chosen] - 1
            q = np.array([a.torque[0] for a in found]) / m.torque_Nm[chosen] - 1
            quick = solve_rotor_batch(
                blading_of(case, n_crit=n_crit), pitch_rad=m.pitch_rad[chosen],
                speed_rad_s=m.speed_rad_s[chosen], air=case.air,
            ).thrust_N / m.thrust_N[chosen] - 1  # fmt: skip
            known = bool(np.isfinite(q).all())
            if n_crit == 0.1:
                _record_other(case.name, 100 * np.abs(t), 100 * np.abs(q), record)
            rows.append([
                case.name, f"{n_crit:g}",
                ", ".join(f"{100 * v:+.1f}{a.mark()}" for v, a in zip(t, found, strict=True)),
                f"{100 * np.abs(t).mean():.1f}",
                ", ".join(f"{100 * v:+.1f}" for v in q) if known else "not measured",
                f"{100 * np.abs(q).mean():.1f}" if known else "",
                ", ".join(f"{100 * v:+.1f}" for v in quick),
            ])  # fmt: skip
    table(
        "Other single rotors, %",
        ["rotor", "n_crit", "thrust", "mean", "torque", "mean", "thrust by BEMT"],
        rows,
    )


def _record_other(name: str, thrust: np.ndarray, torque: np.ndarray, record: Callable[..., None]) -> None:
    """Record the sizes of a rotor's errors (%)."""
    if name == "caradonna-tung":
        record("wake_caradonna", thrust.max())
    elif name.startswith("dji"):
        record("wake_dji", thrust[0])
    else:
        record("wake_tmotor", thrust[thrust.size // 2], torque[torque.size // 2])


def report_propellers(solver: Solver, record: Callable[..., None]) -> None:
    """Seventeen propellers at their least, middle and greatest speed, beside BEMT at the same points."""
    rows, scores, known = [], [], []
    for case in propellers():
        m = case.measured
        chosen = np.array([0, m.thrust_N.size // 2, m.thrust_N.size - 1])
        found = [solver.single(case, m.pitch_rad[i], m.speed_rad_s[i]) for i in chosen]
        quick = solve_rotor_batch(
            blading_of(case), pitch_rad=m.pitch_rad[chosen], speed_rad_s=m.speed_rad_s[chosen], air=case.air
        )
        t, q = m.thrust_N[chosen], m.torque_Nm[chosen]
        good = np.array([a.converged for a in found])
        errors = [
            100 * (np.array(v) / w - 1)[good]
            for v, w in (
                ([a.thrust[0] for a in found], t), (quick.thrust_N, t),
                ([a.torque[0] for a in found], q), (quick.torque_Nm, q),
            )
        ]  # fmt: skip
        section = Path(case.rotor.airfoil_names()[0]).stem + ("" if case.section_known else " (guess)")
        cells = [f"{np.abs(e).mean():.1f} ({e.mean():+.1f})" if e.size else "none" for e in errors]
        rows.append([case.name, section, *cells, f"{good.sum()} of {good.size}"])
        if good.any():
            scores.append([np.abs(e).mean() for e in errors])
            known.append(case.section_known)
    table(
        "UIUC propellers, three speeds each: mean absolute deviation (bias), %",
        ["propeller", "section", "c_T wake", "c_T BEMT", "c_P wake", "c_P BEMT", "converged"], rows,
    )  # fmt: skip
    every, mask = np.array(scores), np.array(known)
    for label, part in (("all", every), ("section known", every[mask]), ("section guessed", every[~mask])):
        a, b, c, d = part.mean(axis=0)
        if label == "all":
            record("wake_uiuc", a, c)
        print(f"{label}, {len(part)} propellers: c_T {a:.1f} (BEMT {b:.1f}), c_P {c:.1f} (BEMT {d:.1f})")
    print()


def report_momentum() -> None:
    """Thrust from the momentum through planes below the disc, over the loads' without profile drag's share."""
    rows = []
    heights = (0.3, 0.5, 0.75, 1.0)
    dji, slender, *_ = others()
    for case, i in ((table_3_2(), 0), (table_3_2(), 3), (slender, 1), (slender, 2), (dji, 0)):
        m, air = case.measured, case.air
        point = OperatingCondition(float(m.pitch_rad[i]), float(m.speed_rad_s[i]), air=air)
        found = solve_system(RotorSystem.single_rotor(blading_of(case)), point, "wake")
        r = found.rotors[0]
        wind = r.reynolds * air.viscosity_Pa_s / air.density_kg_m3 / r.chord_m
        drag = 0.5 * air.density_kg_m3 * wind**2 * r.chord_m * r.cd * np.sin(r.phi_rad) * r.dr_m
        lift = r.thrust_N + case.rotor.blades * drag.sum()
        through = [momentum_thrust(found, -h * case.rotor.radius_m, reach=10.0) for h in heights]
        label = f"{case.name}, {np.degrees(m.pitch_rad[i]):.0f} deg, {m.speed_rad_s[i] / RPM:.0f} rpm"
        rows.append([label, *(percent(v, lift) for v in through), f"{found.settings.core_limit:g} R"])
    table(
        "Momentum through a plane below the disc, over the thrust: deviation, %",
        ["rotor", *(f"{h:g} R below" for h in heights), "old cores"],
        rows,
    )


def report_stations() -> None:
    """Caradonna and Tung: thrust as the report can have had it, from five stations, beside the whole blade's."""
    case = next(c for c in others() if c.name == "caradonna-tung")
    at, m, air = np.array([0.5, 0.68, 0.8, 0.89, 0.96]), case.measured, case.air
    measured = {5: (0.1070, 0.1241, 0.1517, 0.1181, 0.1519), 8: (0.2343, 0.2815, 0.2886, 0.3143, 0.2883)}

    def from_stations(cl: np.ndarray) -> float:
        """c_T over solidity / 2: straight lines in c_l r^2, 0 at 0.2 R and at the tip."""
        return float(np.trapezoid([0, *(cl * at**2), 0], [0.2, *at, 1.0]))

    rows = []
    for pitch, speed, thrust in zip(m.pitch_rad, m.speed_rad_s, m.thrust_N, strict=True):
        found = solve_system(
            RotorSystem.single_rotor(blading_of(case)),
            OperatingCondition(float(pitch), float(speed), air=air),
            "wake",
        )
        r, big = found.rotors[0], case.rotor.radius_m
        q = 0.5 * air.density_kg_m3 * (speed * r.r_m) ** 2 * r.chord_m
        cl = np.interp(at, r.r_m / big, r.dT_N / r.dr_m / q / case.rotor.blades)
        ct = thrust / (air.density_kg_m3 * np.pi * big**4 * speed**2)
        half = case.rotor.blades * float(r.chord_m[0]) / (2 * np.pi * big)
        told = measured.get(round(float(np.degrees(pitch))))
        rows.append([
            f"{np.degrees(pitch):.0f}", percent(r.thrust_N, thrust), percent(half * from_stations(cl), ct),
            percent(half * from_stations(np.array(told)), ct) if told else "",
            *(f"{v:.3f}" for v in cl),
        ])  # fmt: skip
    table(
        "Caradonna and Tung: deviation from the published c_T, %; lift coefficients of the wake",
        ["pitch", "whole blade", "five stations", "the measured five", *(f"{x:g} R" for x in at)], rows,
    )  # fmt: skip


def main() -> None:
    """Print the tables."""
    args = arguments(__doc__, ("table", "others", "stations", "propellers", "momentum"))
    if not DATA.is_dir():
        sys.exit("validate_wake: the measurements (../shared/data/aero) are not here; nothing to compare with")
    solver, record = Solver(args.keep), make_recorder(args.record)
    if "table" in args.parts:
        report_table_3_2(solver, record)
    if "others" in args.parts:
        report_others(solver, record)
    if "stations" in args.parts:
        report_stations()
    if "propellers" in args.parts:
        report_propellers(solver, record)
    if "momentum" in args.parts:
        report_momentum()
    farewell(solver)


if __name__ == "__main__":
    main()
