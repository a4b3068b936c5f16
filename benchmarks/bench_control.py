"""How long the controllers take: to design, and to run.

    python benchmarks/bench_control.py            figures of this machine
    python benchmarks/bench_control.py --tables   the tables of docs/explanation/control.md

Times are the best of several repetitions, on one thread of the linear algebra where it obeys the environment.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

import mufly
from mufly.control import (
    FlightController,
    analyse_loop,
    design_flight_controller,
    discretise_controller,
    heave_yaw_init,
    heave_yaw_step,
    hinfsyn,
    position_init,
    position_step,
    roll_pitch_init,
    roll_pitch_step,
    sample_plant,
)
from mufly.control.linear_systems import extract_feedback_controller
from mufly.control.robust import analyse_parameter_robustness


def best(function: Callable[[], object], repeat: int, number: int = 1) -> float:
    """Shortest time of one call, in seconds."""
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        for _ in range(number):
            function()
        times.append((time.perf_counter() - start) / number)
    return min(times)


def speed(controller: FlightController) -> None:
    vehicle = mufly.load_vehicle("mufly-1.1")
    print(
        f"all designs of one vehicle    {best(lambda: design_flight_controller(vehicle), 5) * 1e3:8.0f} ms   "
        f"target below 2000 ms"
    )
    for d, ny in ((controller.heave_yaw, 5), (controller.roll_pitch, 4), (controller.velocity, 2)):
        seconds = best(lambda d=d, ny=ny: hinfsyn(d.generalised_plant, ny, 2, relaxation=1.01), 5)
        print(f"synthesis, {d.name:10} {d.generalised_plant.nstates:3d} states {seconds * 1e3:8.1f} ms")
    start = time.process_time()
    robust = analyse_parameter_robustness(vehicle, controller, points=60)
    blocks = sum(len(loop.block_sizes) for loop in robust.loop_results)
    print(f"mu, 60 frequencies, {blocks} real blocks {time.process_time() - start:8.1f} s    target below 10 s")
    g, h, p = controller.heave_yaw_gains, controller.roll_pitch_gains, controller.position_gains
    zero2, zero3, zero4 = np.zeros(2), np.zeros(3), np.zeros(4)
    a, b, c = (
        heave_yaw_init(g, zero3, np.array([0.67, 0.73]), 7.2),
        roll_pitch_init(h, np.zeros(4)),
        position_init(p),
    )
    one = best(lambda: heave_yaw_step(g, a, zero4, zero3, 7.2), 5, 20_000) * 1e6
    two = best(lambda: roll_pitch_step(h, b, zero2, zero4), 5, 20_000) * 1e6
    three = best(lambda: position_step(p, c, zero3, zero3, zero3, zero3, zero3, 0.1), 5, 20_000) * 1e6
    print(f"heave-yaw + roll-pitch step   {one + two:8.1f} us   target below 10 us ({one:.1f} + {two:.1f})")
    print(f"position step                 {three:8.1f} us")


def tables(controller: FlightController) -> None:
    print("rate Hz | heave-yaw S_u, T_u dB | roll-pitch S_u, T_u dB, phase margin deg, delay margin ms")
    for rate in (50, 80, 100, 125, 150, 200, 250, 333, 500):
        row = f"{rate:7d} |"
        for d in (controller.heave_yaw, controller.roll_pitch):
            # The reduced controller is the same at every rate; only its difference equations change.
            sampled = discretise_controller(d.reduced, np.zeros((d.reduced.nstates, 2)), 1 / rate).to_state_space()
            loop = analyse_loop(
                sample_plant(d.plant, 1 / rate, 1), extract_feedback_controller(sampled, d.plant, d.error_inputs)
            )
            if not loop.stable:
                row += " unstable |"
                continue
            row += f" {loop.sensitivity_peak_dB:5.2f} {loop.complementary_peak_dB:5.2f}"
            if d is controller.roll_pitch:
                row += f" {loop.phase_margin_deg:5.1f} {loop.delay_margin_s * 1e3:5.1f}"
            row += " |"
        print(row)
    for d in (controller.heave_yaw, controller.roll_pitch):
        r = d.reduction
        print(f"\n{d.name}: order {r.full_order}, norm {r.full_norm:.3f}; chosen {r.chosen.order} {r.chosen.method}")
        print("order kept method          S_u dB  T_u dB    norm")
        for c in r.candidates:
            print(
                f"{c.order:5d} {c.kept_modes:4d} {c.method:14} {c.sensitivity_peak_dB:7.2f} "
                f"{c.complementary_peak_dB:7.2f} {c.norm:8.3f}{' *' if c.meets_tolerance else ''}"
            )
    poles = np.linalg.eigvals(controller.heave_yaw.discrete.A)
    print("\ndirect form of heave-yaw's denominator: largest pole after rounding")
    for bits in (12, 16, 20, 24, 28, 32, 40):
        coefficients = np.poly(poles).real
        step = np.abs(coefficients).max() / 2 ** (bits - 1)
        print(f"{bits:3d} bits {np.abs(np.roots(np.round(coefficients / step) * step)).max():.5f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", action="store_true", help="print the tables of docs/explanation/control.md")
    arguments = parser.parse_args()
    built = design_flight_controller(mufly.load_vehicle("mufly-1.1"))
    if arguments.tables:
        tables(built)
    else:
        speed(built)
