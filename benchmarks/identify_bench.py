"""How often the 95 % intervals of bench fits hold the truth, over many seeds.

    python benchmarks/identify_bench.py [seeds [first]] [--record]

Motor: Table 5.3's constants, stationary points at constant voltage with varied torque, errors of 1 % in all four
channels, of the reading or of full scale. Rotor: constant coefficients, 1 % of the reading. Held: share of intervals
with the truth inside. Scatter and stated: standard deviation of the estimates over the seeds, and the mean of those
stated, in per cent of the truth.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

import numpy as np
from figure_record import take_record_option

from mufly.bench import BenchTable, compute_loads
from mufly.identify import fit_motor, fit_rotor_coefficients
from mufly.vehicle import load_vehicle

V = load_vehicle("mufly-1.1")
MOTOR = {
    "kE": float(V.motor.back_emf_constant), "kM": float(V.motor.torque_constant), "Rohm": float(V.motor.resistance),
    "dR": float(V.motor.friction),
}  # fmt: skip
ROTOR = {"cT": float(V.rotors.upper.thrust_coefficient), "cQ": float(V.rotors.upper.torque_coefficient)}


def table(columns: dict[str, np.ndarray]) -> BenchTable:
    return BenchTable("made up", columns, {k: k for k in columns}, np.arange(len(next(iter(columns.values())))))


def motor_bench(rng: np.random.Generator, voltages: tuple[float, ...], points: int, full_scale: bool) -> BenchTable:
    u = np.repeat(voltages, points)
    torque = np.concatenate([np.linspace(0.05, 0.85, points) * MOTOR["kM"] * v / MOTOR["Rohm"] for v in voltages])
    speed = (MOTOR["kM"] * u / MOTOR["Rohm"] - torque) / (MOTOR["kM"] * MOTOR["kE"] / MOTOR["Rohm"] + MOTOR["dR"])
    y = np.column_stack([u, (u - MOTOR["kE"] * speed) / MOTOR["Rohm"], speed, torque])
    y += 0.01 * rng.standard_normal(y.shape) * (np.abs(y).max(axis=0) if full_scale else y)
    return table(dict(zip(("voltage", "current", "speed", "torque"), y.T, strict=True)))


def rotor_bench(rng: np.random.Generator, points: int) -> BenchTable:
    speed = np.linspace(150, 450, points)[rng.permutation(points)]
    thrust = ROTOR["cT"] * 1.2 * math.pi * 0.0875**4 * speed**2
    torque = ROTOR["cQ"] * 1.2 * math.pi * 0.0875**5 * speed**2
    noise = 1 + 0.01 * rng.standard_normal((2, points))
    return table({"speed": speed, "thrust": thrust * noise[0], "torque": torque * noise[1]})


def line(name: str, truth: dict[str, float], fits: list[tuple]) -> float:
    for symbol, true in truth.items():
        of = [next(e for e in fit if e.symbol == symbol) for fit in fits]
        held = np.mean([e.low <= true <= e.high for e in of])
        scatter, stated = np.std([e.value / true for e in of]), np.mean([e.std / true for e in of])
        print(f"{name:36} {symbol:5} {held:7.1%} {100 * scatter:9.3f} {100 * stated:9.3f}")
    every = [e.low <= truth[e.symbol] <= e.high for fit in fits for e in fit if e.symbol in truth]
    return float(np.mean(every))


def main(seeds: int, first: int, record: Callable[..., None]) -> None:
    print(f"{seeds} seeds from {first}\n{'case':36} {'':5} {'held':>7} {'scatter':>9} {'stated':>9}")
    cases = {
        "motor, 3 voltages x 12, of reading": ((4.0, 5.5, 7.2), 12, False),
        "motor, 3 voltages x 12, of full scale": ((4.0, 5.5, 7.2), 12, True),
        "motor, 3 voltages x 5, of reading": ((4.0, 5.5, 7.2), 5, False),
        "motor, 1 voltage x 12, of reading": ((6.0,), 12, False),
    }
    for name, (voltages, points, full_scale) in cases.items():
        fits = [
            fit_motor(motor_bench(np.random.default_rng(s), voltages, points, full_scale)).estimates
            for s in range(first, first + seeds)
        ]
        held = line(name, MOTOR, fits)
        print(f"{name:36} {'all':5} {held:7.1%}")
        if (voltages, points, full_scale) == ((4.0, 5.5, 7.2), 12, False):
            record("identify_motor", 100 * held)
    for points in (6, 20):
        fits = [
            fit_rotor_coefficients(
                compute_loads(rotor_bench(np.random.default_rng(s), points)),
                radius_m=0.0875,
                density_kg_m3=1.2,
            )[0].estimates
            for s in range(first, first + seeds)
        ]
        print(f"{f'rotor, {points} speeds':36} {'all':5} {line(f'rotor, {points} speeds', ROTOR, fits):7.1%}")


if __name__ == "__main__":
    recorder = take_record_option(sys.argv)
    given = [int(a) for a in sys.argv[1:3]]
    main(*given, *(300, 0)[len(given) :], recorder)
