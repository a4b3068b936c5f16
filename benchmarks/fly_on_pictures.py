"""Flights whose position comes from rendered pictures by SLAM: missions by seed, and what goes wrong with the camera.

    python benchmarks/fly_on_pictures.py mission --seeds 100      # demonstration, wind 0.5 from anywhere, gusts 0.3
    python benchmarks/fly_on_pictures.py mission --floor tiles
    python benchmarks/fly_on_pictures.py mission --first 500 --seeds 100 --kept flights.jsonl    # goes on where it was
    python benchmarks/fly_on_pictures.py told --kept flights.jsonl                               # what it says so far
    python benchmarks/fly_on_pictures.py spoiled                  # covered, dark, unplugged, for good and for 5 s

A flight is a line, of 80 s of flight and some 20 s of one core (two, as SLAM has a process of its own). Of each closure
of a loop the jump of SLAM's place against the truth tells whether it was a wrong one: on tiles that is 256 mm.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from fly_on_estimates import told

from mufly.camera import load_camera
from mufly.firmware import GenericFirmwareSoftware
from mufly.flight import fly_mission
from mufly.flight.fixes.camera_sensor import CameraConfig
from mufly.flight.fixes.onboard_camera import parse_camera_fault
from mufly.mission import load_mission
from mufly.slam import TrackingResult

MISSION = "demonstration"
FROM_S = 30.0
"""When the camera is spoiled, between two waypoints (s)."""


def one(seed: int, floor: str, camera: str, spoils: tuple[str, ...] = ()) -> dict[str, Any]:
    """Fly once and tell what came of it."""
    answers: list[TrackingResult] = []
    mission = load_mission(MISSION)
    blows = np.random.default_rng(seed).uniform(0.0, 2 * math.pi)
    data = fly_mission(
        "mufly-1.1",
        mission,
        wind=(0.5 * math.cos(blows), 0.5 * math.sin(blows), 0.0),
        gust=0.3,
        seed=seed,
        sensors="fitted",
        controllers=GenericFirmwareSoftware,
        eye=CameraConfig(
            load_camera(camera),
            floor,
            camera_faults=tuple(map(parse_camera_fault, spoils)),
            on_tracking_result=answers.append,
        ),
    )
    out = told(data, mission)
    time, true = data["time"].values, data["truth_position"].values
    believed = data["estimated_position"].values - true
    out["estimate_m"] = math.sqrt(float((believed[:, :2] ** 2).sum(axis=1).mean()))
    answers = [a for a in answers if a.reason != "it stands"]
    flying = [a for a in answers if -true[min(int(np.searchsorted(time, a.time_s)), len(time) - 1), 2] > 0.15]
    trusted = [a for a in flying if a.trusted]
    out["lost"] = 1.0 - len(trusted) / max(1, len(flying))
    off, nees = [], []
    jump, last = 0.0, None
    for a in trusted:
        k = min(int(np.searchsorted(time, a.time_s)), len(time) - 1)
        e = np.append(
            a.position - true[k],
            math.remainder(a.heading - float(data["truth_attitude"].values[k, 2]), 2 * math.pi),
        )
        off.append(math.hypot(e[0], e[1]))
        if a.is_loop_closed and last is not None:  # away from the truth, by more than it was off before
            jump = max(jump, off[-1] - math.hypot(last[0], last[1]))
        last = e
        nees.append(float(e @ np.linalg.solve(a.covariance, e)) / 4)
    out["slam_m"] = math.sqrt(float(np.mean(np.square(off)))) if off else math.nan
    out["slam_worst_m"], out["nees"] = max(off, default=math.nan), float(np.mean(nees)) if nees else math.nan
    out["closures"], out["closure_jump_m"] = sum(a.is_loop_closed for a in answers), jump
    return out


def line(name: str, r: dict[str, Any]) -> None:
    """Say it."""
    over = "no" if r["overshoot_m"] is None else f"{100 * r['overshoot_m']:.1f} cm"
    print(
        f"{name}: {r['outcome']} ({r['reason']}) after {r['duration_s']:.0f} s; overshoot {over}; estimate off "
        f"{100 * r['estimate_m']:.1f} cm rms, SLAM {100 * r['slam_m']:.1f}, worst {100 * r['slam_worst_m']:.1f}; lost "
        f"{r['lost']:.1%}; NEES/n {r['nees']:.2f}; closures {r['closures']}, "
        f"{100 * r['closure_jump_m']:.1f} cm away from the truth at most",
        flush=True,
    )
    for when, text in r["warnings"]:
        print(f"    {when:.2f} s: {text}", flush=True)


def summed(found: list[dict[str, Any]]) -> None:
    """Say what came of all."""
    over = [100 * r["overshoot_m"] for r in found if r["overshoot_m"] is not None]
    cm = {name: [100 * r[f"{name}_m"] for r in found] for name in ("estimate", "slam", "slam_worst", "closure_jump")}
    nees = [r["nees"] for r in found]
    print(
        f"{sum(r['outcome'] == 'succeeded' for r in found)} of {len(found)} succeed; overshoot median "
        f"{np.median(over):.1f}, worst {max(over):.1f} cm, above 20 cm: {sum(v > 20 for v in over)}; estimate off by "
        f"{np.median(cm['estimate']):.1f} cm rms (median), {max(cm['estimate']):.1f} at worst; SLAM "
        f"{np.median(cm['slam']):.1f}, {max(cm['slam']):.1f}, one answer {max(cm['slam_worst']):.0f} cm; lost "
        f"{np.mean([r['lost'] for r in found]):.1%}; NEES/n {np.mean(nees):.2f}, worst {max(nees):.1f}; "
        f"{sum(r['closures'] for r in found)} closures, {max(cm['closure_jump']):.1f} cm away from the truth at most"
    )


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("what", choices=("mission", "spoiled", "told"))
    p.add_argument("--seeds", type=int, default=10)
    p.add_argument("--first", type=int, default=100)
    p.add_argument("--floor", default="rich")
    p.add_argument("--camera", default="mufly-2.0")
    p.add_argument("--kept", type=Path, help="a line of JSON a flight; those that are in it are not flown again")
    a = p.parse_args()
    if a.what == "spoiled":
        for kind in ("covered", "dark", "unplugged"):
            for span in ("", "+5s"):
                fault = f"{kind}@{FROM_S:g}s{span}"
                line(fault, one(a.first, a.floor, a.camera, (fault,)))
        return
    found: dict[int, dict[str, Any]] = {}
    if a.kept is not None and a.kept.exists():
        found = {r["seed"]: r for r in map(json.loads, a.kept.read_text().splitlines())}
    for seed in range(a.first, a.first + a.seeds) if a.what == "mission" else ():
        if seed in found:
            continue
        found[seed] = one(seed, a.floor, a.camera)
        line(str(seed), found[seed])
        if a.kept is not None:
            with a.kept.open("a") as file:
                file.write(json.dumps({"seed": seed, "floor": a.floor, **found[seed]}) + "\n")
    if found:
        summed(list(found.values()))


if __name__ == "__main__":
    main()
