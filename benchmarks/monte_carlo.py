"""How fast are many flights, and how much of that is the compiled functions alone?

    python benchmarks/monte_carlo.py [--flights 20] [--jobs N]

Flies the demonstration in wind, vehicles off by 10 %, without a recording: seconds until the first flight of new
processes begins, then flown time over wall time, of all processes together. Then, in one process under a profiler,
what share of a flight is spent inside compiled functions: the machine's limit for this code, were Python free. The
first call compiles; call it twice.
"""

from __future__ import annotations

import argparse
import cProfile
import gc
import os
import pstats
import sys
import time

from figure_record import RECORD_HELP, make_recorder
from numba.core.dispatcher import Dispatcher

from mufly.firmware import GenericFirmwareSoftware
from mufly.flight.monte_carlo import Campaign, WorkerPool, fly_case, parse_variations, run_campaign
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle


def compiled() -> set[tuple[str, str]]:
    """File and name of every compiled function of the package, as a profile has them."""
    found = (
        o
        for m in list(sys.modules.values())
        if getattr(m, "__name__", "").startswith("mufly")
        for o in vars(m).values()
    )
    return {(d.py_func.__code__.co_filename, d.py_func.__name__) for d in found if isinstance(d, Dispatcher)}


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--flights", type=int, default=20)
    p.add_argument("--jobs", type=int, default=os.cpu_count())
    p.add_argument("--record", action="store_true", help=RECORD_HELP)
    asked = p.parse_args()
    record = make_recorder(asked.record)
    vehicle, mission = load_vehicle("mufly-1.1"), load_mission("demonstration")
    for sensors in ("ideal", "fitted"):
        campaign = Campaign.create_checked(
            vehicle,
            mission,
            variations=parse_variations(["parameters=10%"], vehicle),
            wind=0.5,
            gust=0.3,
            sensors=sensors,
            fast_controllers=GenericFirmwareSoftware,
        )
        began = time.perf_counter()
        with WorkerPool(asked.jobs) as crew:
            list(crew.fly_cases(campaign, [(campaign.draw_case(k), None) for k in range(asked.jobs)]))
            first = time.perf_counter() - began
            began = time.perf_counter()
            flights = run_campaign(campaign, asked.flights, crew=crew)
            wall = time.perf_counter() - began
        flown = sum(f.duration_s or 0.0 for f in flights)
        case = campaign.draw_case(0)
        gc.freeze()  # as workers do
        fly_case(campaign, case)
        cpu = time.process_time()
        once = fly_case(campaign, case)
        cpu = time.process_time() - cpu
        profile = cProfile.Profile(time.process_time)
        profile.runcall(fly_case, campaign, case)
        names = compiled()
        inside = sum(
            row[2]
            for (file, _, name), row in pstats.Stats(profile).stats.items()
            if (file, name) in names  # type: ignore[attr-defined]
        )
        seconds = once.duration_s or float("nan")
        print(
            f"{sensors}: {asked.jobs} processes, {asked.flights} flights of "
            f"{flown / len(flights):.0f} s in {wall:.1f} s"
        )
        print(f"  first flights of new processes are over after {first:7.1f} s")
        print(f"  flown time over wall time, together           {flown / wall:7.0f}   (target 500, then 2000)")
        print(f"  1000 flights of 60 s would take               {60e3 * wall / flown:7.0f} s (target 120, then 30)")
        if sensors == "fitted":
            record("time_flights", 60e3 * wall / flown)
        print(f"  processor time of a flight of 60 s, ms        {60e3 * cpu / seconds:7.0f}")
        print(f"  one process: times real time                  {seconds / cpu:7.0f}")
        print(f"    in compiled functions alone                 {seconds / inside:7.0f}")
        print(f"    time over that of the compiled functions    {cpu / inside:7.1f}")


if __name__ == "__main__":
    main()
