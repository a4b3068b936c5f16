"""False tilt of clipped accelerometers: what a low pass of a second makes of a shaken board that stands level.

python benchmarks/false_tilt.py [--units 30] [--vehicle mufly-1.1]
"""

import argparse
import math

import numpy as np

from mufly.dynamics import find_trim
from mufly.sensors import Truth, fitted_sensors
from mufly.units import STANDARD_GRAVITY_M_S2
from mufly.vehicle import load_vehicle, replace_parameters
from mufly.world import World

RATE_HZ, SECONDS, LAG_S = 200, 6.0, 1.0


def tilts_deg(name: str, once_g: float, twice_g: float, units: int) -> np.ndarray:
    """Median over the second half of each unit's run."""
    vehicle = replace_parameters(
        load_vehicle(name),
        {
            "sensors.imu.vibration.once": once_g * STANDARD_GRAVITY_M_S2,
            "sensors.imu.vibration.twice": twice_g * STANDARD_GRAVITY_M_S2,
            "sensors.imu.vibration.passing": 0.0,
        },
    )
    state = find_trim(vehicle).state
    found = []
    for seed in range(units):
        imu = fitted_sensors(vehicle, World(), seed=seed, only=["imu"])
        low, shown = None, []
        for k in range(round(RATE_HZ * SECONDS)):
            truth = Truth(k / RATE_HZ, k, state, np.zeros(3), np.zeros(3), 7.4, 2.0)
            felt = imu.read(truth)["acceleration"].value
            low = felt if low is None else low + (felt - low) / (RATE_HZ * LAG_S)
            shown.append(math.degrees(math.atan2(math.hypot(low[0], low[1]), -low[2])))
        found.append(np.median(shown[len(shown) // 2 :]))
    return np.array(found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--units", type=int, default=30)
    parser.add_argument("--vehicle", default="mufly-1.1")
    asked = parser.parse_args()
    for once, twice in ((0, 0), (4, 2), (6, 3), (8, 4)):
        t = tilts_deg(asked.vehicle, once, twice, asked.units)
        low, high = np.percentile(t, [10, 90])
        print(f"{once} + {twice} g: median {np.median(t):.1f} deg, 10 to 90 %: {low:.1f} to {high:.1f} deg")
