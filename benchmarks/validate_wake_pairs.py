"""Coaxial pairs by the wake method: the dissertation's (Sec. 3.4.7), the measured 28 inch pair, and coaxial BEMT.

python benchmarks/validate_wake_pairs.py                 # all: 15 minutes on two idle cores
python benchmarks/validate_wake_pairs.py thesis          # the dissertation's pair and its facts
python benchmarks/validate_wake_pairs.py big             # 28 inch pair, measured, per rotor
python benchmarks/validate_wake_pairs.py bemt            # coaxial BEMT against the wake over speed ratio and spacing
python benchmarks/validate_wake_pairs.py spacing         # spacings of 0.1 to 1 diameter: wake, tubes, BEMT
python benchmarks/validate_wake_pairs.py --keep solved   # a stopped run goes on where it was
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
from figure_record import make_recorder
from rotor_cases import DATA, blading_of, table_3_2
from wake_cases import Answer, Solver, arguments, farewell, percent, table

from mufly.rotor import Blading, OperatingCondition, RotorSystem, SystemSolution, solve_system
from mufly.rotor.wake import WakeSettings
from mufly.study.benchmark.rotor_cases import BENCHMARK_AIR, T_MOTOR_AIR, load_t_motor_28
from mufly.text_table import read_text_table
from mufly.units import RPM

PITCH = float(np.radians(14))
TABLE_3_4 = ((14, 6650, 0.1949, 2.0531), (16, 5750, 0.1820, 1.7413), (18, 5025, 0.1709, 1.5286))
# Falling: below 0.8 or so the lower rotor hardly lifts and its wake stays near.
RATIOS = (1.4, 1.2, 1.0, 0.85, 0.7)
SPACINGS = (0.01, 0.02, 0.03, 0.04)


def _power(answer: Answer, k: int) -> float:
    return answer.torque[k] * answer.speed[k]


def _ratio(answer: Answer, what: str) -> float:
    upper, lower = getattr(answer, what)
    return float(lower / upper)


def report_thesis(solver: Solver, record: Callable[..., None]) -> None:
    """Equal speeds, torque balance, spacing; NACA 0012, 14 degrees, R 60 mm, chord 20 mm."""
    case = table_3_2()
    pair = blading_of(case)
    rows = []
    for rpm in (3000, 6000, 7000):
        alone = solver.single(case, PITCH, rpm * RPM)
        both = solver.pair(
            "thesis",
            pair,
            spacing=0.02,
            pitch=(PITCH, PITCH),
            speed=(rpm * RPM, rpm * RPM),
            air=BENCHMARK_AIR,
        )
        if rpm == 6000:
            record("wake_pair_ratio", _ratio(both, "thrust"), _ratio(both, "torque"))
        rows.append([
            f"{rpm}", f"{alone.thrust[0]:.4f}", f"{both.thrust[0]:.4f}{both.mark()}", f"{both.thrust[1]:.4f}",
            percent(both.thrust[0], alone.thrust[0]), percent(both.torque[0], alone.torque[0]),
            f"{_ratio(both, 'thrust'):.3f}", f"{_ratio(both, 'torque'):.3f}",
        ])  # fmt: skip
    rows.append(["dissertation", "", "", "", "slightly above 0", "slightly above 0", "0.55", "0.80"])
    table("The dissertation's pair at equal speeds, spacing 20 mm",
          ["rpm", "alone N", "upper N", "lower N", "upper over alone: thrust %", "torque %", "lower / upper: thrust",
           "torque"], rows)  # fmt: skip
    rows = []
    for deg, rpm, thrust, power in TABLE_3_4:
        pitch = (PITCH, float(np.radians(deg)))
        a = solver.balanced("thesis trim", pair, spacing=0.02, pitch=pitch, upper_speed=6000 * RPM, air=BENCHMARK_AIR)
        mine = a.speed[1] / RPM
        rows.append([
            f"{deg}", f"{mine:.0f} ({percent(mine, rpm)} %)", f"{a.thrust[1]:.4f} ({percent(a.thrust[1], thrust)} %)",
            f"{_power(a, 1):.3f} ({percent(_power(a, 1), power)} %)", f"{100 * (1 - _ratio(a, 'thrust')):.1f} %",
            f"{100 * (_power(a, 1) / _power(a, 0) - 1):.1f} %", f"{a.thrust[0]:.4f}",
        ])  # fmt: skip
    table("Balanced, upper at 6000 rpm; deviation from Table 3.4 (at 14 deg: thrust deficit 23 %, power excess 10 %)",
          ["lower pitch deg", "lower rpm", "lower thrust N", "lower power W", "thrust deficit", "power excess",
           "upper thrust N"], rows)  # fmt: skip
    rows = []
    for h in SPACINGS:
        a = solver.balanced(
            "thesis trim", pair, spacing=h, pitch=(PITCH, PITCH), upper_speed=6000 * RPM, air=BENCHMARK_AIR
        )
        e = solver.pair(
            "thesis", pair, spacing=h, pitch=(PITCH, PITCH), speed=(6000 * RPM, 6000 * RPM), air=BENCHMARK_AIR
        )
        rows.append([
            f"{1e3 * h:.0f}", f"{e.thrust[0]:.4f}{e.mark()}", f"{e.thrust[1]:.4f}", f"{1e3 * e.torque[1]:.3f}",
            f"{_ratio(e, 'thrust'):.3f}", f"{a.speed[1] / RPM:.0f}", f"{sum(a.thrust):.4f}",
            f"{_power(a, 0) + _power(a, 1):.3f}",
        ])  # fmt: skip
    table("Spacing: at 6000 rpm each, and balanced with the upper at 6000 rpm",
          ["spacing mm", "upper N", "lower N", "lower mN m", "lower / upper thrust", "balanced: lower rpm",
           "both N", "both W"], rows)  # fmt: skip
    print("Measured 11 inch pairs elsewhere: lower / upper thrust 0.53 to 0.59 at equal speed; balanced, the lower one "
          "turns 4 to 12 % faster.\n")  # fmt: skip


def report_big(solver: Solver, record: Callable[..., None]) -> None:
    """The measured 28 inch pair: A is the lower rotor, B the upper one, at slightly different speeds."""
    points = read_text_table(DATA / "tmotor28_coaxial.csv").read_matrix()
    chosen = points[np.linspace(0, len(points) - 1, 4).round().astype(int)]
    case = load_t_motor_28(DATA)
    rows = []
    for n_crit in (0.1, 4.0, 9.0):
        rotor = blading_of(case, n_crit=n_crit)
        errors, fast, marks = [], [], []
        for rpm_l, t_l, q_l, _, t_u, q_u, _, rpm_u in chosen:
            speed = (rpm_u * RPM, rpm_l * RPM)
            a = solver.pair(
                "28 inch", rotor, spacing=0.115, pitch=(0.0, 0.0), speed=speed, air=T_MOTOR_AIR, n_crit=n_crit
            )
            b = solve_system(
                RotorSystem.coaxial_pair(rotor, rotor, spacing_m=0.115),
                OperatingCondition(0.0, speed, air=T_MOTOR_AIR),
            )
            marks.append(a.mark())
            measured = np.array([t_u, q_u, t_l, q_l, t_l / t_u])
            mine = [a.thrust[0], a.torque[0], a.thrust[1], a.torque[1], _ratio(a, "thrust")]
            theirs = [*_loads(b), b.lower.thrust_N / b.upper.thrust_N]
            errors.append(100 * (np.array(mine) / measured - 1))
            fast.append(100 * (np.array(theirs) / measured - 1))
        for label, found in (("wake", np.array(errors)), ("BEMT", np.array(fast))):
            mean = np.abs(found).mean(axis=0)
            if (label, n_crit) == ("wake", 0.1):
                record("wake_big_upper", *mean[:2])
                record("wake_big_lower", *mean[2:4])
            cells = [f"{', '.join(f'{v:+.1f}' for v in found[:, k])} ({mean[k]:.1f})" for k in range(5)]
            rows.append([f"{label}, n_crit {n_crit:g}{max(marks) if label == 'wake' else ''}", *cells])
    speeds = ", ".join(f"{v:.0f}" for v in chosen[:, 0])
    table(f"28 inch pair, lower at {speeds} rpm: deviation (mean size), %",
          ["", "upper thrust", "upper torque", "lower thrust", "lower torque", "lower / upper"], rows)  # fmt: skip


def _loads(b: SystemSolution) -> list[float]:
    return [b.upper.thrust_N, b.upper.torque_Nm, b.lower.thrust_N, b.lower.torque_Nm]


def report_bemt(solver: Solver, record: Callable[..., None]) -> None:
    """Coaxial BEMT against the wake method; the upper rotor at 6000 rpm, both at 14 degrees."""
    pair: Blading = blading_of(table_3_2())
    upper = 6000 * RPM
    found = np.full((len(SPACINGS), len(RATIOS), 4), np.nan)
    alone = solver.single(table_3_2(), PITCH, upper)
    scale = np.array([alone.thrust[0], alone.torque[0]] * 2)
    rows = []
    for i, h in enumerate(SPACINGS):
        cells = []
        for j, ratio in enumerate(RATIOS):
            speed = (upper, upper * ratio)
            a = solver.pair("ratios", pair, spacing=h, pitch=(PITCH, PITCH), speed=speed, air=BENCHMARK_AIR)
            b = solve_system(RotorSystem.coaxial_pair(pair, pair, spacing_m=h), OperatingCondition(PITCH, speed))
            ours = np.array([a.thrust[0], a.torque[0], a.thrust[1], a.torque[1]])
            # The lower rotor may carry next to nothing: deviations are over what a rotor does alone at its speed.
            found[i, j] = 100 * (np.array(_loads(b)) - ours) / (scale * np.array([1, 1, ratio**2, ratio**2]))
            cells.append(" / ".join(f"{v:+.0f}" for v in found[i, j]) + a.mark())
        rows.append([f"{1e3 * h:.0f} mm", *cells])
    table("BEMT less wake, % of what the rotor does alone at its speed: upper thrust / torque, lower thrust / torque",
          ["spacing", *(f"speed ratio {r:g}" for r in RATIOS)], rows)  # fmt: skip
    size = np.abs(found.reshape(-1, 4))
    table("The same in sum", ["", "upper thrust", "upper torque", "lower thrust", "lower torque"], [
        ["mean"] + [f"{v:.1f}" for v in np.nanmean(size, axis=0)],
        ["largest"] + [f"{v:.1f}" for v in np.nanmax(size, axis=0)],
        ["mean at 20 mm"] + [f"{v:.1f}" for v in np.nanmean(np.abs(found[1]), axis=0)],
    ])  # fmt: skip


def report_spacing(solver: Solver, record: Callable[..., None]) -> None:
    """Equal speeds, 14 degrees, 6000 rpm: how the thrust is shared over the spacing; old cores held at 0.3 R."""
    case = table_3_2()
    rotor, speed = blading_of(case), (6000 * RPM, 6000 * RPM)
    how = WakeSettings(core_limit=0.3)
    alone = solver.single(case, PITCH, speed[0], settings=how)
    lone = solve_system(RotorSystem.single_rotor(rotor), OperatingCondition(PITCH, speed[0])).thrust_N
    rows = []
    for over in (0.1, 1 / 6, 0.25, 0.5, 1.0):
        a = solver.pair(
            "spacing",
            rotor,
            spacing=0.12 * over,
            pitch=(PITCH, PITCH),
            speed=speed,
            air=BENCHMARK_AIR,
            settings=how,
            warm=False,
        )
        cells = [
            f"{over:.3g}",
            f"{a.thrust[0] / alone.thrust[0]:.3f}",
            f"{_ratio(a, 'thrust'):.3f}{a.mark()}",
        ]
        for method in ("tubes", "bemt"):
            b = solve_system(
                RotorSystem.coaxial_pair(rotor, rotor, spacing_m=0.12 * over),
                OperatingCondition(PITCH, speed),
                method,
            )
            cells += [f"{b.upper.thrust_N / lone:.3f}", f"{b.lower.thrust_N / b.upper.thrust_N:.3f}"]
        rows.append(cells)
    table("Over the spacing: upper thrust over alone, lower over upper thrust",
          ["z/D", "wake: upper", "lower / upper", "tubes: upper", "lower / upper", "BEMT: upper", "lower / upper"],
          rows)  # fmt: skip


def main() -> None:
    """Print the tables."""
    args = arguments(__doc__, ("thesis", "big", "bemt", "spacing"))
    if not DATA.is_dir():
        sys.exit("validate_wake_pairs: the measurements (../shared/data/aero) are not here; nothing to compare with")
    solver, record = Solver(args.keep), make_recorder(args.record)
    for name, report in (
        ("thesis", report_thesis),
        ("big", report_big),
        ("bemt", report_bemt),
        ("spacing", report_spacing),
    ):
        if name in args.parts:
            report(solver, record)
    farewell(solver)


if __name__ == "__main__":
    main()
