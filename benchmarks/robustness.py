"""How the demonstration flies with other vehicles and in other air.

    python benchmarks/robustness.py [vehicles] [wind] [storm] [--count N]

``vehicles``: every parameter of mufly-1.1 off by up to 10 % at random, controllers designed anew. ``wind``: 0.5 m/s
from random directions with gusts of 0.3 m/s. ``storm``: 1.5 m/s with 0.6 m/s. Prints a line a flight
and the worst of each.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator

import numpy as np

from mufly.control import design
from mufly.errors import MuflyError
from mufly.flight import Summary, events_of, fly, summarise
from mufly.mission import load_mission
from mufly.vehicle import Vehicle, load_vehicle, parameters, replace

MISSION = load_mission("demonstration")


def flown(vehicle: Vehicle, **how: object) -> Summary:
    dataset = fly(vehicle, MISSION, **how)
    return summarise(dataset, [w.position_m for w in MISSION.waypoint], events_of(dataset))


def vehicles(count: int) -> Iterator[Summary | str]:
    base, random = load_vehicle("mufly-1.1"), np.random.default_rng(1)
    for _ in range(count):
        values = {}
        for p in parameters(base):
            if (
                isinstance(p.value, float)
                and not p.key.startswith("mass_budget")
                and p.key != "range_ring.first_angle"
            ):
                # Efficiency and linkage cannot exceed 1.
                value = p.value * (1.0 + 0.1 * random.uniform(-1.0, 1.0))
                values[p.key] = min(value, 1.0) if p.unit == "1" and p.value <= 1.0 else value
        try:
            yield flown(replace(base, values))
        except MuflyError as error:
            yield str(error)


def in_air(count: int, speed: float, gust: float) -> Iterator[Summary | str]:
    vehicle, random = load_vehicle("mufly-1.1"), np.random.default_rng(2)
    controller = design(vehicle)
    for seed in range(count):
        towards = random.uniform(0.0, math.tau)
        wind = (speed * math.cos(towards), speed * math.sin(towards), 0.0)
        yield flown(vehicle, controller=controller, wind=wind, gust=gust, seed=seed)


def report(name: str, flights: Iterator[Summary | str]) -> None:
    print(f"{name}\n{'':6}reached  off by  overshoot  touchdown  railed")
    rows = []
    for k, s in enumerate(flights):
        if isinstance(s, str):
            print(f"{k:4}  refused: {s}")
            continue
        met = [w for w in s.waypoints if w.reached_s is not None]
        row = (
            100 * max((w.distance_at_reach_m or 0.0 for w in met), default=math.nan),
            100 * max((w.overshoot_m or 0.0 for w in met), default=math.nan),
            s.touchdown_speed_m_s or math.nan,
            s.longest_railed_s,
        )
        rows.append(row)
        why = "" if s.outcome == "succeeded" else f"  {s.reason}"
        print(
            f"{k:4}{len(met):7}/4 {row[0]:5.1f} cm {row[1]:7.1f} cm {row[2]:6.2f} m/s {row[3]:5.2f} s{why}",
            flush=True,
        )
    worst = np.array(rows).max(axis=0)
    print(f"worst{'':8} {worst[0]:5.1f} cm {worst[1]:7.1f} cm {worst[2]:6.2f} m/s {worst[3]:5.2f} s\n")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    kinds = ("vehicles", "wind", "storm")
    parser.add_argument("what", nargs="*", help=f"{', '.join(kinds)}; all by default")
    parser.add_argument("--count", type=int, default=0, help="flights of each kind; 40, 20 and 10 by default")
    asked = parser.parse_args()
    if unknown := set(asked.what) - set(kinds):
        parser.error(f"unknown: {', '.join(unknown)}; choose from {', '.join(kinds)}")
    asked.what = asked.what or kinds
    if "vehicles" in asked.what:
        report("vehicles off by 10 %", vehicles(asked.count or 40))
    if "wind" in asked.what:
        report("wind 0.5 m/s, gusts 0.3 m/s", in_air(asked.count or 20, 0.5, 0.3))
    if "storm" in asked.what:
        report("wind 1.5 m/s, gusts 0.6 m/s", in_air(asked.count or 10, 1.5, 0.6))


if __name__ == "__main__":
    main()
