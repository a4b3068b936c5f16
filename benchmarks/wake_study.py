"""Has the wake method's answer settled? Panels, azimuth step, wake length, far wake, core size, relative azimuths.

    python benchmarks/wake_study.py                     # all: 20 minutes on two idle cores
    python benchmarks/wake_study.py single              # one rotor: Table 3.2's at 12 deg and 7000 rpm
    python benchmarks/wake_study.py slender             # one rotor: Caradonna and Tung's at 8 deg
    python benchmarks/wake_study.py pair                # the dissertation's pair, 6000 and 6650 rpm, 20 mm
    python benchmarks/wake_study.py --keep solved       # a stopped run goes on where it was

Each number is varied alone around the default settings, with the core of old wakes held (the default would thicken it
where a wake does not settle, which would hide what is asked). The last rows of one rotor refine several at once. Core
sizes are physics, not numerics: their rows show how much of the answer they are.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from rotor_cases import DATA, others, table_3_2
from wake_cases import Answer, Solver, arguments, farewell, laid_out, percent, table

from mufly.rotor.wake import WakeSettings
from mufly.study.benchmark import RotorCase
from mufly.study.benchmark.rotor_cases import BENCHMARK_AIR
from mufly.units import RPM

CORE_LIMIT, PAIR_CORE_LIMIT = 0.25, 0.3  # R

Setting = tuple[str, int | None, dict[str, float]]  # label, panels, settings

ALONE: list[Setting] = [
    *((f"panels {n}", n, {}) for n in (12, 16, 32, 48)),
    *((f"step {x:g} deg", None, {"step_deg": x}) for x in (30, 20, 10, 7.5)),
    *((f"free wake {x:g} turns", None, {"turns": x}) for x in (2, 3, 6, 8)),
    *((f"far wake {x:g} turns", None, {"far_turns": x}) for x in (5, 20, 40)),
    *((f"far step {x:g} deg", None, {"far_step_deg": x}) for x in (45, 15)),
    *((f"first core {x:g} c", None, {"core": x}) for x in (0.03, 0.05, 0.2)),
    *((f"old core {x:g} R", None, {"core_limit": x}) for x in (0.15, 0.2, 0.35)),
    ("tolerances / 5", None, {"tolerance": 2e-4, "residual": 0.01}),
    ("step 10, turns 6, far 20", None, {"step_deg": 10, "turns": 6, "far_turns": 20}),
    ("the same, 32 panels", 32, {"step_deg": 10, "turns": 6, "far_turns": 20}),
]
PAIR: list[Setting] = [
    *((f"panels {n}", n, {}) for n in (16, 32)),
    *((f"step {x:g} deg", None, {"step_deg": x}) for x in (30, 20, 10)),
    *((f"free wake {x:g} turns", None, {"turns": x}) for x in (2, 3, 6)),
    *((f"far wake {x:g} turns", None, {"far_turns": x}) for x in (5, 20)),
    *((f"first core {x:g} c", None, {"core": x}) for x in (0.05, 0.2)),
    *((f"old core {x:g} R", None, {"core_limit": x}) for x in (0.2, 0.4)),
    *((f"{n} relative azimuths", None, {"phases": n}) for n in (3, 12)),
]


def _mark(found: Answer) -> str:
    return "" if found.converged else " (*)"


def _cells(found: Answer, default: Answer) -> list[str]:
    loads = []
    for k in range(len(found.thrust)):
        loads += [percent(found.thrust[k], default.thrust[k]), percent(found.torque[k], default.torque[k])]
    return [
        *loads, f"{found.iterations}{_mark(found)}", f"{found.seconds / max(default.seconds, 1e-9):.1f}"
    ]  # fmt: skip


def _head(rotors: int) -> list[str]:
    names = [""] if rotors == 1 else ["upper ", "lower "]
    return [
        "",
        *(f"{n}{what} %" for n in names for what in ("thrust", "torque")),
        "iterations",
        "times the time",
    ]


def report_alone(solver: Solver, case: RotorCase, point: int, title: str) -> None:
    """One rotor."""
    m = case.measured
    pitch, speed, base = m.pitch_rad[point], m.speed_rad_s[point], WakeSettings(core_limit=CORE_LIMIT)

    def run(panels: int | None, change: dict[str, float]) -> Answer:
        how = replace(base, **change)  # type: ignore[arg-type]
        return solver.single(case, pitch, speed, panels=panels, settings=how)

    default = run(None, {})
    rows = [[f"old core {CORE_LIMIT:g} R", f"{default.thrust[0]:.4f} N", f"{1e3 * default.torque[0]:.4g} mN m",
             f"{default.iterations}{_mark(default)}", "1"]]  # fmt: skip
    rows += [[label, *_cells(run(panels, change), default)] for label, panels, change in ALONE]
    table(title, _head(1), rows)


def report_pair(solver: Solver) -> None:
    """The dissertation's pair near torque balance."""
    case, pitch, base = table_3_2(), float(np.radians(14)), WakeSettings(core_limit=PAIR_CORE_LIMIT)

    def run(panels: int | None, change: dict[str, float]) -> Answer:
        return solver.pair(
            f"study {panels or ''}", laid_out(case, 0.1, None, panels), spacing=0.02, pitch=(pitch, pitch),
            speed=(6000 * RPM, 6650 * RPM), air=BENCHMARK_AIR, settings=replace(base, **change), warm=False,  # type: ignore[arg-type]
        )  # fmt: skip

    default = run(None, {})
    loads = [x for k in (0, 1) for x in (f"{default.thrust[k]:.4f} N", f"{1e3 * default.torque[k]:.4g} mN m")]
    rows = [[f"old core {PAIR_CORE_LIMIT:g} R", *loads, f"{default.iterations}{_mark(default)}", "1"]]
    rows += [[label, *_cells(run(panels, change), default)] for label, panels, change in PAIR]
    table("The dissertation's pair, 6000 and 6650 rpm, spacing 20 mm", _head(2), rows)


def main() -> None:
    """Print the tables."""
    args = arguments(__doc__, ("single", "slender", "pair"))
    if not DATA.is_dir():
        sys.exit("wake_study: the rotors (../shared/data/aero) are not here")
    solver = Solver(args.keep)
    if "single" in args.parts:
        report_alone(solver, table_3_2(), 1, "Table 3.2's rotor, 12 deg, 7000 rpm")
    if "slender" in args.parts:
        case = next(c for c in others() if c.name == "caradonna-tung")
        report_alone(solver, case, 1, "Caradonna and Tung's rotor, 8 deg")
    if "pair" in args.parts:
        report_pair(solver)
    farewell(solver)


if __name__ == "__main__":
    main()
