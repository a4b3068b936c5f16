"""Flights whose position comes from rendered pictures by SLAM: missions by seed, and what goes wrong with the camera.

    python benchmarks/fly_on_pictures.py mission --seeds 100      # demonstration, wind 0.5 from anywhere, gusts 0.3
    python benchmarks/fly_on_pictures.py mission --floor tiles
    python benchmarks/fly_on_pictures.py spoiled                  # covered, dark, unplugged, for good and for 5 s

A flight is a line, of 80 s of flight and some 20 s of one core (two, as SLAM has a process of its own).
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np
from fly_on_estimates import told

from mufly.camera import load_camera
from mufly.firmware import QuickSoftware
from mufly.flight import fly
from mufly.flight.camera import Eye, parse_spoil
from mufly.mission import load_mission
from mufly.slam import Answer

MISSION = "demonstration"
FROM_S = 30.0
"""When the camera is spoiled, between two waypoints (s)."""


def one(seed: int, floor: str, camera: str, spoils: tuple[str, ...] = ()) -> dict[str, Any]:
    """Fly once and tell what came of it."""
    answers: list[Answer] = []
    mission = load_mission(MISSION)
    blows = np.random.default_rng(seed).uniform(0.0, 2 * math.pi)
    data = fly(
        "mufly-1.1", mission, wind=(0.5 * math.cos(blows), 0.5 * math.sin(blows), 0.0), gust=0.3, seed=seed,
        sensors="fitted", controllers=QuickSoftware,
        eye=Eye(load_camera(camera), floor, spoils=tuple(map(parse_spoil, spoils)), on_answer=answers.append),
    )  # fmt: skip
    out = told(data, mission)
    time, true = data["time"].values, data["truth_position"].values
    believed = data["estimated_position"].values - true
    out["estimate_m"] = math.sqrt(float((believed[:, :2] ** 2).sum(axis=1).mean()))
    answers = [a for a in answers if a.reason != "it stands"]
    flying = [a for a in answers if -true[min(int(np.searchsorted(time, a.time_s)), len(time) - 1), 2] > 0.15]
    trusted = [a for a in flying if a.trusted]
    out["lost"] = 1.0 - len(trusted) / max(1, len(flying))
    off, nees = [], []
    for a in trusted:
        k = min(int(np.searchsorted(time, a.time_s)), len(time) - 1)
        e = np.append(
            a.position - true[k],
            math.remainder(a.heading - float(data["truth_attitude"].values[k, 2]), 2 * math.pi),
        )
        off.append(math.hypot(e[0], e[1]))
        nees.append(float(e @ np.linalg.solve(a.covariance, e)) / 4)
    out["slam_m"] = math.sqrt(float(np.mean(np.square(off)))) if off else math.nan
    out["slam_worst_m"], out["nees"] = max(off, default=math.nan), float(np.mean(nees)) if nees else math.nan
    out["closures"] = sum(a.closed for a in answers)
    return out


def line(name: str, r: dict[str, Any]) -> None:
    """Say it."""
    over = "no" if r["overshoot_m"] is None else f"{100 * r['overshoot_m']:.1f} cm"
    print(
        f"{name}: {r['outcome']} ({r['reason']}) after {r['duration_s']:.0f} s; overshoot {over}; estimate off "
        f"{100 * r['estimate_m']:.1f} cm rms, SLAM {100 * r['slam_m']:.1f}, worst {100 * r['slam_worst_m']:.1f}; lost "
        f"{r['lost']:.1%}; NEES/n {r['nees']:.2f}; closures {r['closures']}",
        flush=True,
    )
    for when, text in r["warnings"]:
        print(f"    {when:.2f} s: {text}", flush=True)


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("what", choices=("mission", "spoiled"))
    p.add_argument("--seeds", type=int, default=10)
    p.add_argument("--first", type=int, default=100)
    p.add_argument("--floor", default="rich")
    p.add_argument("--camera", default="mufly-2.0")
    a = p.parse_args()
    seeds = range(a.first, a.first + a.seeds)
    if a.what == "spoiled":
        for kind in ("covered", "dark", "unplugged"):
            for span in ("", "+5s"):
                fault = f"{kind}@{FROM_S:g}s{span}"
                line(fault, one(a.first, a.floor, a.camera, (fault,)))
        return
    found = []
    for seed in seeds:
        found.append(one(seed, a.floor, a.camera))
        line(str(seed), found[-1])
    over = [100 * r["overshoot_m"] for r in found if r["overshoot_m"] is not None]
    print(
        f"{sum(r['outcome'] == 'succeeded' for r in found)} of {len(found)} succeed; overshoot median "
        f"{np.median(over):.1f}, worst {max(over):.1f} cm, above 20 cm: {sum(v > 20 for v in over)}; SLAM "
        f"{100 * math.sqrt(np.mean([r['slam_m'] ** 2 for r in found])):.1f} cm rms, lost "
        f"{np.mean([r['lost'] for r in found]):.1%}, NEES/n {np.mean([r['nees'] for r in found]):.2f}"
    )


if __name__ == "__main__":
    main()
