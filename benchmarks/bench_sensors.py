"""What the sensors of a vehicle cost, a period of the flight software; beside it the plant of that period.

python benchmarks/bench_sensors.py [--vehicle mufly-2.0] [--cold]

Each sensor's time is the mean over periods in which it measures and in which it does not, ``worst`` that of the
longest (each period's best of several runs). ``--cold`` starts a process that has nothing compiled and times its
first readings.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

from mufly.dynamics import find_trim, integrate_state, model_parameters
from mufly.quantities.sensor_table import SENSORS
from mufly.sensors import Truth, make_fitted_sensors
from mufly.vehicle import load_vehicle
from mufly.world import World

RATE_HZ, PERIODS, RUNS = 200, 1000, 5


def truths(vehicle) -> list[Truth]:
    """A hover with a little motion in it."""
    state, rng, found = find_trim(vehicle).state, np.random.default_rng(0), []
    for k in range(PERIODS):
        x = state.copy()
        x[0:3] = [0.1 * np.sin(0.01 * k), 0.0, -1.0]
        x[3:6], x[10:13] = 0.1 * rng.standard_normal(3), 0.1 * rng.standard_normal(3)
        found.append(Truth(k / RATE_HZ, k, x, np.zeros(3), np.zeros(3), 7.4, 2.0))
    return found


def mean_and_worst_us(read, flown, again=lambda: None) -> tuple[float, float]:
    """Every period's best of several runs: what else the machine does is left out."""
    best = np.full(len(flown) - 1, np.inf)
    for _ in range(RUNS):
        again()
        read(flown[0])
        for k, truth in enumerate(flown[1:]):
            start = time.perf_counter()
            read(truth)
            best[k] = min(best[k], time.perf_counter() - start)
    return 1e6 * float(best.mean()), 1e6 * float(best.max())


def cold(name: str) -> None:
    code = (
        "import time; from mufly.vehicle import load_vehicle; from mufly.world import World\n"
        "from mufly.dynamics import trim; from mufly.sensors import make_fitted_sensors, Truth; import numpy as np\n"
        f"v = load_vehicle({name!r}); x = trim(v).state; a = time.perf_counter()\n"
        "s = make_fitted_sensors(v, World())\n"
        "for k in range(20): s.read(Truth(k / 200, k, x, np.zeros(3), np.zeros(3), 7.4, 2.0))\n"
        "print(f'  first readings of all sensors: {time.perf_counter() - a:.2f} s')"
    )
    with tempfile.TemporaryDirectory() as folder:
        # Both names: the package's own, and Numba's.
        env = {**os.environ, "NUMBA_CACHE_DIR": folder, "MUFLY_NUMBA_CACHE": folder}
        for said in ("nothing compiled", "compiled before"):
            print(said)
            subprocess.run([sys.executable, "-c", code], env=env, check=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicle", default="mufly-2.0")
    parser.add_argument("--cold", action="store_true")
    asked = parser.parse_args()
    vehicle, world = load_vehicle(asked.vehicle), World()
    flown = truths(vehicle)
    p, hover = model_parameters(vehicle), find_trim(vehicle)
    x, calm = hover.state.copy(), np.zeros(3)
    plant, _ = mean_and_worst_us(lambda _: integrate_state(x, hover.input, calm, p, 1e-3, 5), flown)
    print(f"plant, 5 steps of 1 ms: {plant:.1f} us a period")
    for only in [[name] for name in SENSORS] + [list(SENSORS)]:
        suite = make_fitted_sensors(vehicle, world, only=only)
        mean, worst = mean_and_worst_us(suite.read, flown, suite.reset)
        label = only[0] if len(only) == 1 else "all"
        print(f"{label:14s} {mean:7.1f} us a period, {mean / plant:5.1f} times the plant; worst {worst:.0f} us")
    if asked.cold:
        cold(asked.vehicle)


if __name__ == "__main__":
    main()
