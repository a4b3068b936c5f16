"""How avoidance does on many random scenes: python tests/mission/sweep.py [scenes]. Prints one line a kind."""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from conftest import fly, gusty, scene

from mufly.errors import InputError
from mufly.mission import mission_from


def main(scenes: int) -> None:
    for name, push in (("calm", None), ("pushed about", gusty())):
        rows = defaultdict(list)
        for seed in range(scenes):
            kind, tables = scene(seed)
            try:
                mission = mission_from(tables)
            except InputError:
                continue  # the goal or the start lies too near to an obstacle
            flight = fly(mission, disturb=push)
            rows[kind].append((flight.state.outcome == "succeeded", flight.clearance, flight.time[-1]))
            if flight.state.outcome != "succeeded":
                print(f"  {name}, scene {seed}: {flight.state.reason}")
        for kind, flown in sorted(rows.items()):
            arrived, clearance, time = (np.array(column) for column in zip(*flown, strict=True))
            print(
                f"{name}: {kind}: {arrived.sum()} of {len(arrived)} arrived, least clearance of the centre "
                f"{clearance.min():.3f} m, mean time {time.mean():.0f} s"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 400)
