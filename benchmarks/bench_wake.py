"""The wake method: rate of its kernel, time to a converged rotor and pair, cost of an iteration over the wake's size.

    python benchmarks/bench_wake.py                # all: 3 minutes on two idle cores
    python benchmarks/bench_wake.py --short        # kernel and cost of an iteration only
    NUMBA_NUM_THREADS=1 python benchmarks/bench_wake.py

Targets on two cores: 1 G interactions/s in double precision; a rotor in 10 s, a pair in 60 s; cost of an iteration
quadratic in the wake elements, or better.

Compared with, in the same run: the same sum in NumPy (chunks that fit the cache), and what the machine could do at
best. An interaction takes three 1/sqrt(x), all through one unit of a core, and 58 additions and multiplications; loops
that do nothing else, on data in the first cache, give two limits, and the lower one binds.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable

import numba
import numpy as np
from numba import njit, prange

from mufly.rotor import load_rotor, prepare
from mufly.rotor.wake import WakeSettings, coaxial_wake, hover_wake
from mufly.rotor.wake.kernel import induce, segments_of

RPM = math.pi / 30
ROOTS = 3  # 1/sqrt(x) an interaction: two distances and the core
OPERATIONS = 58  # additions and multiplications an interaction, counted in wake/kernel.py
DEGREE = 16  # of the polynomial that measures additions and multiplications


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
        ra = 1.0 / np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2 + 1e-30)
        rb = 1.0 / np.sqrt(b[0] ** 2 + b[1] ** 2 + b[2] ** 2 + 1e-30)
        along = sum((a[k] - b[k]) * (a[k] * ra - b[k] * rb) for k in range(3))
        f = strength * along / np.sqrt(c2 * c2 + core)
        out[i : i + chunk] = np.stack([(f * c[k]).sum(axis=1) for k in range(3)], axis=1)
    return out


@njit(parallel=True, fastmath=True, error_model="numpy")
def _roots(x, rounds):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in prange(x.shape[0]):
        s = 0.0
        for r in range(rounds):
            for k in range(x.shape[1]):
                s += 1.0 / math.sqrt(x[i, k] + r)
        total += s
    return total


@njit(parallel=True, fastmath=True, error_model="numpy")
def _products(x, rounds):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in prange(x.shape[0]):
        s = 0.0
        for r in range(rounds):
            for k in range(x.shape[1]):
                v = x[i, k]
                p = v + r
                for _ in range(DEGREE):
                    p = p * v + 0.5
                s += p
        total += s
    return total


def report_kernel() -> None:
    """Interactions a second against NumPy and against the machine."""
    rng = np.random.default_rng(1)
    paths = np.cumsum(rng.normal(size=(25, 201, 3)), axis=1) * 0.01
    segments = segments_of(paths, np.full((25, 200), 0.01), rng.normal(size=25))
    points = rng.normal(size=(2500, 3)) * 0.1
    number = points.shape[0] * segments[2].size
    same = np.max(np.abs(induce(points[:50], segments) - numpy_induce(points[:50], segments)))
    scale = np.max(np.abs(induce(points[:50], segments)))
    if not same < 1e-9 * scale:
        raise SystemExit("bench_wake: the NumPy peer does not compute the same; nothing to compare")
    x = rng.uniform(0.1, 0.9, size=(64, 512))
    rounds = 200
    _roots(x, 1)
    _products(x, 1)
    # In turn, so that a busy machine disturbs all alike.
    times = {"kernel": math.inf, "numpy": math.inf, "roots": math.inf, "products": math.inf}
    for _ in range(5):
        times["kernel"] = min(times["kernel"], best(lambda: induce(points, segments), 3))
        times["roots"] = min(times["roots"], best(lambda: _roots(x, rounds), 3))
        times["products"] = min(times["products"], best(lambda: _products(x, rounds), 3))
    few = points[:256]
    times["numpy"] = best(lambda: numpy_induce(few, segments), 3)
    rate = number / times["kernel"]
    peer = few.shape[0] * segments[2].size / times["numpy"]
    roots = x.size * rounds / times["roots"] / ROOTS
    products = x.size * rounds * 2 * (DEGREE + 1) / times["products"] / OPERATIONS
    print(
        f"kernel, {numba.get_num_threads()} threads, double precision  {rate / 1e9:8.3f} G interactions/s (target 1)"
    )
    print(
        f"the same sum in NumPy                    {peer / 1e9:8.4f} G/s: the kernel is {rate / peer:.0f} times as fast"
    )
    print(
        f"limit by roots and divisions             {roots / 1e9:8.3f} G/s; by additions and multiplications {products / 1e9:.3f}"
    )
    print(
        f"the kernel reaches                       {100 * rate / min(roots, products):8.0f} % of the lower limit"
    )


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
        rotor = prepare(load_rotor("naca0012-r60-c20"), stations=panels)
        clock: list[float] = []
        how = WakeSettings(step_deg=step, turns=turns, far_turns=2 * turns, far_step_deg=min(2 * step, 45.0),
                           iterations=14, core_limit=0.3)  # fmt: skip

        def tick(*_: object, clock: list[float] = clock) -> None:
            clock.append(time.perf_counter())

        out = hover_wake(rotor, pitch_rad=0.25, speed_rad_s=600.0, settings=how, progress=tick)
        wake = out.wakes[0]
        elements = wake.paths_m.shape[0] * (wake.paths_m.shape[1] - 1) * wake.surface.blades
        rows.append((elements, float(np.min(np.diff(clock)[7:]))))
    n, t = np.array(rows).T
    print("\nelements of the wake, seconds an iteration (free wake, one rotor; best of seven)")
    for elements, seconds in rows:
        print(f"  {elements:7d}  {seconds:9.4f}   {1e9 * seconds / elements**2:8.3f} ns an element squared")
    slope = np.polyfit(np.log(n[-4:]), np.log(t[-4:]), 1)[0]
    print(f"exponent of the four largest             {slope:8.2f} (target: 2 at most)")


def report_solutions() -> None:
    """Time to a converged rotor and pair, from nothing, and from a neighbour."""
    blade, pitch = prepare(load_rotor("naca0012-r60-c20")), math.radians(14)
    start = time.perf_counter()
    one = hover_wake(blade, pitch_rad=pitch, speed_rad_s=6000 * RPM)
    first = time.perf_counter() - start
    start = time.perf_counter()
    near = hover_wake(blade, pitch_rad=1.03 * pitch, speed_rad_s=6000 * RPM, start=one)
    again = time.perf_counter() - start
    print(f"\none rotor                                {first:8.1f} s (target 10): {one.message}")
    print(f"from a neighbour, 3 % more pitch         {again:8.1f} s: {near.message}")
    pair = {
        "spacing_m": 0.02, "upper_pitch_rad": pitch, "lower_pitch_rad": pitch, "upper_speed_rad_s": 6000 * RPM
    }  # fmt: skip
    start = time.perf_counter()
    two = coaxial_wake(blade, blade, lower_speed_rad_s=6650 * RPM, **pair)
    first = time.perf_counter() - start
    start = time.perf_counter()
    near = coaxial_wake(blade, blade, lower_speed_rad_s=6500 * RPM, start=two, **pair)
    again = time.perf_counter() - start
    print(f"a pair                                   {first:8.1f} s (target 60): {two.message}")
    print(f"from a neighbour, 2 % less speed below   {again:8.1f} s: {near.message}")


def main() -> None:
    """Print the numbers."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
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
