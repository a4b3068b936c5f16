"""How flights on the vehicle's own sensors go: many seeds, every fault, hours of hovering.

    python benchmarks/fly_on_estimates.py hover --seeds 200         # hover hold, with and without walls to see
    python benchmarks/fly_on_estimates.py outage --seeds 200        # no position fix for 2 s, for 5 s
    python benchmarks/fly_on_estimates.py faults --seeds 3          # every fault of the catalogue, alone
    python benchmarks/fly_on_estimates.py pairs --seeds 1           # and every two of different sensors
    python benchmarks/fly_on_estimates.py pairs --seeds 1 --sample 100  # of these a hundred, drawn by --first
    python benchmarks/fly_on_estimates.py alarms --seeds 60         # false alarms: ten minutes of hover each
    python benchmarks/fly_on_estimates.py alarms --seeds 60 --untold 1.5  # true errors 1.5 times the file's
    python benchmarks/fly_on_estimates.py consistency --seeds 24    # NEES of each block over the demonstration
    python benchmarks/fly_on_estimates.py consistency --seeds 24 --untold standard  # errors of the standard campaign

``--untold`` changes the truth alone: a number scales all errors of the sensors (mounting, rate and latency as filed),
``standard`` draws a vehicle of the standard set for each seed. An accusation names one sensor as rejected, faulty,
missing or used despite a fault. A report that names several candidates accuses none of them.

Whole missions: ``mufly monte-carlo demonstration --flights 1000 --wind 0.5 --gust 0.3``, and ``box-on-leg``; with
unknown errors: ``mufly monte-carlo demonstration --flights 500 --wind 0.5 --gust 0.3 --vary standard --untold``.
Exported code flies, in one compiled loop where it can (:class:`mufly.firmware.GenericFirmwareSoftware`): the same
flights to the last bit. Seeds count from ``--first`` (0). Each flight is a line of ``--out`` (JSON), so that a run that
was stopped goes on where it was: the same command again. A flight that raises is told as such and counts as lost.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import xarray as xr

from mufly.control import design_flight_controller
from mufly.estimate import Estimate
from mufly.estimate.nees import ERROR_BLOCKS, Consistency, measure_consistency
from mufly.firmware import GenericFirmwareSoftware
from mufly.flight import Flight, fly_mission, read_events, summarise_flight
from mufly.flight.monte_carlo import Campaign, parse_variations
from mufly.mission import Mission, load_mission, parse_mission
from mufly.quantities.sensor_table import READINGS
from mufly.sensors import FAULT_KINDS, FAULT_TARGETS, Truth, parse_fault
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters

WIND, GUST = (0.5, 0.0, 0.0), 0.3
FAULT_S, NOTICED_S = 12.0, 0.5
"""When a fault begins, in a hover that has lasted for some seconds; within what it is to be noticed (s)."""
HOLD = parse_mission(
    {
        "take_off": {"height_m": 1.0, "wait_s": 18.0},
        "waypoint": [{"position_m": [0.5, 0.0, -1.0], "wait_s": 2.0}],
    }
)
ROOM = parse_mission(
    {
        "room": {"north_m": [-1.2, 1.2], "east_m": [-1.2, 1.2], "height_m": 3.0},
        "take_off": {"height_m": 1.0, "wait_s": 18.0},
        "waypoint": [{"position_m": [0.2, 0.0, -1.0], "wait_s": 2.0}],
    }
)
SETTLED_S = 10.0
CHARGED_EVERY = 200  # periods
CONSISTENCY_EVERY = 20  # periods: a covariance is published so often
NO_ERROR_SIZES = ("mount_roll", "mount_pitch", "mount_yaw", "latency", "period", "drift_correlation_time")
SENSOR_SOURCES = tuple(sorted({row.source for row in READINGS.values() if row.source}))


@cache
def vehicle_and_controller(name: str = "mufly-1.1") -> tuple[Any, Any]:
    vehicle = load_vehicle(name)
    return vehicle, design_flight_controller(vehicle)


def true_vehicle(untold: str, seed: int) -> Vehicle | None:
    """The vehicle that flies, of which filter and controllers know nothing; None: it is as its file says."""
    if not untold:
        return None
    vehicle, controller = vehicle_and_controller()
    (standard,) = parse_variations(["standard"], vehicle)
    if untold == "standard":
        campaign = Campaign(vehicle, load_mission("demonstration"), (standard,), controller=controller, seed=seed)
        return campaign.make_vehicle(campaign.draw_case(0))
    filed = {p.key: p.value for p in list_parameters(vehicle)}
    errors = [k for k in standard.keys if k.startswith("sensors.") and not k.endswith(NO_ERROR_SIZES)]
    return replace_parameters(vehicle, {k: float(untold) * filed[k] for k in errors})


def accused(text: str) -> str:
    """The one sensor that a warning names as wrong; "" if it names none, or several candidates."""
    words = (" is rejected", " is faulty", " is missing", " is used despite")
    return next((s for s in SENSOR_SOURCES if any(text.startswith(s + w) for w in words)), "")


def flown(
    mission: Mission, seed: int, faults: tuple[str, ...] = (), true: Vehicle | None = None, **options: Any
) -> xr.Dataset:
    vehicle, controller = vehicle_and_controller()
    return fly_mission(
        true or vehicle, mission, controller=controller, designed_for=vehicle, seed=seed, sensors="fitted",
        controllers=GenericFirmwareSoftware,
        faults=[parse_fault(f) for f in faults], **{"wind": WIND, "gust": GUST, "brief": True} | options,
    )  # fmt: skip


def told(data: xr.Dataset, mission: Mission) -> dict[str, Any]:
    """What every kind of flight is judged by."""
    s = summarise_flight(data, [w.position_m for w in mission.waypoint], world=mission.world)
    inputs = inputs_of(data)
    down = data.truth_position.values[:, 2]
    airborne = (down[1:] < down[0] - 0.05) & (inputs[1:, 0] > 0.0)  # an emergency stop is a step, and meant
    return {
        "outcome": s.outcome,
        "reason": s.reason,
        "duration_s": s.duration_s,
        "overshoot_m": max((w.overshoot_m for w in s.waypoints if w.overshoot_m is not None), default=None),
        "clearance_m": s.least_clearance_m,
        "touchdown_m_s": s.touchdown_speed_m_s,
        "finite": bool(np.isfinite(inputs).all()),
        "jump": float(np.abs(np.diff(inputs, axis=0))[airborne].max(initial=0.0)),
        "warnings": [(e.time_s, e.text) for e in read_events(data) if e.level != "info"],
    }


def errors(data: xr.Dataset, after_s: float) -> dict[str, float]:
    """Of the hold and of the estimate in the hover after take-off, from ``after_s`` on (m, degrees)."""
    d = data.sel(time=slice(after_s, None))
    d = d.isel(time=np.flatnonzero(d.mission_state.values == "hover"))
    off = d.truth_position.values - d.reference_position.values
    tilt = (d.estimated_attitude.values - d.truth_attitude.values)[:, :2]
    height = (d.estimated_position.values - d.truth_position.values)[:, 2]

    def rms(x: np.ndarray) -> float:
        return float(np.sqrt(np.mean(x**2))) if len(x) else math.nan

    return {
        "xy_rms_m": rms(np.hypot(off[:, 0], off[:, 1])),
        "z_rms_m": rms(off[:, 2]),
        "height_rms_m": rms(height),
        "tilt_rms_deg": math.degrees(rms(np.hypot(tilt[:, 0], tilt[:, 1]))),
    }


def one_hover(seed: int) -> dict[str, Any]:
    out = {}
    for name, mission in (("fix", HOLD), ("fix and lasers", ROOM)):
        data = flown(mission, seed, brief=False)
        out[name] = told(data, mission) | errors(data, SETTLED_S)
    return out


def one_outage(seed: int) -> dict[str, Any]:
    out = {}
    for span in (2.0, 5.0):
        data = flown(HOLD, seed, (f"position.dropout@{FAULT_S:g}s+{span:g}s",))
        out[f"{span:g} s"] = told(data, HOLD) | {"peak_m": strayed(data, FAULT_S, FAULT_S + span + 3.0)}
    return out


def strayed(data: xr.Dataset, start_s: float, stop_s: float) -> float:
    """How far it went from where it was told to be (m)."""
    d = data.sel(time=slice(start_s, stop_s))
    off = (d.truth_position.values - d.reference_position.values)[d.mission_state.values != "landing"]
    return float(np.hypot(off[:, 0], off[:, 1]).max()) if len(off) else 0.0


def inputs_of(data: xr.Dataset) -> np.ndarray:
    return np.hstack([data.motor_input.values, data.servo_input.values])


@cache
def faultless_inputs(seed: int) -> np.ndarray:
    return inputs_of(flown(HOLD, seed))


def one_with(faults: tuple[str, ...], seed: int) -> dict[str, Any]:
    """A hover of which something goes wrong: noticed when, how far it went, how it came down.

    A fault whose flight equals the faultless one to the last bit changes nothing that the software receives, as a
    clip beyond all rates, or a ring frozen where no wall is in reach.
    """
    data = flown(HOLD, seed, faults)
    out = told(data, HOLD)
    wrong = {READINGS[FAULT_TARGETS[parse_fault(f).name].reading].source for f in faults}
    blamed = sorted({accused(text) for t, text in out["warnings"] if t >= FAULT_S} - {""} - wrong)
    after = [t - FAULT_S for t, text in out["warnings"] if t >= FAULT_S and not text.startswith("hard touchdown")]
    down = data.truth_position.values[-1, 2] > -0.2
    tipped = "tipped over" in out["reason"] or "hit" in out["reason"]
    tilt = np.degrees(np.abs(data.truth_attitude.values[:, :2]).max())
    last_s = data.time.values[-1]
    sink = float(data.truth_velocity.sel(time=slice(last_s - 8.0, None)).values[:, 2].max())
    return out | {
        "noticed_s": min(after, default=None),
        "blamed": blamed,
        "takes_effect": not np.array_equal(inputs_of(data), faultless_inputs(seed)),
        "strayed_m": strayed(data, FAULT_S, last_s),
        "sink_m_s": sink,
        "tilt_deg": float(tilt),
        "safe": bool(down and not tipped and sink < 1.5 and out["finite"]),
    }


def one_alarm(seed: int, untold: str = "") -> dict[str, Any]:
    """Ten minutes of hover with nothing wrong but errors of ``untold`` size; the battery is full for good."""
    vehicle, controller = vehicle_and_controller()
    mission = Mission(name="hold")
    flight = Flight(
        true_vehicle(untold, seed) or vehicle, mission, controller=controller, designed_for=vehicle, seed=seed,
        sensors="fitted", wind=WIND, gust=GUST, keep=False, brief=True, controllers=GenericFirmwareSoftware,
    )  # fmt: skip
    warnings: list[tuple[float, str]] = []
    flight.autopilot.listeners.append(lambda e: warnings.append((e.time_s, e.text)) if e.level != "info" else None)
    while flight.autopilot.list_arming_faults() and flight.time_s < 10.0:
        flight.step_period()
    flight.autopilot.arm()
    flight.autopilot.take_off(1.0)
    off = []
    while flight.time_s < 600.0:
        flight.advance_until(flight.plant.period_count + CHARGED_EVERY)
        flight.plant.state[20] = 0.8
        if flight.time_s > SETTLED_S:
            off.append(flight.plant.state[0:2].copy())
    flight.close()
    away = np.array(off) - np.mean(off, axis=0)
    return {
        "hours": flight.time_s / 3600.0,
        "warnings": warnings,
        "state": flight.status.state,
        "xy_rms_m": float(np.sqrt((away**2).sum(axis=1).mean())),
    }


def one_consistency(seed: int, untold: str = "") -> dict[str, Any]:
    """The demonstration in closed loop: errors over covariance, block by block, from a second after take-off on."""
    truths: list[Truth] = []
    estimates: list[Estimate] = []

    def listen(truth: Truth, estimate: Estimate) -> None:
        truths.append(truth)
        estimates.append(estimate)

    mission = load_mission("demonstration")
    data = flown(
        mission, seed, on_tick=listen, tick_every=CONSISTENCY_EVERY,
        **({} if not untold else {"true": true_vehicle(untold, seed)}),
    )  # fmt: skip
    down = data.truth_position.values[:, 2]
    airborne = data.time.values[down < down[0] - 0.05]
    span = [(t, e) for t, e in zip(truths, estimates, strict=True) if e.time_s <= airborne[-1]]
    found = measure_consistency(*zip(*span, strict=True), after_s=float(airborne[0]) + 1.0, every=1)
    return told(data, mission) | {"consistency": asdict(found)}


def kinds_of(name: str) -> Iterator[str]:
    """The faults of a sensor; accelerometers alone clip at an element."""
    for kind in FAULT_KINDS:
        yield f"{name}.{kind}@{FAULT_S:g}s"


def catalogue() -> list[tuple[str, ...]]:
    return [(fault,) for name in FAULT_TARGETS for fault in kinds_of(name)]


def pairs() -> list[tuple[str, ...]]:
    alone = [f[0] for f in catalogue()]
    return [two for two in combinations(alone, 2) if two[0].split(".")[0] != two[1].split(".")[0]]


def jobs_of(
    what: str, seeds: range, untold: str = ""
) -> Iterator[tuple[str, Callable[..., dict[str, Any]], tuple[Any, ...]]]:
    """(name, function, arguments) of every flight."""
    if what in ("faults", "pairs"):
        for faults in catalogue() if what == "faults" else pairs():
            for seed in seeds:
                yield f"{' '.join(faults)} {seed}", one_with, (faults, seed)
        return
    one = {
        "hover": one_hover,
        "outage": one_outage,
        "alarms": one_alarm,
        "consistency": one_consistency,
    }[what]
    for seed in seeds:
        yield str(seed), one, (seed, untold) if what in ("alarms", "consistency") else (seed,)


def guarded(function: Callable[..., dict[str, Any]], arguments: tuple[Any, ...]) -> dict[str, Any]:
    began = time.perf_counter()
    try:
        out = function(*arguments)
    except Exception as error:  # one flight that raises is a result
        out = {"raised": f"{type(error).__name__}: {error}"}
    return out | {"wall_s": time.perf_counter() - began}


def share(values: list[bool]) -> str:
    return f"{np.mean(values):.1%} of {len(values)}" if values else "none"


def report(what: str, found: dict[str, dict[str, Any]]) -> None:
    raised = {k: r["raised"] for k, r in found.items() if "raised" in r}
    for k, why in raised.items():
        print(f"  {k}: raised {why}")
    good = {k: r for k, r in found.items() if "raised" not in r}
    rows = list(good.values())
    if not rows:
        return
    if what in ("hover", "outage"):
        for name in rows[0]:
            if name == "wall_s":
                continue
            for key in [k for k, v in rows[0][name].items() if isinstance(v, float) and k.endswith(("_m", "_deg"))]:
                values = [r[name][key] for r in rows if r[name].get(key) is not None]
                print(f"{name}: {key} mean {np.mean(values):.4f}, worst {max(values):.4f}")
            print(f"{name}: succeeded", share([r[name]["outcome"] == "succeeded" for r in rows]))
    elif what in ("faults", "pairs"):
        told_ = [r["noticed_s"] is not None and r["noticed_s"] <= NOTICED_S for r in rows]
        fine = [r["outcome"] == "succeeded" for r in rows]
        print("noticed within 0.5 s", share(told_))
        print("down safely", share([r["safe"] for r in rows]))
        said = [r["safe"] and r["noticed_s"] is not None for r in rows]
        print(
            "noticed within 0.5 s, or down safely and told why",
            share([a or b for a, b in zip(told_, said, strict=True)]),
        )
        felt = [a or b for r, a, b in zip(rows, told_, said, strict=True) if r["takes_effect"] or a or b]
        print("the same, of faults that take effect or are told", share(felt))
        print("never told, down safely", share([r["safe"] and r["noticed_s"] is None for r in rows]))
        print("mission flown to its end", share(fine))
        print("healthy sensor accused", share([bool(r["blamed"]) for r in rows]))
        print("finite inputs", share([r["finite"] for r in rows]))
        for k, r in good.items():
            when = "never" if r["noticed_s"] is None else f"{r['noticed_s']:.2f} s"
            mark = "" if r["safe"] else "LOST "
            print(
                f"  {mark}{k}: noticed {when}, strayed {r['strayed_m']:.2f} m, tilt {r['tilt_deg']:.0f} deg, "
                f"{r['outcome']}: {r['reason']}" + (f"; accuses {', '.join(r['blamed'])}" if r["blamed"] else "")
            )
    elif what == "consistency":
        merged = Consistency.merge_flights([Consistency(**r["consistency"]) for r in rows])
        print("succeeded", share([r["outcome"] == "succeeded" for r in rows]))
        print(f"NEES/n {merged.nees:.2f}, {merged.inside_share:.1%} inside")
        for k, name in enumerate(ERROR_BLOCKS):
            each = [r["consistency"]["block_nees"][k] for r in rows]
            print(
                f"  {name}: NEES/n {merged.block_nees[k]:.2f}, {merged.block_inside_shares[k]:.1%} inside; "
                f"units: median {np.median(each):.2f}, worst {max(each):.2f}"
            )
    else:
        hours = sum(r["hours"] for r in rows)
        alarms = [(k, t, text) for k, r in good.items() for t, text in r["warnings"]]
        false = [a for a in alarms if accused(a[2])]
        away = np.mean([r["xy_rms_m"] for r in rows])
        print(f"{len(alarms)} alarms, {len(false)} accusations in {hours:.2f} h; xy {away:.3f} m rms")
        for k, t, text in alarms:
            print(f"  {k} at {t:.1f} s: {text}")
    jumps = [r["jump"] for r in rows if "jump" in r]
    if jumps:
        print(f"largest step of an input in a period: {max(jumps):.3f}")
    flights = sum(r["duration_s"] for r in rows if "duration_s" in r)
    if flights:
        print(f"{flights / sum(r['wall_s'] for r in rows):.1f} times real time a process")


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("what", choices=("hover", "outage", "faults", "pairs", "alarms", "consistency"))
    p.add_argument("--seeds", type=int, default=20)
    p.add_argument("--first", type=int, default=0)
    p.add_argument("--only", default="", help="names that contain this")
    p.add_argument("--sample", type=int, default=0, help="fly so many of them, drawn by --first; 0: all")
    p.add_argument("--untold", default="", help="errors of the truth alone: a factor, or 'standard'")
    p.add_argument("--jobs", type=int, default=2)
    p.add_argument("--out", type=Path, default=None, help="JSON lines; default fly_on_estimates-WHAT.jsonl")
    a = p.parse_args()
    out = a.out or Path(f"fly_on_estimates-{a.what}{a.untold}.jsonl")
    found: dict[str, dict[str, Any]] = {}
    if out.exists():
        found = dict(json.loads(line) for line in out.read_text().splitlines() if line.endswith("]"))
    jobs = [j for j in jobs_of(a.what, range(a.first, a.first + a.seeds), a.untold) if a.only in j[0]]
    if 0 < a.sample < len(jobs):
        print(f"{a.sample} of {len(jobs)} flights")
        drawn = np.random.default_rng(a.first).choice(len(jobs), a.sample, replace=False)
        jobs = [jobs[k] for k in sorted(drawn)]
    wanted = {j[0] for j in jobs}
    left = [j for j in jobs if j[0] not in found]
    if left:
        vehicle_and_controller()  # compiled once, before the processes
        began = time.perf_counter()
        with ProcessPoolExecutor(a.jobs) as pool, out.open("a") as stream:
            running = {pool.submit(guarded, f, args): name for name, f, args in left}
            for k, future in enumerate(as_completed(running), 1):
                name = running[future]
                found[name] = future.result()
                stream.write(json.dumps([name, found[name]]) + "\n")
                stream.flush()
                rest = (time.perf_counter() - began) / k * (len(left) - k)
                print(f"\r{k} of {len(left)}, {rest:.0f} s to go   ", end="", flush=True)
        print()
    report(a.what, {k: v for k, v in found.items() if k in wanted})


if __name__ == "__main__":
    main()
