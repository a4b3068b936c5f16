"""Flights on pictures with a camera that is faulty or differs from its file: what is reported, and what comes of it.

    python benchmarks/wrong_cameras.py --seeds 2                              # every case
    python benchmarks/wrong_cameras.py --cases frozen,tilted-5 --floors brick,grass --seeds 10 --kept flights.jsonl

Each flight is the demonstration on mufly-1.1 and the camera of mufly-2.0, in wind of 0.5 m/s and gusts of 0.3 m/s; the
floors take turns. Faults begin at 20 s. A wrong camera is wrong from the start; its time counts from the height of
0.3 m. A flight passes if the camera's defect is reported within 3 s, the vehicle lands or completes the mission
without tipping over, and no report accuses another sensor. Dirt that is masked does not end a flight.
A flight takes 10 to 60 s of one core.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from fly_on_estimates import accused, told

from mufly.camera import Camera, load_camera
from mufly.firmware import GenericFirmwareSoftware
from mufly.flight import fly_mission
from mufly.flight.fixes.camera_sensor import CameraConfig
from mufly.flight.fixes.onboard_camera import parse_camera_fault
from mufly.mission import load_mission

FAULT_S, TOLD_S, SEEN_M = 20.0, 3.0, 0.3
FAULTS = ("frozen", "inverted", "mirrored", "dirty")
WRONG_CAMERAS: dict[str, tuple[str, dict[str, float]]] = {
    "turned-10": ("mount", {"turn": math.radians(10.0)}),
    "tilted-5": ("mount", {"pitch": math.radians(5.0)}),
    "focal+5": ("lens", {"focal_x": 1.05, "focal_y": 1.05}),
    "focal+20": ("lens", {"focal_x": 1.2, "focal_y": 1.2}),
}
"""Part of the camera, and its values: angles (rad), or factors on the file's focal length."""


def make_wrong_camera(camera: Camera, case: str) -> Camera | None:
    """Return the true camera of a case; None if it is that of the file."""
    if case not in WRONG_CAMERAS:
        return None
    part, values = WRONG_CAMERAS[case]
    of = getattr(camera, part)
    changed = {
        name: getattr(of, name).model_copy(
            update={"value": v * float(getattr(of, name)) if part == "lens" else v, "source": "estimated"}
        )
        for name, v in values.items()
    }
    return camera.model_copy(update={part: of.model_copy(update=changed)})


def fly_once(case: str, floor: str, seed: int) -> dict[str, Any]:
    """Fly once; return the report's time, what it says, who else is accused, and the end."""
    mission, camera = load_mission("demonstration"), load_camera("mufly-2.0")
    blows = np.random.default_rng([seed, 5]).uniform(0.0, 2 * math.pi)
    data = fly_mission(
        "mufly-1.1", mission, wind=(0.5 * math.cos(blows), 0.5 * math.sin(blows), 0.0), gust=0.3, seed=seed,
        sensors="fitted", controllers=GenericFirmwareSoftware,
        eye=CameraConfig(
            camera, floor, true_camera=make_wrong_camera(camera, case),
            camera_faults=(parse_camera_fault(f"{case}@{FAULT_S:g}s"),) if case in FAULTS else (),
        ),
    )  # fmt: skip
    out = told(data, mission)
    time, height = data["time"].values, -data["truth_position"].values[:, 2]
    since = FAULT_S if case in FAULTS else float(time[int(np.argmax(height > SEEN_M))])
    of_camera = [(t - since, text) for t, text in out["warnings"] if "camera" in text or "SLAM" in text]
    early = [text for t, text in out["warnings"] if t < since]
    down = float(height[-1]) < 0.2
    tipped = "tipped" in out["reason"] or "hit" in out["reason"]
    off = data["truth_position"].values[:, :2] - data["reference_position"].values[:, :2]
    return {
        "case": case, "floor": floor, "seed": seed, "outcome": out["outcome"], "reason": out["reason"],
        "told_s": min((t for t, _ in of_camera if t >= 0.0), default=None),
        "says": next((text for t, text in of_camera if t >= 0.0), ""),
        "blamed": sorted({accused(text) for _, text in out["warnings"]} - {"", "position fix"}),  # it is the camera
        "landed": bool(down and not tipped), "tipped": bool(tipped), "early": early,
        "strayed_m": float(np.nanmax(np.hypot(*off.T))), "warnings": out["warnings"],
    }  # fmt: skip


def is_passed(r: dict[str, Any]) -> bool:
    """Whether a flight passes; that of a healthy camera must complete without any report."""
    if r["case"] == "healthy":
        return r["outcome"] == "succeeded" and not r["blamed"]
    return r["told_s"] is not None and r["told_s"] <= TOLD_S and r["landed"] and not r["blamed"]


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--cases", default=",".join(("healthy", *FAULTS, *WRONG_CAMERAS)))
    p.add_argument("--floors", default="brick,grass,gravel")
    p.add_argument("--seeds", type=int, default=10)
    p.add_argument("--first", type=int, default=0)
    p.add_argument("--kept", type=Path, help="a line of JSON a flight; those that are in it are not flown again")
    a = p.parse_args()
    rows: list[dict[str, Any]] = []
    if a.kept is not None and a.kept.exists():
        rows = [json.loads(x) for x in a.kept.read_text().splitlines()]
    floors, done = a.floors.split(","), {(r["case"], r["seed"]) for r in rows}
    for case in a.cases.split(","):
        for seed in range(a.first, a.first + a.seeds):
            if (case, seed) in done:
                continue
            r = fly_once(case, floors[seed % len(floors)], seed)
            rows.append(r)
            if a.kept is not None:
                with a.kept.open("a") as file:
                    file.write(json.dumps(r) + "\n")
            when = "never" if r["told_s"] is None else f"after {r['told_s']:.1f} s"
            print(
                f"{case} {r['floor']} {seed}: {'passes' if is_passed(r) else 'FAILS'}; told {when} ({r['says']}); "
                f"{r['outcome']} ({r['reason']}); strayed {r['strayed_m']:.2f} m; blamed "
                f"{', '.join(r['blamed']) or '-'}",
                flush=True,
            )
    for case in dict.fromkeys(r["case"] for r in rows):
        mine = [r for r in rows if r["case"] == case]
        quick = sum(r["told_s"] is not None and r["told_s"] <= TOLD_S for r in mine)
        print(
            f"{case}: {sum(map(is_passed, mine))} of {len(mine)} pass; told within {TOLD_S:g} s {quick}; landed "
            f"{sum(r['landed'] for r in mine)}; tipped over {sum(r['tipped'] for r in mine)}; healthy sensors blamed "
            f"{sum(bool(r['blamed']) for r in mine)}; strayed {max(r['strayed_m'] for r in mine):.1f} m at most"
        )


if __name__ == "__main__":
    main()
