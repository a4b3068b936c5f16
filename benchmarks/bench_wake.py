"""The wake method: rate of its kernel, time to a converged rotor and pair, cost of an iteration over the wake's size.

    python benchmarks/bench_wake.py                # all: 3 minutes on two idle cores
    python benchmarks/bench_wake.py --short        # kernel and cost of an iteration only
    NUMBA_NUM_THREADS=1 python benchmarks/bench_wake.py

Targets on two cores: 1 G interactions/s in double precision; a rotor in 2 s, a pair in 8 s; cost of an iteration
quadratic in the wake elements, or better.

Compared with, in the same run: the same sum in NumPy (chunks that fit the cache), and what the machine could do at
best. An interaction takes two 1/sqrt(x) and a 1/x, all through one unit of a core, and 77 additions and
multiplications; loops that do nothing else, on data in the first cache, give two limits, and the lower one binds.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable

import numba
import numpy as np
from numba import njit

from mufly.rotor import OperatingCondition, RotorSystem, load_rotor, prepare_blading, solve_system
from mufly.rotor.wake import WakeSettings
from mufly.rotor.wake.biot_savart import induce_velocity, make_segments

RPM = math.pi / 30
OPERATIONS = 77  # additions and multiplications an interaction, counted in wake/kernel.py


def best(task: Callable[[], object], repeats: int = 5) -> float:
    """Least time of several runs (s)."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        task()
        times.append(time.perf_counter() - start)
    return min(times)


def numpy_induce(points: np.ndarray, segments: tuple[np.ndarray, ...], chunk: int = 64) -> np.ndarray:
    """The kernel's sum in NumPy."""
    start, end, strength, core = segments
    out = np.empty_like(points)
    for i in range(0, len(points), chunk):
        p = points[i : i + chunk].T[:, :, None]
        a, b = p - start[:, None], p - end[:, None]
        c = np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
        c2 = c[0] ** 2 + c[1] ** 2 + c[2] ** 2
        ra = 1.0 / np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2 + core)
        rb = 1.0 / np.sqrt(b[0] ** 2 + b[1] ** 2 + b[2] ** 2 + core)
        line = (end - start)[:, None]
        along_a, along_b = (sum(line[k] * x[k] for k in range(3)) * r for x, r in ((a, ra), (b, rb)))
        thick = core * (line**2).sum(axis=0)
        e = 1.0 / (c2 + thick)
        f = (along_a - along_b) * (1.0 + thick * e) + 0.5 * core * (along_a * ra**2 - along_b * rb**2)
        f *= strength * e
        out[i : i + chunk] = np.stack([(f * c[k]).sum(axis=1) for k in range(3)], axis=1)
    return out


@njit(fastmath=True, error_model="numpy")
def _roots(x, y, rounds):  # type: ignore[no-untyped-def]
    for r in range(rounds):
        for k in range(x.size):
            y[k] += 1.0 / math.sqrt(x[k] + r) + 1.0 / math.sqrt(x[k] + r + 0.5) + 1.0 / (x[k] + r)


@njit(fastmath=True, error_model="numpy")
def _products(x, y, rounds):  # type: ignore[no-untyped-def]
    for _ in range(rounds):
        for k in range(x.size):
            v = x[k]
            p = v * v + 0.5
            p = (((p * v + 0.5) * v + 0.5) * v + 0.5) * v + 0.5
            p = (((p * v + 0.5) * v + 0.5) * v + 0.5) * v + 0.5
            p = (((p * v + 0.5) * v + 0.5) * v + 0.5) * v + 0.5
            p = ((p * v + 0.5) * v + 0.5) * v + 0.5
            y[k] = y[k] * 0.5 + p


PRODUCTS = 34  # additions and multiplications of one pass of the loop above


def report_kernel() -> None:
    """Interactions a second against NumPy and against the machine."""
    rng = np.random.default_rng(1)
    paths = np.cumsum(rng.normal(size=(25, 201, 3)), axis=1) * 0.01
    segments = make_segments(paths, np.full((25, 200), 0.01), rng.normal(size=25))
    points = rng.normal(size=(200, 3)) * 0.1  # a millisecond: fits between what else the machine does
    few = points[:16]
    difference = np.max(np.abs(induce_velocity(few, segments) - numpy_induce(few, segments)))
    if not difference < 1e-9 * np.max(np.abs(induce_velocity(few, segments))):
        raise SystemExit("bench_wake: the NumPy peer does not compute the same; nothing to compare")
    x, y, rounds = rng.uniform(0.1, 0.9, 1024), np.zeros(1024), 1000
    _roots(x, y, 1)
    _products(x, y, 1)
    threads = numba.get_num_threads()
    tasks: dict[str, Callable[[], object]] = {
        "kernel": lambda: induce_velocity(points, segments),
        "roots": lambda: _roots(x, y, rounds),
        "products": lambda: _products(x, y, rounds),
        "numpy": lambda: numpy_induce(few, segments),
    }
    times = dict.fromkeys(tasks, math.inf)
    numba.set_num_threads(1)
    for _ in range(40):  # in turn, so that a busy machine disturbs all alike
        for name, task in tasks.items():
            times[name] = min(times[name], best(task, 2))
    numba.set_num_threads(threads)
    together = best(tasks["kernel"], 200)
    size = segments[2].size
    one, all_of_them = (1e-9 * len(points) * size / t for t in (times["kernel"], together))
    peer = 1e-9 * len(few) * size / times["numpy"]
    roots = 1e-9 * x.size * rounds / times["roots"]
    products = 1e-9 * x.size * rounds * PRODUCTS / times["products"] / OPERATIONS
    print(f"kernel, {threads} threads, double precision   {all_of_them:8.3f} G interactions/s (target 1)")
    print(f"one thread                              {one:8.3f} G/s")
    print(f"the same sum in NumPy, one thread       {peer:8.4f} G/s: the kernel is {one / peer:.0f} times as fast")
    print(f"limit by roots and divisions, one thread{roots:8.3f} G/s, of which {100 * one / roots:.0f} %")
    print(f"limit by products and sums              {products:8.3f} G/s, of which {100 * one / products:.0f} %")


def report_iteration() -> None:
    """Seconds an iteration over the wake's elements, and the exponent."""
    rows = []
    for panels, step, turns in (
        (12, 30, 2),
        (16, 20, 3),
        (24, 15, 4),
        (24, 10, 4),
        (32, 10, 6),
        (32, 7.5, 6),
    ):
        rotor = prepare_blading(load_rotor("naca0012-r60-c20"), stations=panels)
        clock: list[float] = []
        how = WakeSettings(step_deg=step, turns=turns, far_turns=2 * turns, far_step_deg=min(2 * step, 45.0),
                           iterations=14, core_limit=0.3)  # fmt: skip

        def tick(*_: object, clock: list[float] = clock) -> None:
            clock.append(time.perf_counter())

        out = solve_system(
            RotorSystem.single_rotor(rotor),
            OperatingCondition(0.25, 600.0),
            "wake",
            settings=how,
            progress=tick,
        )
        wake = out.wakes[0]
        elements = wake.filament_paths_m.shape[0] * (wake.filament_paths_m.shape[1] - 1) * wake.surface.blade_count
        rows.append((elements, float(np.min(np.diff(clock)[7:]))))
    n, t = np.array(rows).T
    print("\nelements of the wake, seconds an iteration (free wake, one rotor; best of seven)")
    for elements, seconds in rows:
        print(f"  {elements:7d}  {seconds:9.4f}   {1e9 * seconds / elements**2:8.3f} ns an element squared")
    slope = np.polyfit(np.log(n[-4:]), np.log(t[-4:]), 1)[0]
    print(f"exponent of the four largest             {slope:8.2f} (target: 2 at most)")


def report_solutions() -> None:
    """Time to a converged rotor and pair, from nothing, and from a neighbour."""
    blade, pitch = prepare_blading(load_rotor("naca0012-r60-c20")), math.radians(14)
    single, pair = RotorSystem.single_rotor(blade), RotorSystem.coaxial_pair(blade, blade, spacing_m=0.02)
    start = time.perf_counter()
    one = solve_system(single, OperatingCondition(pitch, 6000 * RPM), "wake")
    first = time.perf_counter() - start
    start = time.perf_counter()
    near = solve_system(single, OperatingCondition(1.03 * pitch, 6000 * RPM), "wake", start=one)
    again = time.perf_counter() - start
    print(f"\none rotor                                {first:8.1f} s (target 2): {one.message}")
    print(f"from a neighbour, 3 % more pitch         {again:8.1f} s: {near.message}")
    start = time.perf_counter()
    two = solve_system(pair, OperatingCondition(pitch, (6000 * RPM, 6650 * RPM)), "wake")
    first = time.perf_counter() - start
    start = time.perf_counter()
    near = solve_system(pair, OperatingCondition(pitch, (6000 * RPM, 6500 * RPM)), "wake", start=two)
    again = time.perf_counter() - start
    print(f"a pair                                   {first:8.1f} s (target 8): {two.message}")
    print(f"from a neighbour, 2 % less speed below   {again:8.1f} s: {near.message}")


def main() -> None:
    """Print the numbers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="leave out the solutions")
    args = parser.parse_args()
    load = os.getloadavg()[0]
    print(
        f"{os.cpu_count()} cores, load of the machine {load:.1f}"
        + (" (busy: ratios hold, rates do not)" if load > 0.5 else "")
    )
    report_kernel()
    report_iteration()
    if not args.short:
        report_solutions()


if __name__ == "__main__":
    main()
