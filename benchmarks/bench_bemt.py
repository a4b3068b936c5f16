"""Blade element momentum theory: hover points per second, one rotor and many.

    python benchmarks/bench_bemt.py [--record]

Targets: 0.05 ms a hover point in a batch on two cores, polars included (qprop.c takes 0.2 ms); time linear in
the number of points; a coaxial pair and its trim quick enough for design loops.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable

import numpy as np
from figure_record import take_record_option

from mufly.dynamics.vehicle_flight_map import make_flight_map
from mufly.rotor import (
    TEXTBOOK_CORRECTIONS,
    OperatingCondition,
    RotorSystem,
    compute_airfoil_polars,
    load_rotor,
    prepare_blading,
    replace_rotor,
    solve_rotor,
    solve_rotor_batch,
    solve_system,
)
from mufly.rotor.forward import ForwardCondition, make_flap_mode, solve_forward
from mufly.vehicle import load_vehicle


def best(task: Callable[[], object], repeats: int = 5) -> float:
    """Least time of several runs (s)."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        task()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    """Print the numbers."""
    record = take_record_option(sys.argv)
    start = time.perf_counter()
    rotor = load_rotor("naca0012-r60-c20")
    tables = compute_airfoil_polars(["naca0012"])
    case = prepare_blading(rotor, tables)
    first = solve_rotor(case, pitch_rad=0.2, speed_rad_s=600.0)
    print(f"start, polar, first point                {time.perf_counter() - start:8.2f} s ({first.thrust_N:.3f} N)")
    t = best(lambda: solve_rotor(case, pitch_rad=0.2, speed_rad_s=600.0), 50)
    print(f"one point from Python                    {1e3 * t:8.3f} ms")
    flight = ForwardCondition(0.2, 600.0, edgewise_m_s=4.0)
    mode = make_flap_mode(rotor, 1.6)
    solve_forward(case, flight, mode)
    t = best(lambda: solve_forward(case, flight, mode), 200)
    print(f"one point in forward flight              {1e3 * t:8.3f} ms (target 1)")
    vehicle, blades = load_vehicle("mufly-1.1"), load_rotor("walkera-5g6")
    t = best(lambda: make_flight_map(vehicle, blades, flap_frequency_ratio=1.0), 2)
    print(f"flight map of a pair                     {t:8.2f} s (target 5)")
    print(f"batch, {os.cpu_count()} cores:")
    for n in (1_000, 10_000, 100_000):
        pitch = np.linspace(0.0, 0.5, n)
        t = best(lambda pitch=pitch: solve_rotor_batch(case, pitch_rad=pitch, speed_rad_s=600.0))
        print(f"  {n:7d} points, all corrections         {1e3 * t / n:8.4f} ms a point (target 0.05)")
    plain = prepare_blading(rotor, tables, corrections=TEXTBOOK_CORRECTIONS)
    t = best(lambda: solve_rotor_batch(plain, pitch_rad=pitch, speed_rad_s=600.0))
    print(f"  {n:7d} points, plain                   {1e3 * t / n:8.4f} ms a point")

    chords = np.linspace(0.010, 0.030, 200)

    def sweep() -> None:
        rotors = [replace_rotor(rotor, {"blade.chord": float(c)}) for c in chords]
        many = prepare_blading(rotors, tables)
        solve_rotor_batch(
            many, pitch_rad=np.linspace(0.1, 0.35, 16)[:, None], speed_rad_s=600.0, which=np.arange(200)[None]
        )

    t = best(sweep, 3)
    print(f"200 chords x 16 pitches, blades laid out {1e3 * t / 3200:8.4f} ms a point")

    both = RotorSystem.from_coaxial_pair(case, case, spacing_m=0.02)

    def pair() -> None:
        solve_system(both, OperatingCondition(0.25, 600.0))

    def trim() -> None:
        solve_system(both, OperatingCondition((0.25, math.radians(16)), (600.0, None)))

    print(f"coaxial pair                             {1e3 * best(pair, 20):8.2f} ms")
    t = best(trim, 10)
    print(f"coaxial pair, torque balanced            {1e3 * t:8.2f} ms")
    record("time_trim", 1e3 * t)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    main()
