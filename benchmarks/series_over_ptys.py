"""Series of bench points over pseudo-terminals, faster than real time, stopped in the middle and resumed.

    python benchmarks/series_over_ptys.py [POINTS [PACE]]

The emulated devices of the tests (two EPOS, load cells with sensors of the air) run in a process of their own on one
simulated bench, at PACE times real time. The program uses the drivers of the real devices. It prints the run time, the
time of the bench's clock, the number of damaged lines, and the share of intervals that contain the truth.
"""

from __future__ import annotations

import argparse
import importlib.util
import multiprocessing
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from mufly.bench.rig.bench_devices import Clock, DeviceRig
from mufly.bench.rig.epos_controller import EposController
from mufly.bench.rig.serial_load_cells import SerialLoadCells
from mufly.bench.rig.simulated_rig import SimulatedRig
from mufly.bench.series.series_analysis import analyse_series
from mufly.bench.series.series_plan import StepDurations, make_series_plan
from mufly.bench.series.series_record import SeriesRecord
from mufly.bench.series.series_runner import StopRequested, run_series

COUNTS = 1e6
_spec = importlib.util.spec_from_file_location("far", Path(__file__).parents[1] / "tests" / "bench" / "emulators.py")
assert _spec is not None
assert _spec.loader is not None
far = importlib.util.module_from_spec(_spec)
sys.modules["far"] = far
_spec.loader.exec_module(far)


def make():
    world = SimulatedRig(4)
    return world, [
        far.FarEpos(world, "upper"),
        far.FarEpos(world, "lower"),
        far.FarCells(world, counts=COUNTS),
    ]


def main(points: int, pace: float) -> None:
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("fork").Process(target=far.serve, args=(there, make, pace), daemon=True)
    process.start()
    upper, lower, cells = here.recv()

    def ask(kind, value=None):
        here.send((kind, value))
        return here.recv()

    facts = ask("facts")
    c = dict(facts.calibration)
    for key, scale in (("offset", COUNTS), ("sensitivity", COUNTS), ("covariance", COUNTS**2)):
        c[key] = (scale * np.array(c[key])).tolist()
    ranges = dict.fromkeys(("thrust_raw", "torque_raw"), (-5 * COUNTS, 5 * COUNTS))
    facts = replace(facts, calibration=c, ranges=ranges)
    # 5 speeds a mounting, 2 of the reference among them (or 3, so that settings come in pairs).
    odd = (points // 5) % 2
    mountings = points // 5 - 2 - odd
    plan = make_series_plan(
        "pty", ["naca0012-r60-c20"], list(np.linspace(10, 16, mountings // 2)), [3000, 4000, 5000, 6000, 7000],
        reference="naca4412-r60-c20", reference_pitch_deg=10, repetitions=2, reference_every=mountings // (1 + odd),
        times=StepDurations(warm_up_s=120.0, average_s=4.0, longest_s=8.0, tare_s=4.0),
    )  # fmt: skip
    folder = Path(tempfile.mkdtemp())
    clock = Clock(pace)
    began, from_s = time.perf_counter(), clock.now()
    stops = 0
    while True:
        motors, load_cells = [EposController(upper, "upper"), EposController(lower, "lower")], SerialLoadCells(cells)
        rig = DeviceRig([*motors, load_cells], facts, clock, poll_Hz=10.0)
        record = SeriesRecord(folder)

        def asked(record=record, first=stops == 0) -> bool:
            return first and len(record.readings) > len(plan.steps) // 2

        try:
            run_series(
                plan, rig, record, asked=asked, mounted=lambda m: ask("mount", m),
                truth=lambda s: ask("truth", plan.mounting[s.mounting_index].driven_rotors),
            )  # fmt: skip
            break
        except StopRequested:
            stops += 1
        finally:
            rig.close()
            record.close()
    took, clocked = time.perf_counter() - began, clock.now() - from_s
    here.send(None)
    series = analyse_series(record)
    held = [
        abs(load.value - p.truth[q]) <= load.expanded
        for p in series.points for q in ("thrust", "torque_upper") if (load := getattr(p, q)) is not None
    ]  # fmt: skip
    failed = [x["why"] for x in record.lines if x["kind"] == "event" and x["what"] == "device"]
    print(
        f"{len(series.points)} points of {plan.point_count} in {took:.0f} s; the bench's clock: {clocked:.0f} s, "
        f"{clocked / took:.1f} times real time; stopped and resumed {stops} times; damaged: "
        f"{sum(m.broken_frame_count for m in motors)} frames, {load_cells.broken_line_count} lines; "
        f"devices failed {len(failed)} times; {100 * np.mean(held):.1f} % of {len(held)} intervals hold the truth; "
        f"doubts: {[d.kind for d in series.doubts]}"
    )
    print("\n".join(failed))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("points", type=int, nargs="?", default=100, help="number of points (default: 100)")
    parser.add_argument("pace", type=float, nargs="?", default=10.0, help="bench time over real time (default: 10)")
    options = parser.parse_args()
    main(options.points, options.pace)
