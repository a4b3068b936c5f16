"""How fast is a whole flight, and how long does a user wait for the first one?

    python benchmarks/bench_flight.py [--cold] [--json]

Measures the demonstration mission (plant, flight software, recorder on disk) against real time and, in the same run,
against the plant alone over the same number of Runge-Kutta steps: the machine's limit for this model. Then the time
of `mufly fly` from the shell, once everything is compiled, and with --cold also the very first time (Numba's cache
empty).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mufly.control import design_flight_controller
from mufly.dynamics import DEFAULT_STEP_S, find_trim, integrate_state, model_parameters
from mufly.flight import fly_mission
from mufly.vehicle import load_vehicle


def flight(repeats: int) -> dict[str, float]:
    vehicle = load_vehicle("mufly-1.1")
    controller = design_flight_controller(vehicle)
    with tempfile.TemporaryDirectory() as folder:
        fly_mission(vehicle, "demonstration", controller=controller, path=Path(folder) / "warm.mcap")
        best, flown = np.inf, 0.0
        for k in range(repeats):
            began = time.perf_counter()
            dataset = fly_mission(vehicle, "demonstration", controller=controller, path=Path(folder) / f"{k}.mcap")
            best = min(best, time.perf_counter() - began)
            flown = float(dataset.time.values[-1])
    hover = find_trim(vehicle, charge=1.0)
    state = hover.state.copy()
    state[2] = -2.0
    began = time.perf_counter()
    integrate_state(
        state,
        hover.input,
        np.zeros(3),
        model_parameters(vehicle),
        DEFAULT_STEP_S,
        round(flown / DEFAULT_STEP_S),
    )
    plant = time.perf_counter() - began
    return {
        "flight_s": flown,
        "wall_s": best,
        "realtime_factor": flown / best,
        "plant_alone_s": plant,
        "ratio_to_plant_alone": best / plant,
    }


def command(cache: str | None = None) -> float:
    """Seconds of `mufly fly --json` in a new process."""
    environment = dict(os.environ) if cache is None else {**os.environ, "NUMBA_CACHE_DIR": cache}
    with tempfile.TemporaryDirectory() as folder:
        call = [
            sys.executable,
            "-c",
            "from mufly.cli import main; main()",
            "fly",
            "--sensors",
            "ideal",
            "--json",
            "--out",
            folder,
        ]
        began = time.perf_counter()
        subprocess.run(call, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cold", action="store_true", help="also the very first start, everything uncompiled")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    result = flight(arguments.repeats)
    if arguments.cold:
        with tempfile.TemporaryDirectory() as cache:
            result["first_start_s"] = command(cache)
            result["later_start_s"] = command(cache)
    else:
        command()
        result["later_start_s"] = command()
    if arguments.json:
        print(json.dumps(result, indent=2))
        return
    print(f"demonstration mission      {result['flight_s']:7.1f} s flown in {result['wall_s']:.2f} s")
    print(f"  times real time          {result['realtime_factor']:7.1f}   (target: at least 50)")
    print(
        f"  times the plant alone    {result['ratio_to_plant_alone']:7.1f}   ({result['plant_alone_s'] * 1e3:.0f} ms)"
    )
    if "first_start_s" in result:
        print(f"mufly fly, very first time {result['first_start_s']:7.1f} s (target: under 40)")
    print(f"mufly fly, later           {result['later_start_s']:7.1f} s (target: under 10)")


if __name__ == "__main__":
    main()
