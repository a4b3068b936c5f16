"""Visual SLAM over rendered floors, measured against the truth: quality, drift and loops, tiles, speed.

python benchmarks/slam.py quality --camera mufly-2.0 --floor rich --seeds 20
python benchmarks/slam.py photographs --seeds 5       # every photograph of `mufly slam floors` that is installed
python benchmarks/slam.py loop --seeds 5
python benchmarks/slam.py tiles --seeds 20
python benchmarks/slam.py edges --seeds 4     # what edges of the graph say, in their own deviations
python benchmarks/slam.py speed
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import numpy as np
from figure_record import RECORD_HELP, make_recorder

from mufly.camera import PACKAGE_FLOORS, Renderer, VehicleMotion, find_floor, load_camera, make_random_floor
from mufly.dynamics import body_to_ned_matrix
from mufly.rotations import quaternion_from_euler
from mufly.slam import (
    SlamSystem,
    SlamTrajectory,
    collect_results,
    evaluate_trajectory,
    make_square_path,
    render_frames,
)


def fly(
    camera: str,
    floor: str,
    seed: int,
    duration: float,
    *,
    side: float,
    speed: float,
    close: bool = True,
    lose: bool = True,
) -> tuple[Any, SlamSystem, SlamTrajectory, float, float]:
    """One sequence: errors, the SLAM, its answers, processor's time a picture (s), worst closure off truth (m)."""
    lens = load_camera(camera)
    path = make_square_path(duration_s=duration, side_m=side, speed_m_s=speed, seed=seed)
    slam, spent, true, answers = None, 0.0, [], []
    places: dict[float, np.ndarray] = {}
    nodes: dict[float, np.ndarray] = {}
    worst = 0.0
    for frame, motion in render_frames(
        lens, find_floor(floor).make_floor(seed, shadows=0.3), path, duration_s=duration, seed=seed, lose=lose
    ):
        heading = math.atan2(motion.attitude[1, 0], motion.attitude[0, 0])
        nodes[motion.time_s] = node(lens, frame, motion)
        if slam is None:
            slam = SlamSystem(lens, start=(*motion.position[:2], heading), seed=seed)
            slam.is_closing_loops = close
        begin = time.process_time()
        answers.append(slam.process_frame(frame))
        spent += time.process_time() - begin
        true.append((motion.time_s, *motion.position, heading))
        places[motion.time_s] = motion.position
    assert slam is not None
    t, found = np.array(true), collect_results(answers)
    for e in slam.floor_map.edges:
        if e.is_loop_closure:  # what it says of the two keyframes, against where the vehicle was
            a, b = (slam.floor_map.keyframes[k] for k in (e.first_index, e.second_index))
            way = complex(*e.measurement[:2]) * np.exp(
                slam.floor_map.nodes[e.first_index, 3] + 1j * slam.floor_map.nodes[e.first_index, 2]
            )
            true_way = places[b.time_s] - places[a.time_s]
            worst = max(worst, abs(way - complex(true_way[0], true_way[1])))
    result = evaluate_trajectory(
        found.time, found.position, found.heading, found.covariance, t[:, 0], t[:, 1:4], t[:, 4], len(answers)
    )
    keys = [k.time_s for k in slam.floor_map.keyframes]
    ratios.extend(rated(e, nodes[keys[e.first_index]], nodes[keys[e.second_index]]) for e in slam.floor_map.edges)
    return result, slam, found, spent / len(answers), worst


ratios: list[np.ndarray] = []
CLOSED_M = 0.05
"""Error at the end of a round below which its loop counts as closed."""


def node(lens: Any, frame: Any, motion: VehicleMotion) -> np.ndarray:
    """Where the camera is, and what the tilt that is told is off by: a true node of the graph."""
    turn, told = motion.attitude, frame.vehicle_estimate
    c = motion.position + turn @ lens.mount.place.to_array()[0]
    roll, pitch = math.atan2(turn[2, 1], turn[2, 2]), -math.asin(turn[2, 0])
    off = (
        body_to_ned_matrix(quaternion_from_euler(roll, pitch, 0.0))
        @ body_to_ned_matrix(quaternion_from_euler(told.roll, told.pitch, 0.0)).T
    )
    return np.array([*c[:2], math.atan2(turn[1, 0], turn[0, 0]), math.log(-c[2]), off[2, 1], off[0, 2], 0.0])


def rated(edge: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """What an edge says of the relation of two true nodes, true tilts given, over its deviations; chi-squared over
    four."""
    off, m = edge.compute_residual(a, b), edge.information
    z = off[:4] - np.linalg.solve(m[:4, :4], edge.gradient[:4] - m[:4, 4:] @ off[4:])
    return np.append(z / np.sqrt(np.diag(np.linalg.inv(m[:4, :4]))), z @ m[:4, :4] @ z / 4)


def tell(name: str, results: list[Any], closures: list[int], worst: list[float], spent: list[float]) -> None:
    """A line for all of a case."""
    rms = [100 * r.horizontal_rms_m for r in results]
    drift = np.sqrt(np.mean([(r.horizontal_end_m / r.way_m) ** 2 for r in results]))
    heading = math.degrees(np.sqrt(np.mean([r.heading_rms_rad**2 for r in results])))
    parts = [
        f"rms {np.sqrt(np.mean(np.square(rms))):.1f} cm (median {np.median(rms):.1f}, worst {max(rms):.1f})",
        f"greatest {100 * max(r.horizontal_worst_m for r in results):.0f} cm",
        f"lost {np.mean([r.lost_share for r in results]):.1%} (worst {max(r.lost_share for r in results):.1%})",
        f"NEES/n {np.mean([r.nees for r in results]):.2f}, "
        f"inside 95 % {np.mean([r.inside_share for r in results]):.1%}",
        f"end {100 * np.mean([r.horizontal_end_m for r in results]):.1f} cm"
        f" after {np.mean([r.way_m for r in results]):.1f} m",
        f"that is {drift:.2%} rms",
        f"heading {heading:.2f} deg",
        f"closures {sum(closures)}, off by {100 * max(worst, default=0):.1f} cm at most",
        f"{1e3 * np.mean(spent):.1f} ms a picture",
    ]
    print(f"{name}: {'; '.join(parts)}", flush=True)


def many(name: str, camera: str, floor: str, seeds: range, duration: float, verbose: bool, **more: Any) -> list[Any]:
    """One case over seeds; return its results. Sequences of which nothing was answered are told and left out."""
    results, closures, worst, spent = [], [], [], []
    for seed in seeds:
        try:
            result, slam, _, each, off = fly(camera, floor, seed, duration, **more)
        except Exception as error:
            print(f"  seed {seed}: {error}", flush=True)
            continue
        results.append(result)
        closures.append(sum(e.is_loop_closure for e in slam.floor_map.edges))
        worst.append(off)
        spent.append(each)
        if verbose:
            tell(f"  {seed}", [result], closures[-1:], [off], [each])
    if results:
        tell(name, results, closures, worst, spent)
    return results


def rms_cm(results: list[Any]) -> float:
    """Root mean square of the sequences' position errors (cm)."""
    return 100 * float(np.sqrt(np.mean([r.horizontal_rms_m**2 for r in results])))


def speed() -> None:
    """Processor's time of one picture, rendering and looking."""
    for camera in ("webcam", "mufly-2.0", "worst"):
        renderer = Renderer(load_camera(camera), make_random_floor("rich", 0, shadows=0.3))
        motion = VehicleMotion(
            0.0, np.array([0.0, 0.0, -1.0]), np.array([0.4, 0.1, 0.0]), np.eye(3), np.array([0.1, 0.2, 0.1])
        )
        renderer.render_picture(motion)
        begin = time.process_time()
        for _ in range(100):
            renderer.render_picture(motion)
        each = (time.process_time() - begin) / 100
        *_, spent, _ = fly(camera, "rich", 1, 6.0, side=2.0, speed=0.4)
        print(
            f"{camera}: rendering {1e3 * each:.1f} ms ({1 / each:.0f}/s), SLAM {1e3 * spent:.1f} ms ({1 / spent:.0f}/s)"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=("quality", "photographs", "loop", "tiles", "edges", "speed"))
    parser.add_argument("--camera", default="mufly-2.0")
    parser.add_argument("--floor", default="rich")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--duration", type=float, default=15.0)
    parser.add_argument("-v", action="store_true")
    parser.add_argument("--record", action="store_true", help=RECORD_HELP)
    a = parser.parse_args()
    record = make_recorder(a.record)
    seeds = range(a.first, a.first + a.seeds)
    match a.case:
        case "quality":
            found = many(f"{a.camera}, {a.floor}", a.camera, a.floor, seeds, a.duration, a.v, side=2.0, speed=0.4)
            if (a.camera, a.floor) == ("mufly-2.0", "rich"):
                record("slam_rms", rms_cm(found))
                record("slam_nees", np.mean([r.nees for r in found]), 100 * np.mean([r.inside_share for r in found]))
            elif (a.camera, a.floor) == ("worst", "rich"):
                record("slam_worst", rms_cm(found))
        case "photographs":
            for name, source in PACKAGE_FLOORS.items():
                if source.find_file() is not None:
                    many(f"{a.camera}, {name}", a.camera, name, seeds, a.duration, a.v, side=2.0, speed=0.4)
        case "loop":
            for close in (False, True):
                name = f"{a.camera}, 20 m round, {'closed' if close else 'not closed'}"
                found = many(name, a.camera, a.floor, seeds, 45.0, a.v, side=5.6, speed=0.45, close=close)
                if close:
                    record("slam_loops", sum(r.horizontal_end_m < CLOSED_M for r in found))
                else:
                    record("slam_drift", 100 * np.sqrt(np.mean([(r.horizontal_end_m / r.way_m) ** 2 for r in found])))
        case "tiles":
            many(f"{a.camera}, tiles", a.camera, "tiles", seeds, a.duration, a.v, side=1.0, speed=0.4)
        case "edges":
            many(f"{a.camera}, {a.floor}", a.camera, a.floor, seeds, a.duration, a.v, side=2.0, speed=0.4)
            along, across, heading, scale = np.sqrt(np.mean(np.square([r[:4] for r in ratios]), axis=0))
            print(
                f"{len(ratios)} edges over their deviations, true tilts given: place {along:.2f}, {across:.2f}, "
                f"heading {heading:.2f}, ln h {scale:.2f}; chi^2/4 {np.mean([r[4] for r in ratios]):.2f}"
            )
        case "speed":
            speed()


if __name__ == "__main__":
    main()
