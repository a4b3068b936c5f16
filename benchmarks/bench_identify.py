"""How fast is identification? Simulated flights a second within a fit, beside pycma on SciPy's integrator.

    python benchmarks/bench_identify.py [--json] [--quick]

- Rates of the batched output-error simulator: flights of 10 s at 100 Hz, held inputs, with and without a delay.
- A whole fit of the demonstration: records flown over wall time, everything counted (derivatives, algebra, output).
- Peer, in the same run: pycma whose cost simulates a record of the demonstration with ``scipy.integrate.solve_ivp``
  (RK45, the model's own compiled right-hand side, one call a sample interval because inputs are held). It is timed for
  a few generations; a fit takes hundreds.

The load of the machine is printed, because other work on it slows everything here.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings

import numba
import numpy as np
from scipy.integrate import solve_ivp

import mufly
from mufly.dynamics import PARAMETER_DTYPE, find_trim, model_parameters, state_derivative
from mufly.identify import choose_free_parameters, run_identification_demo
from mufly.identify.flight.batch_simulation import simulate_batch
from mufly.identify.flight.identification_demo import fly_demo_flights
from mufly.identify.flight.output_error_problem import make_problem
from mufly.identify.flight_record import FLIGHT_OUTPUTS

CALM = np.zeros(3)


def simulator_rate(batch: int, delay_s: float, repeats: int) -> float:
    """Flights of 10 s a second, best of several runs."""
    vehicle = mufly.load_vehicle("mufly-1.1")
    hover, n = find_trim(vehicle), 1001
    p = np.full(batch, np.array(model_parameters(vehicle, 7.2)), dtype=PARAMETER_DTYPE)
    p["contact_reach"] = -1e9
    t = np.arange(n) * 0.01
    u = np.tile(hover.input, (n, 1))
    u[:, 2] += 0.1 * np.sin(2 * np.pi * (0.3 + 0.15 * t) * t)
    codes = np.array([FLIGHT_OUTPUTS.index(o) for o in ("height", "roll", "pitch", "yaw", "p", "q", "r")])
    mast, motion = np.tile([0.0, 0.0, -1.0], (n, 1)), np.zeros((batch, 1, 12))
    shortest = np.inf
    for _ in range(repeats + 1):
        x = np.tile(hover.state, (batch, 1))
        start = time.perf_counter()
        simulate_batch(x, p, u, sample_s=0.01, codes=codes, starts=np.array([0]), motion=motion, mast=mast,
                  delay_s=np.full(batch, delay_s))  # fmt: skip
        shortest = min(shortest, time.perf_counter() - start)
    return batch / shortest


def peer_rate(generations: int) -> tuple[float, float]:
    """Flights of 10 s a second of pycma with SciPy's solve_ivp, and seconds a generation, on one core."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import cma

    truth = mufly.load_vehicle("mufly-1.1")
    records, _ = fly_demo_flights(truth, seed=0, seconds=10.0)
    free = choose_free_parameters(truth, ("Izz", "Iyy", "l_up", "l_dw"), records[0].output_names)
    problem = make_problem(truth, free, records[2:3], voltage="nominal", delay_s=0.0)
    record = problem.records[0]
    from mufly.identify.flight.free_parameters import find_field_changes, parameters_at_theta

    base, changes = find_field_changes(truth, free, 7.2)
    hover, rates = find_trim(truth), np.empty(21)
    columns = [FLIGHT_OUTPUTS.index(o) for o in record.output_names]
    flights = 0

    def cost(theta: np.ndarray) -> float:
        nonlocal flights
        flights += 1
        p = parameters_at_theta(base, changes, np.asarray(theta)[None])[0]
        x, total = hover.state.copy(), 0.0
        for k in range(len(record.time_s) - 1):
            u = record.inputs[k]

            def right(_: float, y: np.ndarray, u: np.ndarray = u) -> np.ndarray:
                state_derivative(y, u, CALM, p, rates)
                return rates.copy()

            x = solve_ivp(right, (0.0, record.sample_s), x, rtol=1e-4, atol=1e-6, max_step=2.5e-3).y[:, -1]
            y = np.array([0, 0, -x[2], 0, 0, 0, 0, 0, 0, x[10], x[11], x[12], 0, 0, 0])
            e = (y[columns] - record.measured[k])[[o in ("height", "p", "q", "r") for o in record.output_names]]
            total += float(np.nansum(e * e))
        return total

    strategy = cma.CMAEvolutionStrategy(np.zeros(4), 0.1, {"verbose": -9, "seed": 1, "popsize": 8})
    cost(np.zeros(4))
    flights = 0
    start = time.perf_counter()
    for _ in range(generations):
        z = strategy.ask()
        strategy.tell(z, [cost(v) for v in z])
    seconds = time.perf_counter() - start
    return flights / seconds, seconds / generations


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--quick", action="store_true", help="fewer repeats")
    arguments = parser.parse_args()
    repeats = 3 if arguments.quick else 15
    result: dict[str, float] = {"cores": numba.get_num_threads(), "load average before": os.getloadavg()[0]}
    result["simulator, 10 s flights/s, no delay"] = simulator_rate(200, 0.0, repeats)
    result["simulator, 10 s flights/s, delay 25 ms"] = simulator_rate(200, 0.025, repeats)
    result["simulator, steps/s"] = 1000 * result["simulator, 10 s flights/s, no delay"]
    run_identification_demo(seed=10_000)
    cpu = time.process_time()
    demo = run_identification_demo(seed=0)
    cpu = time.process_time() - cpu
    share = 12.0 / 10.0  # its records are 12 s long
    result["fit: 10 s flights/s, all else included"] = demo.fit.simulations * share / demo.fit.computing_time_s
    result["fit: seconds"] = demo.fit.computing_time_s
    result["fit: seconds of processor, flying the records included"] = cpu
    result["fit: records flown"] = demo.fit.simulations
    cma = run_identification_demo(seed=0, method="cma")
    result["CMA-ES fit: 10 s flights/s, all else included"] = cma.fit.simulations * share / cma.fit.computing_time_s
    result["CMA-ES fit: seconds"] = cma.fit.computing_time_s
    result["CMA-ES fit: records flown"] = cma.fit.simulations
    rate, each = peer_rate(1 if arguments.quick else 2)
    result["peer (pycma + solve_ivp): 10 s flights/s"] = rate
    result["peer: seconds a generation of 8"] = each
    result["times the peer, CMA-ES fit"] = result["CMA-ES fit: 10 s flights/s, all else included"] / rate
    result["load average after"] = os.getloadavg()[0]
    if arguments.json:
        print(json.dumps(result, indent=2))
        return
    for name, value in result.items():
        print(f"{name:58s} {value:14,.2f}")


if __name__ == "__main__":
    main()
