"""How avoidance does on many random scenes, and what a step of the mission costs.

python tests/mission/sweep.py [SCENES]         with the point mass of the tests, calm and pushed about
python tests/mission/sweep.py [SCENES] full    on the full nonlinear model, every other flight in wind and gusts
python tests/mission/sweep.py cost             microseconds for one step of the state machine
"""

import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import conftest
from conftest import fly, gusty, scene

from mufly.errors import InputError
from mufly.mission import load_mission, parse_mission
from mufly.world import compute_obstacle_distances


def missions(scenes):
    """Scenes whose goal and start are far enough from the obstacle."""
    for seed in range(scenes):
        kind, tables = scene(seed)
        try:
            yield seed, kind, parse_mission(tables)
        except InputError:
            continue


def report(name, flights):
    rows = defaultdict(list)
    for seed, kind, outcome, reason, clearance, duration in flights:
        rows[kind].append((outcome == "succeeded", clearance, duration))
        if outcome != "succeeded":
            print(f"  {name}, scene {seed}: {reason}")
    for kind, flown in sorted(rows.items()):
        arrived, clearance, duration = (np.array(column) for column in zip(*flown, strict=True))
        print(
            f"{name}: {kind}: {arrived.sum()} of {len(arrived)} arrived, least clearance of the centre "
            f"{clearance.min():.3f} m, mean time {duration.mean():.0f} s"
        )


def with_point_mass(scenes, push):
    for seed, kind, mission in missions(scenes):
        f = fly(mission, disturb=push)
        yield seed, kind, f.state.outcome, f.state.reason, f.clearance, f.time[-1]


def on_full_model(scenes):
    import mufly

    vehicle = mufly.load_vehicle("mufly-1.1")
    controller = mufly.control.design_flight_controller(vehicle)
    for seed, kind, mission in missions(scenes):
        air = {"wind": (0.35, 0.35, 0.0), "gust": 0.3, "seed": seed} if seed % 2 else {}
        ds = mufly.flight.fly_mission(vehicle, mission, controller=controller, **air)
        x = ds.truth_position.values
        clearance = compute_obstacle_distances(mission.world, x)[0][x[:, 2] < -0.3].min()
        yield seed, kind, ds.attrs["outcome"], ds.attrs["reason"], clearance, float(ds.time[-1])


def cost():
    for name in ("demonstration", "box-on-leg"):
        mission = load_mission(name)
        fly(mission)
        spent, steps, original = 0.0, 0, conftest.step

        def timed(*arguments, original=original):
            nonlocal spent, steps
            start = time.perf_counter()
            answer = original(*arguments)
            spent, steps = spent + time.perf_counter() - start, steps + 1
            return answer

        conftest.step = timed
        fly(mission)
        conftest.step = original
        print(f"{name}: {spent / steps * 1e6:.1f} microseconds a step, mean of {steps}")


if __name__ == "__main__":
    words = sys.argv[1:]
    count = next((int(w) for w in words if w.isdigit()), 100)
    if "cost" in words:
        cost()
    elif "full" in words:
        report("full model", on_full_model(count))
    else:
        report("calm", with_point_mass(count, None))
        report("pushed about", with_point_mass(count, gusty()))
