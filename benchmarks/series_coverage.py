"""How often the intervals of a series hold the truth, and how often faults are found, on simulated benches.

    python benchmarks/series_coverage.py 200 [upper|pair [FIRST_SEED]]
    python benchmarks/series_coverage.py faults 40

A series: two pitches mounted twice, five speeds, three visits of the reference (35 points; 50 as a pair), about half an
hour of simulated time. Every bench has motors, cells, drifts, weather and a calibration of its own.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict

import numpy as np

from mufly.bench.rig.simulated_rig import SimulatedFaults, SimulatedRig
from mufly.bench.series.series_analysis import LOAD_NAMES, SeriesResult, analyse_series
from mufly.bench.series.series_plan import PlanStep, RotorAxis, SeriesPlan, make_plan
from mufly.bench.series.series_record import SeriesRecord
from mufly.bench.series.series_runner import run_series


def plan_for(axis: RotorAxis) -> SeriesPlan:
    return make_plan(
        "coverage", ["naca0012-r60-c20"], [10, 14], [3000, 4000, 5000, 6000, 7000], reference="naca4412-r60-c20",
        reference_pitch_deg=10, repetitions=2, reference_every=2, axis=axis,
    )  # fmt: skip


def one(plan: SeriesPlan, seed: int, faults: SimulatedFaults | None = None) -> SeriesResult:
    rig = SimulatedRig(seed, faults=faults or SimulatedFaults())

    def truth(step: PlanStep) -> dict[str, float]:
        speeds = {a: rig.speed[a] for a in plan.mounting[step.mounting_index].turning_sides}
        nominal = rig.true_loads(speeds, as_mounted=False)
        return rig.true_loads(speeds) | {f"nominal_{k}": v for k, v in nominal.items()}

    return analyse_series(run_series(plan, rig, SeriesRecord(), truth=truth))


def coverage(count: int, axis: str, first: int) -> None:
    plan, began = plan_for(axis), time.perf_counter()
    hit, off, width, refused = defaultdict(list), defaultdict(list), defaultdict(list), 0
    for seed in range(first, first + count):
        series = one(plan, seed)
        refused += bool(series.fatal_issues)
        for d in series.doubts:
            print(seed, d.text)
        for kind, many in (("point", series.points), ("setting", series.settings)):
            for x in many:
                for q in LOAD_NAMES:
                    if (load := getattr(x, q)) is not None:
                        true = x.truth[q if kind == "point" else f"nominal_{q}"]
                        hit[kind, q].append(abs(load.value - true) <= load.expanded)
                        off[kind, q].append(load.value / true - 1.0)
                        width[kind, q].append(load.expanded / true)
    print(f"{count} series, {axis}, {time.perf_counter() - began:.0f} s; refused {refused}")
    for key, v in hit.items():
        print(
            f"{key[0]:8s} {key[1]:13s} 95 % intervals hold {100 * np.mean(v):5.1f} % of {len(v)}; half width "
            f"{100 * np.median(width[key]):.2f} %, error {100 * np.sqrt(np.mean(np.square(off[key]))):.2f} % rms"
        )


def faults(count: int) -> None:
    cases = {
        "none": SimulatedFaults(),
        "reference moved by 0.25 deg": SimulatedFaults(reference_moved_deg=0.25, reference_moved_after=2),
        "reference moved by 0.5 deg": SimulatedFaults(reference_moved_deg=0.5, reference_moved_after=1),
        "cell saturated": SimulatedFaults(force_cell_saturates=True),
        "nonsense in 5 % of the samples": SimulatedFaults(spike_share=0.05),
        "nonsense in 0.5 % of the samples": SimulatedFaults(spike_share=0.005),
        "speed not reached by 4 %": SimulatedFaults(speed_shortfall_share=0.04),
    }
    plan = plan_for("upper")
    for name, fault in cases.items():
        kinds: dict[str, int] = defaultdict(int)
        refused = 0
        for seed in range(count):
            try:
                found = one(plan, seed, fault).fatal_issues
            except Exception as error:
                kinds[f"{type(error).__name__}: {error}"[:60]] += 1
                refused += 1
                continue
            refused += bool(found)
            for kind in {d.kind for d in found}:
                kinds[kind] += 1
        print(f"{name:34s} refused {refused} of {count}  {dict(kinds)}")


if __name__ == "__main__":
    if sys.argv[1] == "faults":
        faults(int(sys.argv[2]))
    else:
        more = sys.argv[2:]
        coverage(int(sys.argv[1]), more[0] if more else "upper", int(more[1]) if len(more) > 1 else 0)
