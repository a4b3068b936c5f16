"""How the demonstration flies with other vehicles and in other air.

    python benchmarks/robustness.py [vehicles] [wind] [storm] [--count N]
    python benchmarks/robustness.py nominal --count 1000 [--lightest] [--out FILE]

``nominal``: vehicles off by up to 10 % flown with the controllers of ``mufly-1.1``, in 0.5 m/s of wind with gusts of
0.3 m/s: take-off, hover, a leg, landing; on all cores, a line a flight into FILE, which a second call goes on from.
``--lightest`` flies those of a thousand that hover at the least input. ``vehicles``: every parameter of mufly-1.1 off
by up to 10 % at random, controllers designed anew. ``wind``: 0.5 m/s from random directions with gusts of 0.3 m/s.
``storm``: 1.5 m/s with 0.6 m/s. Prints a line a flight and the worst of each.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from pathlib import Path

import numpy as np

from mufly.control import FlightController, design
from mufly.dynamics import trim
from mufly.errors import MuflyError
from mufly.flight import Summary, events_of, fly, summarise
from mufly.mission import load_mission, mission_from
from mufly.vehicle import Vehicle, load_vehicle, parameters, replace

MISSION = load_mission("demonstration")
HOP = mission_from(
    {"take_off": {"wait_s": 10.0}, "waypoint": [{"position_m": [2.0, 1.0, -1.5], "wait_s": 10.0}]}
)


def flown(vehicle: Vehicle, **how: object) -> Summary:
    dataset = fly(vehicle, MISSION, **how)
    return summarise(dataset, [w.position_m for w in MISSION.waypoint], events_of(dataset))


def drawn(random: np.random.Generator) -> Vehicle:
    base, values = load_vehicle("mufly-1.1"), {}
    for p in parameters(base):
        if (
            isinstance(p.value, float)
            and not p.key.startswith("mass_budget")
            and p.key != "range_ring.first_angle"
        ):
            # Efficiency and linkage cannot exceed 1.
            value = p.value * (1.0 + 0.1 * random.uniform(-1.0, 1.0))
            values[p.key] = min(value, 1.0) if p.unit == "1" and p.value <= 1.0 else value
    return replace(base, values)


def vehicles(count: int) -> Iterator[Summary | str]:
    random = np.random.default_rng(1)
    for _ in range(count):
        try:
            yield flown(drawn(random))
        except MuflyError as error:
            yield str(error)


# Vehicles flown with the controllers of another one


@cache
def nominal_controller() -> FlightController:
    return design(load_vehicle("mufly-1.1"))


def hover_input(seed: int) -> float:
    """At which a vehicle hovers on a full battery: 0.67 as designed; more than 1 where it cannot."""
    try:
        return float(trim(drawn(np.random.default_rng(seed)), charge=1.0).motor_input.mean())
    except MuflyError:
        return math.inf


def with_nominal_controller(seed: int) -> dict[str, object]:
    towards = np.random.default_rng([seed, 1]).uniform(0.0, math.tau)
    wind = (0.5 * math.cos(towards), 0.5 * math.sin(towards), 0.0)
    row: dict[str, object] = {"seed": seed, "hover": round(hover_input(seed), 4)}
    try:
        vehicle = drawn(np.random.default_rng(seed))
        dataset = fly(vehicle, HOP, controller=nominal_controller(), wind=wind, gust=0.3, seed=seed)
    except MuflyError as error:
        return row | {"outcome": "refused", "reason": str(error)}
    s = summarise(dataset, [w.position_m for w in HOP.waypoint], events_of(dataset))
    rise = -dataset.truth_position.sel(axis="D").values
    inputs = dataset.motor_input.values[dataset.mission_state.values == "hover"]
    return row | {
        "outcome": s.outcome,
        "reason": s.reason,
        "oscillation": s.longest_oscillation,
        "railed_s": round(s.longest_railed_s, 2),
        "touchdown_m_s": s.touchdown_speed_m_s,
        "overshoot_m": round(float(rise.max()) - 1.5, 3),
        # What is left of a swing that is none by definition.
        "hover_std": round(float(inputs.std(axis=0).max()), 4) if len(inputs) else math.nan,
    }


def nominal(count: int, lightest: bool, out: Path | None) -> int:
    """Fly them, on all cores; return how many oscillated or failed."""
    done = [json.loads(line) for line in out.read_text().splitlines()] if out and out.exists() else []
    known = {row["seed"] for row in done}
    with ProcessPoolExecutor() as pool:
        seeds = list(range(max(count, 1000) if lightest else count))
        if lightest:
            inputs = list(pool.map(hover_input, seeds, chunksize=50))
            seeds = sorted(seeds, key=inputs.__getitem__)[:count]
        flights = [pool.submit(with_nominal_controller, seed) for seed in seeds if seed not in known]
        for k, flight in enumerate(as_completed(flights), 1):
            row = flight.result()
            done.append(row)
            if out:
                with out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
            if row["outcome"] != "succeeded" or row["oscillation"]:
                print(row, flush=True)
            elif k % 20 == 0:
                print(f"{k} of {len(flights)} flown", file=sys.stderr, flush=True)
    wanted = set(seeds)
    flew = [row for row in done if row["seed"] in wanted and row["outcome"] != "refused"]
    lost = [row for row in flew if row["outcome"] != "succeeded" or row["oscillation"]]
    print(
        f"{len(wanted)} vehicles within 10 %, controllers of mufly-1.1: {len(wanted) - len(flew)} refused "
        "(too heavy to hover)"
    )
    print(f"flown {len(flew)}, succeeded {sum(row['outcome'] == 'succeeded' for row in flew)}, ", end="")
    print(f"oscillated {sum(bool(row['oscillation']) for row in flew)}")
    for reason, n in Counter(str(row["reason"]) for row in lost).most_common():
        print(f"  {n} x {reason}")
    for name in ("railed_s", "touchdown_m_s", "overshoot_m", "hover_std"):
        values = [float(row[name]) for row in flew if row[name] is not None]
        print(f"  {name}: median {np.nanmedian(values):.3f}, worst {np.nanmax(values):.3f}")
    return len(lost)


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
    parser.add_argument("what", nargs="*", help=f"{', '.join(kinds)} (all three by default), or nominal")
    parser.add_argument("--count", type=int, default=0, help="flights of each kind; 40, 20 and 10 by default")
    parser.add_argument(
        "--lightest", action="store_true", help="nominal: those that hover at the least input first"
    )
    parser.add_argument(
        "--out", type=Path, help="nominal: JSON lines, one a flight; gone on from if it exists"
    )
    asked = parser.parse_args()
    if unknown := set(asked.what) - {*kinds, "nominal"}:
        parser.error(f"unknown: {', '.join(unknown)}; choose from {', '.join(kinds)}, nominal")
    if "nominal" in asked.what:
        sys.exit(nominal(asked.count or 40, asked.lightest, asked.out) > 0)
    asked.what = asked.what or kinds
    if "vehicles" in asked.what:
        report("vehicles off by 10 %", vehicles(asked.count or 40))
    if "wind" in asked.what:
        report("wind 0.5 m/s, gusts 0.3 m/s", in_air(asked.count or 20, 0.5, 0.3))
    if "storm" in asked.what:
        report("wind 1.5 m/s, gusts 0.6 m/s", in_air(asked.count or 10, 1.5, 0.6))


if __name__ == "__main__":
    main()
