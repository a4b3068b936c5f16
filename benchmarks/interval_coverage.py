"""How often stated intervals hold the truth, on simulated benches and flights with known parameters.

    python benchmarks/interval_coverage.py bench [--seeds 300] [--first 0]          # fits of motors and rotors
    python benchmarks/interval_coverage.py seeds [--seeds 20] [--cma 0] [--moving]  # flights, 12 parameters (2 min)
    python benchmarks/interval_coverage.py vehicles [--seeds 20] [--held 0.02]      # flights, vehicles drawn anew
    python benchmarks/interval_coverage.py linear [--seeds 60]                      # linear models
    python benchmarks/interval_coverage.py series [--seeds 200] [--axis pair]       # series on a bench (10 min)
    python benchmarks/interval_coverage.py faults [--seeds 40]                      # series on a faulty bench

``--record`` writes the figures to ``docs/figures.json``; ``--json FILE`` writes the rows of seeds and vehicles.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from figure_record import RECORD_HELP, make_recorder
from scipy.signal import lfilter

from mufly.bench import BenchTable, compute_loads
from mufly.bench.rig.simulated_rig import SimulatedFaults, SimulatedRig
from mufly.bench.series.series_analysis import LOAD_NAMES, SeriesResult, analyse_series
from mufly.bench.series.series_plan import PlanStep, RotorAxis, SeriesPlan, make_series_plan
from mufly.bench.series.series_record import SeriesRecord
from mufly.bench.series.series_runner import run_series
from mufly.errors import MuflyError
from mufly.identify import (
    FitResult,
    choose_free_parameters,
    fit_flight_records,
    fit_motor,
    fit_rotor_coefficients,
    run_identification_demo,
)
from mufly.identify.flight.free_parameters import list_held_parameters
from mufly.identify.flight.identification_demo import (
    DEMO_FREE_SYMBOLS,
    RADIO_DELAY_S,
    fly_demo_flights,
    rms_over_true_noise,
)
from mufly.identify.flight_record import low_pass
from mufly.identify.linear.linear_fit import fit_linear_model
from mufly.identify.linear.linear_structure import build_structure_by_name, simulate_linear_structure
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters


def make_motor_bench(
    rng: np.random.Generator, truth: dict[str, float], voltages: Sequence[float], points: int, full_scale: bool
) -> BenchTable:
    """Stationary points at constant voltage with varied torque, errors of 1 % of the reading or of full scale."""
    u, resistance = np.repeat(voltages, points), truth["Rohm"]
    torque = np.concatenate([np.linspace(0.05, 0.85, points) * truth["kM"] * v / resistance for v in voltages])
    speed = (truth["kM"] * u / resistance - torque) / (truth["kM"] * truth["kE"] / resistance + truth["dR"])
    y = np.column_stack([u, (u - truth["kE"] * speed) / resistance, speed, torque])
    y += 0.01 * rng.standard_normal(y.shape) * (np.abs(y).max(axis=0) if full_scale else y)
    return _bench_table(dict(zip(("voltage", "current", "speed", "torque"), y.T, strict=True)))


def make_rotor_bench(rng: np.random.Generator, truth: dict[str, float], points: int) -> BenchTable:
    """Constant coefficients in air of 1.2 kg/m3, radius 87.5 mm; errors of 1 % of the reading."""
    speed = np.linspace(150, 450, points)[rng.permutation(points)]
    thrust = truth["cT"] * 1.2 * math.pi * 0.0875**4 * speed**2
    torque = truth["cQ"] * 1.2 * math.pi * 0.0875**5 * speed**2
    noise = 1 + 0.01 * rng.standard_normal((2, points))
    return _bench_table({"speed": speed, "thrust": thrust * noise[0], "torque": torque * noise[1]})


def _bench_table(columns: dict[str, np.ndarray]) -> BenchTable:
    return BenchTable("simulated", columns, {k: k for k in columns}, np.arange(len(next(iter(columns.values())))))


def print_bench_line(name: str, truth: dict[str, float], fits: list[Sequence[Any]]) -> float:
    """Print share held, scatter and mean stated deviation (% of the truth); return the share of all."""
    for symbol, true in truth.items():
        of = [next(e for e in fit if e.symbol == symbol) for fit in fits]
        held = np.mean([e.low <= true <= e.high for e in of])
        scatter, stated = np.std([e.value / true for e in of]), np.mean([e.std / true for e in of])
        print(f"{name:38} {symbol:5} {held:7.1%} {100 * scatter:9.3f} {100 * stated:9.3f}")
    every = float(np.mean([e.low <= truth[e.symbol] <= e.high for fit in fits for e in fit if e.symbol in truth]))
    print(f"{name:38} {'all':5} {every:7.1%}")
    return every


def report_bench(asked: argparse.Namespace) -> None:
    """Motor (constants of Table 5.3) and rotor fits: 95 % intervals over many noise seeds."""
    v, seeds = load_vehicle("mufly-1.1"), range(asked.first, asked.first + asked.seeds)
    m, upper = v.motor, v.rotors.upper
    constants = (m.back_emf_constant, m.torque_constant, m.resistance, m.friction)
    motor = dict(zip(("kE", "kM", "Rohm", "dR"), map(float, constants), strict=True))
    rotor = {"cT": float(upper.thrust_coefficient), "cQ": float(upper.torque_coefficient)}
    print(f"{asked.seeds} seeds from {asked.first}\n{'case':38} {'':5} {'held':>7} {'scatter':>9} {'stated':>9}")
    for voltages, points, full_scale in (
        ((4.0, 5.5, 7.2), 12, False), ((4.0, 5.5, 7.2), 12, True), ((4.0, 5.5, 7.2), 5, False), ((6.0,), 12, False),
    ):  # fmt: skip
        name = f"motor, {len(voltages)} voltages x {points}, of {'full scale' if full_scale else 'reading'}"
        tables = (make_motor_bench(np.random.default_rng(s), motor, voltages, points, full_scale) for s in seeds)
        held = print_bench_line(name, motor, [fit_motor(t).estimates for t in tables])
        if (len(voltages), points, full_scale) == (3, 12, False):
            asked.record("identify_motor", 100 * held)
    for points in (6, 20):
        loads = (compute_loads(make_rotor_bench(np.random.default_rng(s), rotor, points)) for s in seeds)
        fits = [fit_rotor_coefficients(x, radius_m=0.0875, density_kg_m3=1.2)[0].estimates for x in loads]
        print_bench_line(f"rotor, {points} speeds", rotor, fits)


def _cost_of(fit: FitResult, judge: FitResult) -> float:
    """Half the sum of squares of a fit's residuals over the noise that another fit found."""
    pairs = zip(fit.records_with_role("fit"), judge.records_with_role("fit"), strict=True)
    return sum(0.5 * float(np.nansum((a.residual / b.noise_std) ** 2)) for a, b in pairs)


def report_seeds(asked: argparse.Namespace) -> None:
    """Twelve parameters start 50 % off: convergence, 95 % intervals, held-out error over noise, seconds.

    ``--cma N`` repeats the first N seeds by CMA-ES and compares the costs; ``--moving`` begins records in mid-flight.
    """
    run_identification_demo(seed=10_000)  # compiles
    cpu_start, rows = time.process_time(), []
    for seed in range(asked.first, asked.first + asked.seeds):
        demo = run_identification_demo(seed=seed, moving=asked.moving)
        row: dict[str, Any] = {
            "seed": seed, "converged": demo.fit.converged, "cost": demo.fit.cost,
            "inside": demo.truth_inside_interval(),
            "worst_error": max(abs(e.value / demo.truth[e.symbol] - 1) for e in demo.fit.estimates),
            "held_out": demo.held_out_over_noise, "seconds": demo.fit.computing_time_s,
            "simulations": demo.fit.simulations, "message": demo.fit.message,
        }  # fmt: skip
        if seed - asked.first < asked.cma:
            other = run_identification_demo(seed=seed, method="cma", moving=asked.moving)
            off = [abs(a.value - b.value) / b.std for a, b in zip(other.fit.estimates, demo.fit.estimates, strict=True)]
            row["cma"] = {
                "cost_above_lm": _cost_of(other.fit, demo.fit) - _cost_of(demo.fit, demo.fit),
                "seconds": other.fit.computing_time_s, "simulations": other.fit.simulations,
                "largest_difference_in_std": max(off),
            }  # fmt: skip
        rows.append(row)
        print(
            f"seed {seed:3d}: {'converged' if row['converged'] else 'NOT converged'}, {sum(row['inside'].values())} of "
            f"{len(DEMO_FREE_SYMBOLS)} inside, worst {100 * row['worst_error']:.2f} %, held out {row['held_out']:.3f}, "
            f"{row['seconds']:.1f} s, {row['simulations']} simulations, load {os.getloadavg()[0]:.1f}"
            + (f", CMA-ES {row['cma']}" if "cma" in row else ""),
            flush=True,
        )
    inside = _print_inside(rows)
    seconds = [r["seconds"] for r in rows]
    print(
        f"held out at worst {max(r['held_out'] for r in rows):.3f}; seconds a fit, median {np.median(seconds):.1f}, "
        f"worst {max(seconds):.1f}; processor time a seed {(time.process_time() - cpu_start) / len(rows):.1f} s"
    )
    asked.record("identify_converged", sum(r["converged"] for r in rows))
    asked.record("identify_inside", 100 * inside)
    asked.record("identify_held_out", max(r["held_out"] for r in rows))
    _write_rows(asked, rows)


def _print_inside(rows: list[dict[str, Any]]) -> float:
    table = np.array([[r["inside"][s] for s in DEMO_FREE_SYMBOLS] for r in rows])
    print(f"{table.sum()} of {table.size} inside, {100 * table.mean():.1f} %; "
          f"{sum(r['converged'] for r in rows)} of {len(rows)} converged")  # fmt: skip
    print({s: round(float(v), 2) for s, v in zip(DEMO_FREE_SYMBOLS, table.mean(axis=0), strict=True)})
    return float(table.mean())


def _write_rows(asked: argparse.Namespace, rows: list[dict[str, Any]]) -> None:
    if asked.json is not None:
        asked.json.write_text(json.dumps(rows, indent=1, default=float), encoding="utf-8")


def draw_vehicle(nominal: Vehicle, rng: np.random.Generator, seed: int, moving: bool) -> tuple[Any, ...]:
    """Return the true values of the free parameters of a vehicle that can be flown, its flights, and rejected draws.

    Free parameters are uniform within 40 %, held ones log-normal with their stated deviation. A vehicle that the schema
    refuses or the pilot cannot hold (attitude beyond 35 degrees, 2 m of height) is drawn again.
    """
    by_symbol = {r.symbol: r for r in list_parameters(nominal)}
    free = choose_free_parameters(nominal, [s for s in DEMO_FREE_SYMBOLS if s != "delay"], ("height", "yaw"))
    held = [h for h in list_held_parameters(nominal, free, 0.0, None) if h.key]
    for rejected in range(200):
        values = {by_symbol[f.symbol].key: f.start_value * rng.uniform(0.6, 1.4) for f in free}
        values |= {h.key: h.start_value * math.exp(h.prior_std * rng.standard_normal()) for h in held}
        try:
            flights, others = fly_demo_flights(replace_parameters(nominal, values), seed=seed, moving=moving)
        except MuflyError:
            continue
        if all(_is_held_up(r) for r in (*flights, *others)):
            return {f.symbol: values[f.key] for f in free}, flights, others, rejected
    raise SystemExit("no vehicle in 200 could be flown")


def _is_held_up(record: Any) -> bool:
    of = dict(zip(record.output_names, record.measured.T, strict=True))
    tilt = max(np.abs(of["roll"]).max(), np.abs(of["pitch"]).max())
    return bool(np.isfinite(record.measured).all() and tilt < math.radians(35) and np.ptp(of["height"]) < 2.0)


def state_deviation(vehicle: Vehicle, share: float) -> Vehicle:
    """Return the vehicle with this relative standard deviation stated for every scalar that is not zero."""
    tables = vehicle.model_dump(exclude_none=True)
    for row in list_parameters(vehicle):
        if isinstance(row.value, float):
            table = tables
            for part in row.key.split("."):
                table = table[part]
            table["std"] = share * abs(row.value)
    return Vehicle.model_validate(tables)


def report_vehicles(asked: argparse.Namespace) -> None:
    """Vehicles within 40 % of mufly-1.1, held parameters drawn from their stated deviation (:func:`draw_vehicle`).

    ``--exact`` leaves the deviation of held parameters out of the intervals; ``--held`` states one for all of them.
    """
    nominal, rows = load_vehicle("mufly-1.1"), []
    if asked.held is not None:
        nominal = state_deviation(nominal, asked.held)
    for seed in range(asked.first, asked.first + asked.seeds):
        rng = np.random.default_rng([seed, 2])
        truth, flights, others, rejected = draw_vehicle(nominal, rng, seed, asked.moving)
        truth["delay"] = RADIO_DELAY_S
        delay = RADIO_DELAY_S * rng.uniform(0.6, 1.4)
        free = choose_free_parameters(nominal, DEMO_FREE_SYMBOLS, flights[0].output_names, delay_s=delay)
        fit = fit_flight_records(nominal, free, flights, held_out=others, held_exact=asked.exact)
        inside = {e.symbol: e.low <= truth[e.symbol] <= e.high for e in fit.estimates}
        sigmas = {e.symbol: (e.value - truth[e.symbol]) / e.std for e in fit.estimates}
        rows.append(
            {"seed": seed, "converged": fit.converged, "inside": inside, "sigmas": sigmas, "rejected": rejected,
             "held_out": rms_over_true_noise(fit.records[-1]), "message": fit.message, "truth": truth,
             "estimates": [asdict(e) for e in fit.estimates], "seconds": fit.computing_time_s}
        )  # fmt: skip
        worst = max(sigmas, key=lambda s: abs(sigmas[s]))
        print(
            f"vehicle {seed:3d}: {'converged' if fit.converged else 'NOT converged'}, {sum(inside.values())} of "
            f"{len(inside)} inside, worst {worst} {sigmas[worst]:+.1f} sigma, held out {rows[-1]['held_out']:.2f}, "
            f"{rejected} draws rejected, {fit.computing_time_s:.0f} s; {fit.message[:160]}",
            flush=True,
        )
        _write_rows(asked, rows)
    asked.record("identify_vehicles", 100 * _print_inside(rows))


LINEAR_TRUTH = {
    "L_p": -6.0, "L_q": 1.5, "L_lat": 18.0, "L_lon": -5.0, "M_q": -3.0, "M_p": 1.0, "M_lat": 3.0, "M_lon": 12.0,
    "tau_lat": 0.08, "tau_lon": 0.05,
}  # fmt: skip


def report_linear(asked: argparse.Namespace) -> None:
    """Coupled first-order roll and pitch rates, 60 s at 25 Hz, noise of 0.05 rad/s: white, and with a pole at 0.9."""
    structure, dt, samples, shares = (
        build_structure_by_name("first-order-coupled", ("lat", "lon"), ("p", "q")),
        0.04,
        1500,
        [],
    )
    truth = np.array([LINEAR_TRUTH[s] for s in structure.symbols])
    for pole in (0.0, 0.9):
        held: dict[str, list[np.ndarray]] = {"covariance": [], "bound": []}
        for seed in range(asked.first, asked.first + asked.seeds):
            rng = np.random.default_rng(seed)
            u = 0.1 * low_pass(np.repeat(rng.normal(size=(samples // 20, 2)), 20, axis=0), dt, 2.0)
            y, _ = simulate_linear_structure(structure, truth, u, dt)
            noise = lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], rng.normal(size=y.shape), axis=0)
            fit = fit_linear_model(structure, u, y + 0.05 * noise, dt, starts=1)
            for name, inside in held.items():
                inside.append(np.abs(fit.values - truth) < 1.96 * np.sqrt(np.diag(getattr(fit, name))))
        shares.append(100 * np.mean(held["covariance"]))
        print(f"pole {pole}: corrected {shares[-1]:.1f} %, plain bounds {100 * np.mean(held['bound']):.1f} %")
    asked.record("identify_linear", *shares)


def plan_axis_series(axis: RotorAxis) -> SeriesPlan:
    """Two pitches mounted twice, five speeds, three visits of the reference: 35 points, 50 as a pair."""
    return make_series_plan(
        "coverage", ["naca0012-r60-c20"], [10, 14], [3000, 4000, 5000, 6000, 7000], reference="naca4412-r60-c20",
        reference_pitch_deg=10, repetitions=2, reference_every=2, axis=axis,
    )  # fmt: skip


def measure_series(plan: SeriesPlan, seed: int, faults: SimulatedFaults | None = None) -> SeriesResult:
    """Run and analyse a series on a bench with motors, cells, drifts, weather and a calibration of its own."""
    rig = SimulatedRig(seed, faults=faults or SimulatedFaults())

    def truth(step: PlanStep) -> dict[str, float]:
        speeds = {a: rig.speed[a] for a in plan.mounting[step.mounting_index].driven_rotors}
        nominal = rig.true_loads(speeds, as_mounted=False)
        return rig.true_loads(speeds) | {f"nominal_{k}": v for k, v in nominal.items()}

    return analyse_series(run_series(plan, rig, SeriesRecord(), truth=truth))


def report_series(asked: argparse.Namespace) -> None:
    """95 % intervals of points and settings of series on simulated benches."""
    plan, began = plan_axis_series(asked.axis), time.perf_counter()
    hit, off, width, refused = defaultdict(list), defaultdict(list), defaultdict(list), 0
    for seed in range(asked.first, asked.first + asked.seeds):
        series = measure_series(plan, seed)
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
    print(f"{asked.seeds} series, {asked.axis}, {time.perf_counter() - began:.0f} s; refused {refused}")
    for key, v in hit.items():
        print(
            f"{key[0]:8s} {key[1]:13s} 95 % intervals hold {100 * np.mean(v):5.1f} % of {len(v)}; half width "
            f"{100 * np.median(width[key]):.2f} %, error {100 * np.sqrt(np.mean(np.square(off[key]))):.2f} % rms"
        )


def report_faults(asked: argparse.Namespace) -> None:
    """How often a series on a faulty bench is refused."""
    cases = {
        "none": SimulatedFaults(),
        "reference moved by 0.25 deg": SimulatedFaults(reference_moved_deg=0.25, reference_moved_after=2),
        "reference moved by 0.5 deg": SimulatedFaults(reference_moved_deg=0.5, reference_moved_after=1),
        "cell saturated": SimulatedFaults(force_cell_saturates=True),
        "nonsense in 5 % of the samples": SimulatedFaults(spike_share=0.05),
        "nonsense in 0.5 % of the samples": SimulatedFaults(spike_share=0.005),
        "speed not reached by 4 %": SimulatedFaults(speed_shortfall_fraction=0.04),
    }
    plan = plan_axis_series("upper")
    for name, fault in cases.items():
        kinds: dict[str, int] = defaultdict(int)
        refused = 0
        for seed in range(asked.first, asked.first + asked.seeds):
            try:
                found = {d.kind for d in measure_series(plan, seed, fault).fatal_issues}
            except MuflyError as error:
                found = {f"{type(error).__name__}: {error}"[:60]}
            refused += bool(found)
            for kind in found:
                kinds[kind] += 1
        print(f"{name:34s} refused {refused} of {asked.seeds}  {dict(kinds)}")


PARTS = {
    "bench": (report_bench, 300),
    "seeds": (report_seeds, 20),
    "vehicles": (report_vehicles, 20),
    "linear": (report_linear, 60),
    "series": (report_series, 200),
    "faults": (report_faults, 40),
}
"""Part: its function and its default number of seeds."""


def main() -> None:
    """Run a part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="part", required=True, metavar="PART")
    for name, (report, seeds) in PARTS.items():
        text = report.__doc__ or ""
        part = parts.add_parser(name, help=text.split("\n")[0].replace("%", "%%"), description=text)
        part.add_argument("--seeds", type=int, default=seeds, help=f"default {seeds}")
        part.add_argument("--first", type=int, default=0, help="first seed; default 0")
        if name in ("bench", "seeds", "vehicles", "linear"):
            part.add_argument("--record", action="store_true", help=RECORD_HELP)
        if name in ("seeds", "vehicles"):
            part.add_argument("--moving", action="store_true", help="records begin in mid-flight")
            part.add_argument("--json", type=Path, metavar="FILE", help="write the rows there")
        if name == "seeds":
            part.add_argument("--cma", type=int, default=0, help="repeat so many seeds by CMA-ES")
        if name == "vehicles":
            part.add_argument("--held", type=float, help="relative standard deviation of all held parameters")
            part.add_argument("--exact", action="store_true", help="held parameters count as exact")
        if name == "series":
            part.add_argument("--axis", choices=("upper", "pair"), default="upper", help="one rotor, or a pair")
    asked = parser.parse_args()
    asked.record = make_recorder(getattr(asked, "record", False))
    PARTS[asked.part][0](asked)


if __name__ == "__main__":
    main()
