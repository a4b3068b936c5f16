"""How fast is the plant alone? Runge-Kutta steps a second, beside two peers and the machine's own limit.

    python benchmarks/bench_dynamics.py [--json] [--quick]

Every number is the best of several runs. The peers run the same equations in the same process:

- SciPy: ``solve_ivp(RK45)`` on the pure Python source of the model, and on the compiled right-hand side;
- NumPy: the model's own source with ``math`` exchanged for NumPy, so that it works on a whole batch at once.

The machine's limit is the rate at which one core multiplies and adds, one number at a time and in vector registers,
on data in its first cache; operations of a step are counted by running the model on numbers that count.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import os
import tempfile
import time
import types
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
from numba import njit, prange
from scipy.integrate import solve_ivp

import mufly
from mufly.dynamics import (
    PARAMETER_DTYPE,
    find_trim,
    initial_state,
    integrate_batch,
    integrate_state,
    model_parameters,
    standing_height,
    state_derivative,
)
from mufly.dynamics import equations_of_motion as model_source
from mufly.errors import MuflyError
from mufly.fmi import UnitInstance, UnitLibrary, export_fmu

STEP = 1e-3
TARGET_SINGLE, TARGET_BATCH, BATCH = 0.5e6, 4e6, 1000
CALM = np.zeros(3)
FLIGHT_MAP = {"rotors.flight_map": "mufly-1.1-hinged"}


def best(run: Callable[[], object], repeats: int) -> float:
    """Shortest of several runs (s)."""
    shortest = math.inf
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        shortest = min(shortest, time.perf_counter() - start)
    return shortest


class Counting(float):
    """A float that counts the arithmetic done with it."""

    operations = 0


def _counted(name: str) -> Callable[..., Counting]:
    plain = getattr(float, name)

    def operate(self: Counting, *others: float) -> Counting:
        Counting.operations += 1
        return Counting(plain(self, *(float(o) for o in others)))

    return operate


for _name in ("add", "radd", "sub", "rsub", "mul", "rmul", "truediv", "rtruediv", "neg", "abs"):
    setattr(Counting, f"__{_name}__", _counted(f"__{_name}__"))


def source_with(replacements: dict[str, object], parameters: object) -> Callable[..., None]:
    """The model's own Python source, with other functions under the names that it calls."""
    functions = {k: f for k, f in vars(model_source).items() if hasattr(f, "py_func")}
    constants: dict[str, object] = {}  # of the other modules that functions come from
    for f in functions.values():
        constants |= f.py_func.__globals__
    scope = {**constants, **vars(model_source), **replacements}

    def from_source(dispatcher: object) -> types.FunctionType:
        return types.FunctionType(dispatcher.py_func.__code__, scope)

    scope |= {k: from_source(f) for k, f in functions.items() if k not in replacements}
    run = from_source(state_derivative)
    return lambda x, u, wind, dx: run(x, u, wind, parameters, dx)


class _OutOfReach:
    """Stands for the reach of the legs, so that no vehicle of a batch asks whether it touches the floor."""

    __array_ufunc__ = None

    def __radd__(self, other: object) -> float:
        return -1.0

    __add__ = __radd__


def parameters_for(p: np.void, number: Callable[[float], object]) -> types.SimpleNamespace:
    whole = ("contact_count", "map_node_count")
    plain = {n: number(float(p[n])) for n in PARAMETER_DTYPE.names if p[n].ndim == 0 and n not in whole}
    return types.SimpleNamespace(
        **{
            **plain,
            "map_node_count": int(p["map_node_count"]),
            "battery_curve": p["battery_curve"],
            "contact_reach": _OutOfReach(),
        }
    )


def operations_per_step(p: np.void, x: np.ndarray, u: np.ndarray) -> int:
    """Additions, multiplications, divisions, roots, sines and cosines of one Runge-Kutta step."""

    def math_of(name: str) -> Callable[[float], Counting]:
        def operate(value: float) -> Counting:
            Counting.operations += 1
            return Counting(getattr(math, name)(value))

        return operate

    counting_math = types.SimpleNamespace(**{n: math_of(n) for n in ("sin", "cos", "sqrt")})

    def interpolation(table: np.ndarray, fraction: float) -> Counting:
        return Counting(np.interp(fraction, np.linspace(0, 1, len(table)), table))

    counting = parameters_for(p, Counting)
    counting.contact_reach = Counting(0.0)
    run = source_with({"math": counting_math, "interpolate_table": interpolation}, counting)
    Counting.operations = 0
    run([Counting(v) for v in x], [Counting(v) for v in u], [Counting(0.0)] * 3, [0.0] * 21)
    combine, normalise = 21 * (3 * 2 + 7), 9 + 7 + 7
    return 4 * Counting.operations + combine + normalise


def numpy_step(p: np.void) -> Callable[[np.ndarray, np.ndarray, np.ndarray], None]:
    """Runge-Kutta step of a batch laid out (21, n), every operation a NumPy call over the batch."""
    curve, fractions = p["battery_curve"], np.linspace(0, 1, len(p["battery_curve"]))
    run = source_with(
        {
            "math": np,
            "min": np.minimum,
            "max": np.maximum,
            "interpolate_table": lambda table, fraction: np.interp(fraction, fractions, curve),
        },
        parameters_for(p, float),
    )

    def step(x: np.ndarray, u: np.ndarray, wind: np.ndarray) -> None:
        k = np.empty((4, *x.shape))
        run(x, u, wind, k[0])
        run(x + 0.5 * STEP * k[0], u, wind, k[1])
        run(x + 0.5 * STEP * k[1], u, wind, k[2])
        run(x + STEP * k[2], u, wind, k[3])
        x += STEP / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
        x[6:10] /= np.linalg.norm(x[6:10], axis=0)
        x[15:18] /= np.linalg.norm(x[15:18], axis=0)

    return step


@njit
def _scalar_peak(n: int, a: float, b: float) -> float:
    x0 = x1 = x2 = x3 = x4 = x5 = x6 = x7 = 0.1
    for _ in range(n):
        x0, x1, x2, x3 = x0 * a + b, x1 * b + a, x2 * a + a, x3 * b + b
        x4, x5, x6, x7 = x4 * a - b, x5 * b - a, x6 * a - a, x7 * b - b
    return x0 + x1 + x2 + x3 + x4 + x5 + x6 + x7


@njit(parallel=True, fastmath=True)
def _vector_peak(n: int, threads: int, a: float, b: float) -> float:
    total = 0.0
    for t in prange(threads):
        y = np.full(256, 0.1 + t)
        for _ in range(n):
            for i in range(256):
                v = y[i]
                for _k in range(8):
                    v = v * a + b
                y[i] = v
        total += y.sum()
    return total


def machine_limit(cores: int) -> tuple[float, float]:
    """Multiplications and additions a second: of one core on single numbers, of all cores in vector registers."""
    n = 400_000
    _scalar_peak(10, 0.5, 0.3)
    _vector_peak(10, cores, 0.5, 0.3)
    scalar = 16 * n / best(lambda: _scalar_peak(n, 0.5, 0.3), 10)
    vector = cores * 20_000 * 256 * 16 / best(lambda: _vector_peak(20_000, cores, 0.5, 0.3), 10)
    return scalar, vector


def unit_rates(vehicle: mufly.vehicle.Vehicle, u: np.ndarray, steps: int, repeats: int) -> dict[str, float]:
    """Steps a second of the vehicle's co-simulation unit in flight; none without a C compiler."""
    with tempfile.TemporaryDirectory() as folder:
        export_fmu(vehicle, Path(folder) / "unit.fmu")
        try:
            unit = UnitLibrary(Path(folder) / "unit.fmu", Path(folder) / "unit")
        except MuflyError:
            return {}
        one = UnitInstance(unit).initialise({"start.position_down": -1e6, **dict(zip(unit.inputs, u, strict=False))})

        def from_python() -> None:
            for _ in range(500):
                one.do_step(0.0, 4 * STEP)

        return {
            "co-simulation unit in C": steps / best(lambda: one.do_step(0.0, steps * STEP), repeats),
            "co-simulation unit, 4 steps a call from Python": 2000 / best(from_python, repeats),
        }


def measure(quick: bool) -> dict[str, float]:
    vehicle = mufly.load_vehicle("mufly-1.1")
    hover, p = find_trim(vehicle), model_parameters(vehicle)
    start, u = hover.state.copy(), hover.input + np.array([0, 0, 0.1, -0.1])
    start[2] = -50.0
    repeats, steps = (5, 5_000) if quick else (40, 20_000)
    cores = numba.get_num_threads()
    x = start.copy()
    integrate_state(x, u, CALM, p, STEP, 1)

    result: dict[str, float] = {"cores": cores}
    result["one vehicle"] = steps / best(lambda: integrate_state(x, u, CALM, p, STEP, steps), repeats)
    mapped = mufly.vehicle.replace_parameters(
        vehicle, {"rotors.coefficient_map": mufly.vehicle.list_builtin_coefficient_maps()[0]}
    )
    with_map, y, hold = model_parameters(mapped), find_trim(mapped).state.copy(), find_trim(mapped).input
    y[2] = -50.0
    result["one vehicle, coefficient map"] = steps / best(
        lambda: integrate_state(y, hold, CALM, with_map, STEP, steps), repeats
    )

    flown, z = model_parameters(mufly.vehicle.replace_parameters(vehicle, FLIGHT_MAP)), start.copy()
    result["one vehicle, flight map"] = steps / best(lambda: integrate_state(z, u, CALM, flown, STEP, steps), repeats)

    def from_python() -> None:
        for _ in range(500):
            integrate_state(x, u, CALM, p, STEP, 4)

    result["one vehicle, 4 steps a call from Python"] = 2000 / best(from_python, repeats)
    standing = initial_state(position=(0, 0, -standing_height(vehicle)))
    still = np.zeros(4)
    result["one vehicle, standing"] = steps / best(
        lambda: integrate_state(standing, still, CALM, p, STEP, steps), repeats
    )

    result |= unit_rates(vehicle, u, steps, repeats)

    xs, us = np.tile(start, (BATCH, 1)), np.tile(u, (BATCH, 1))
    winds, ps = np.zeros((BATCH, 3)), np.full(BATCH, np.array(p), dtype=PARAMETER_DTYPE)
    integrate_batch(xs, us, winds, ps, STEP, 1)
    n = 100 if quick else 1000
    result[f"batch of {BATCH}, {cores} cores"] = (
        BATCH * n / best(lambda: integrate_batch(xs, us, winds, ps, STEP, n), 7)
    )

    flown_batch = np.full(BATCH, np.array(flown), dtype=PARAMETER_DTYPE)
    xs = np.tile(start, (BATCH, 1))
    integrate_batch(xs, us, winds, flown_batch, STEP, 1)
    result[f"batch of {BATCH}, flight map"] = (
        BATCH * n / 4 / best(lambda: integrate_batch(xs, us, winds, flown_batch, STEP, n // 4), 7)
    )

    # Peers.
    step, lanes = numpy_step(p), np.ascontiguousarray(np.tile(start, (BATCH, 1)).T)
    inputs, air = np.ascontiguousarray(us.T), np.zeros((3, BATCH))
    check = lanes.copy()
    step(check, inputs, air)
    reference = start.copy()
    integrate_state(reference, u, CALM, p, STEP, 1)
    assert np.max(np.abs(check[:, 0] - reference)) < 1e-12, "the NumPy peer solves other equations"
    result[f"peer: NumPy over a batch of {BATCH}"] = (
        BATCH * 5 / best(lambda: [step(lanes, inputs, air) for _ in range(5)], 5)
    )

    rates = np.empty(21)
    python = source_with(
        {"interpolate_table": lambda t, f: np.interp(f, np.linspace(0, 1, len(t)), t)}, parameters_for(p, float)
    )

    def pure(_: float, state: np.ndarray) -> np.ndarray:
        dx = [0.0] * 21
        python(state.tolist(), u.tolist(), [0.0, 0.0, 0.0], dx)
        return np.array(dx)

    def compiled(_: float, state: np.ndarray) -> np.ndarray:
        state_derivative(state, u, CALM, p, rates)
        return rates.copy()

    for label, right_hand_side in (("pure Python", pure), ("compiled", compiled)):
        span = 0.1 if quick else 0.5
        solve = functools.partial(solve_ivp, right_hand_side, (0, span), start, rtol=1e-6, max_step=STEP)
        evaluations = solve().nfev
        result[f"peer: SciPy RK45, {label} (4 evaluations = 1 step)"] = evaluations / 4 / best(solve, 3)

    result["operations per step"] = operations_per_step(p, start, u)
    (
        result["limit: multiply-adds/s, one core, scalar"],
        result["limit: multiply-adds/s, all cores, vector"],
    ) = machine_limit(cores)
    return result


def print_table(r: dict[str, float]) -> None:
    from rich.console import Console
    from rich.table import Table

    cores = int(r["cores"])
    batch_name = f"batch of {BATCH}, {cores} cores"
    mapped_batch = f"batch of {BATCH}, flight map"
    targets = {"one vehicle": TARGET_SINGLE, batch_name: TARGET_BATCH}
    numpy_peer = r[f"peer: NumPy over a batch of {BATCH}"]
    table = Table("plant alone", box=None, header_style="bold")
    for heading in ("steps/s", "target", "times the peer", "of the machine's limit"):
        table.add_column(heading, justify="right")
    for name, value in r.items():
        if name in ("cores", "operations per step") or name.startswith(("limit", "load")):
            continue
        scipy_peer = r["peer: SciPy RK45, compiled (4 evaluations = 1 step)"]
        peer = (
            ""
            if name.startswith("peer")
            else f"{value / (numpy_peer if name in (batch_name, mapped_batch) else scipy_peer):.0f}"
        )
        limit = r[
            "limit: multiply-adds/s, all cores, vector"
            if name in (batch_name, mapped_batch)
            else "limit: multiply-adds/s, one core, scalar"
        ]
        share = "" if name.startswith("peer") else f"{value * r['operations per step'] / limit:.1%}"
        target = f"{targets[name]:,.0f}" if name in targets else ""
        table.add_row(name, f"{value:,.0f}", target, peer, share)
    console = Console()
    console.print(table)
    shares = [
        r[with_map] / r[name]
        for name, with_map in (("one vehicle", "one vehicle, flight map"), (batch_name, mapped_batch))
    ]
    console.print(
        f"with a flight map {shares[0]:.0%} of the speed of one vehicle (target 60 %), {shares[1]:.0%} of a batch"
    )
    console.print(
        f"\n{r['operations per step']:.0f} operations a step (a root, sine or division counts as one); "
        f"{r['limit: multiply-adds/s, one core, scalar'] / 1e9:.1f} G/s scalar on one core, "
        f"{r['limit: multiply-adds/s, all cores, vector'] / 1e9:.0f} G/s in vectors on {cores}. "
        "Single vehicle: against SciPy on the compiled model and one core's scalar limit; "
        "batch: against NumPy and the vector limit of all cores.",
        highlight=False,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON and nothing else")
    parser.add_argument("--quick", action="store_true", help="shorter runs")
    arguments = parser.parse_args()
    result = measure(arguments.quick)
    result["load average before"] = os.getloadavg()[0]
    if arguments.json:
        print(json.dumps(result, indent=2))
    else:
        print_table(result)


if __name__ == "__main__":
    main()
