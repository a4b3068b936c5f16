"""The wake method: rate of its kernel, time to a converged rotor and pair, cost of an iteration over the wake's size.

    python benchmarks/bench_wake.py                # all: 3 minutes on two idle cores
    python benchmarks/bench_wake.py --short        # kernel and cost of an iteration only
    NUMBA_NUM_THREADS=1 python benchmarks/bench_wake.py

Targets: a rotor in 3 s, a pair in 7 s of processor time; cost of an iteration quadratic in the wake elements, or
better.

Compared with, in the same run: the same sum in NumPy (chunks that fit the cache), and what the machine could do at
best. An interaction takes two 1/sqrt(x) and a 1/x, all through one unit of a core, and 77 additions and
multiplications (61 in single precision). Loops that do nothing else, on data in the first cache, give two limits, and
the lower one binds. The solver's sum is in single precision, twice as wide in the registers; its limits are those of
the same loops.
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
from mufly.rotor.wake import WakeSettings, biot_savart
from mufly.rotor.wake.biot_savart import convert_segments_to_single, induce_velocity, make_segments

RPM = math.pi / 30
OPERATIONS = {"double": 77, "single": 61}  # additions and multiplications an interaction, in wake/biot_savart.py


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
def _roots(x, y, half, one, rounds):  # type: ignore[no-untyped-def]
    for _ in range(rounds):
        for k in range(x.size):
            y[k] = half * y[k] + one / np.sqrt(x[k] + y[k]) + one / np.sqrt(x[k] + half) + one / (x[k] + y[k])


@njit(fastmath=True, error_model="numpy")
def _products(x, y, half, one, rounds):  # type: ignore[no-untyped-def]
    for _ in range(rounds):
        for k in range(x.size):
            v = x[k] * one
            p = v * v + half
            p = (((p * v + half) * v + half) * v + half) * v + half
            p = (((p * v + half) * v + half) * v + half) * v + half
            p = (((p * v + half) * v + half) * v + half) * v + half
            p = ((p * v + half) * v + half) * v + half
            y[k] = y[k] * half + p


PRODUCTS = 34  # additions and multiplications of one pass of the loop above


def report_kernel() -> float:
    """Interactions a second against NumPy and against the machine; return those of one thread, in single precision."""
    rng = np.random.default_rng(1)
    paths = np.cumsum(rng.normal(size=(25, 201, 3)), axis=1) * 0.01
    segments = make_segments(paths, np.full((25, 200), 0.01), rng.normal(size=25))
    points = rng.normal(size=(200, 3)) * 0.1  # a millisecond: fits between what else the machine does
    few = points[:16]
    difference = np.max(np.abs(induce_velocity(few, segments) - numpy_induce(few, segments)))
    if not difference < 1e-9 * np.max(np.abs(induce_velocity(few, segments))):
        raise SystemExit("bench_wake: the NumPy peer does not compute the same; nothing to compare")
    packed = convert_segments_to_single(segments)
    rounds, lanes = 1000, {}
    for kind in (np.float64, np.float32):
        x = rng.uniform(0.1, 0.9, 1024).astype(kind)
        lanes[kind] = (x, np.zeros_like(x), kind(0.5), kind(1.0))
        _roots(*lanes[kind], 1)
        _products(*lanes[kind], 1)
    threads = numba.get_num_threads()
    tasks: dict[str, Callable[[], object]] = {
        "kernel": lambda: induce_velocity(points, segments),
        "single": lambda: induce_velocity(points, packed),
        "roots": lambda: _roots(*lanes[np.float64], rounds),
        "products": lambda: _products(*lanes[np.float64], rounds),
        "roots single": lambda: _roots(*lanes[np.float32], rounds),
        "products single": lambda: _products(*lanes[np.float32], rounds),
        "numpy": lambda: numpy_induce(few, segments),
    }
    tasks["single"]()
    times = dict.fromkeys(tasks, math.inf)
    numba.set_num_threads(1)
    for _ in range(40):  # in turn, so that a busy machine disturbs all alike
        for name, task in tasks.items():
            times[name] = min(times[name], best(task, 2))
    numba.set_num_threads(threads)
    together = best(tasks["single"], 200)
    size = segments[2].size
    double, single, all_of_them = (1e-9 * len(points) * size / t for t in (times["kernel"], times["single"], together))
    peer = 1e-9 * len(few) * size / times["numpy"]
    print(f"kernel, {threads} threads, single precision   {all_of_them:8.3f} G interactions/s")
    print(f"the same sum in NumPy, one thread       {peer:8.4f} G/s: the kernel is {single / peer:.0f} times as fast")
    for name, rate, word in (("double", double, ""), ("single", single, " single")):
        roots = 1e-9 * 1024 * rounds / times["roots" + word]
        products = 1e-9 * 1024 * rounds * PRODUCTS / times["products" + word] / OPERATIONS[name]
        print(f"one thread, {name} precision            {rate:8.3f} G/s")
        print(f"  limit by roots and divisions          {roots:8.3f} G/s, of which {100 * rate / roots:.0f} %")
        print(f"  limit by products and sums            {products:8.3f} G/s, of which {100 * rate / products:.0f} %")
    return 1e9 * single


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
            RotorSystem.from_single_rotor(rotor),
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


def report_solutions(rate: float) -> None:
    """Time to a converged rotor and pair, from nothing, and from a neighbour; ``rate`` of the kernel (1/s)."""
    kernel, interactions = biot_savart._grouped_kernel_single_precision, 0

    def count(points: np.ndarray, rows: np.ndarray, out: np.ndarray) -> None:
        nonlocal interactions
        interactions += points.shape[0] * rows[0].size
        kernel(points, rows, out)

    biot_savart._grouped_kernel_single_precision = count
    blade, pitch = prepare_blading(load_rotor("naca0012-r60-c20")), math.radians(14)
    single, pair = RotorSystem.from_single_rotor(blade), RotorSystem.from_coaxial_pair(blade, blade, spacing_m=0.02)
    start, work = time.perf_counter(), time.process_time()
    one = solve_system(single, OperatingCondition(pitch, 6000 * RPM), "wake")
    first, work, least = time.perf_counter() - start, time.process_time() - work, interactions / rate
    start = time.perf_counter()
    near = solve_system(single, OperatingCondition(1.03 * pitch, 6000 * RPM), "wake", start=one)
    again = time.perf_counter() - start
    print(f"\none rotor                                {first:8.1f} s, {work:.1f} s of processor time (target 3)")
    print(f"  its interactions at the kernel's rate  {least:8.1f} s")
    print(f"from a neighbour, 3 % more pitch         {again:8.1f} s: {near.message}")
    interactions, start, work = 0, time.perf_counter(), time.process_time()
    two = solve_system(pair, OperatingCondition(pitch, (6000 * RPM, 6650 * RPM)), "wake")
    first, work, least = time.perf_counter() - start, time.process_time() - work, interactions / rate
    start = time.perf_counter()
    near = solve_system(pair, OperatingCondition(pitch, (6000 * RPM, 6500 * RPM)), "wake", start=two)
    again = time.perf_counter() - start
    print(f"a pair                                   {first:8.1f} s, {work:.1f} s of processor time (target 7)")
    print(f"  its interactions at the kernel's rate  {least:8.1f} s")
    print(f"from a neighbour, 2 % less speed below   {again:8.1f} s: {near.message}")


def main() -> None:
    """Print the numbers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="leave out the solutions")
    parser.add_argument("--solutions", action="store_true", help="leave out the cost of an iteration")
    args = parser.parse_args()
    load = os.getloadavg()[0]
    print(
        f"{os.cpu_count()} cores, load of the machine {load:.1f}"
        + (" (busy: ratios hold, rates do not)" if load > 0.5 else "")
    )
    rate = report_kernel()
    if args.solutions:
        report_solutions(rate)
        return
    report_iteration()
    if not args.short:
        report_solutions(rate)


if __name__ == "__main__":
    main()
