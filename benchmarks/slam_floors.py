"""Visual SLAM over real and made floors: consistency, wrong closures, and errors that are not told.

    python benchmarks/slam_floors.py --seeds 5                        # photographs of packages, made floors, built in
    python benchmarks/slam_floors.py --floors brick,felt --seeds 20 --kept rounds.jsonl

Photographs come from installed packages (`mufly slam floors`); the weak floors are those of the tests, as `made-NAME`.
A round of a 2 m square takes 15 s, the camera is that of mufly-2.0, 5 % of the pictures are lost. A floor passes if
each round is within 5 cm rms, or a fifth of it is lost, and no error beyond 5 cm and 3 deviations is untold for over
1 s; if the mean NEES/n is 0.7 to 1.5 and 88 to 98 % of the poses are inside 95 %; and if no closure is wrong (10 cm).
A round takes some 8 s of one core; those in the file of `--kept` are not flown again.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from slam import fly

from mufly.camera import PACKAGE_FLOORS
from mufly.slam import make_square_path

_spec = importlib.util.spec_from_file_location("weak", Path(__file__).parents[1] / "tests" / "slam" / "conftest.py")
assert _spec is not None
assert _spec.loader is not None
weak: Any = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(weak)

KEPT_M, LOST_SHARE, TOLD_S, WRONG_CLOSURE_M = 0.05, 0.2, 1.0, 0.1
NEES_RANGE, INSIDE_RANGE = (0.7, 1.5), (0.88, 0.98)
DURATION_S, SIDE_M, SPEED_M_S = 15.0, 2.0, 0.4
BUILT_IN, MADE = ("rich", "tiles"), "made-"


@dataclass(frozen=True)
class Round:
    """Result of one round over a floor."""

    horizontal_rms_m: float
    lost: float
    nees: float
    inside: float
    closure_m: float
    untold_s: float

    @property
    def is_kept(self) -> bool:
        return (self.horizontal_rms_m <= KEPT_M or self.lost > LOST_SHARE) and self.untold_s <= TOLD_S


def fly_round(floor: str, seed: int) -> Round:
    """Fly one round; a round without any pose is lost and told."""
    try:
        result, _, found, _, closure_m = fly("mufly-2.0", floor, seed, DURATION_S, side=SIDE_M, speed=SPEED_M_S)
    except Exception as error:
        print(f"  {floor} {seed}: {error}", flush=True)
        return Round(0.0, 1.0, float("nan"), float("nan"), 0.0, 0.0)
    path = make_square_path(duration_s=DURATION_S, side_m=SIDE_M, speed_m_s=SPEED_M_S, seed=seed)
    true = np.stack([np.interp(found.time, path.time_s, x) for x in path.position_m[:, :2].T], axis=1)
    off = np.hypot(*(found.position[:, :2] - true).T)
    sigma = np.sqrt(np.trace(found.covariance[:, :2, :2], axis1=1, axis2=2))
    untold = longest_run(found.time, off > KEPT_M + 3.0 * sigma)
    return Round(result.horizontal_rms_m, result.lost_share, result.nees, result.inside_share, closure_m, untold)


def longest_run(time_s: np.ndarray, mask: np.ndarray) -> float:
    """Return the longest time for which a mask holds without a break (s)."""
    longest, begin = 0.0, None
    for t, wrong in zip(time_s, mask, strict=True):
        begin = (t if begin is None else begin) if wrong else None
        longest = max(longest, 0.0 if begin is None else t - begin)
    return longest


def judge_floor(name: str, rounds: list[Round]) -> bool:
    """Print a floor's row; return whether it passes."""
    kept = sum(r.is_kept for r in rounds)
    nees, inside = (float(np.nanmean([getattr(r, n) for r in rounds])) for n in ("nees", "inside"))
    wrong = sum(r.closure_m > WRONG_CLOSURE_M for r in rounds)
    passes = kept == len(rounds) and not wrong and (NEES_RANGE[0] <= nees <= NEES_RANGE[1] or not np.isfinite(nees))
    passes = passes and (not np.isfinite(inside) or INSIDE_RANGE[0] <= inside <= INSIDE_RANGE[1])
    parts = [
        f"{name}: {'passes' if passes else 'fails'}",
        f"rms {' '.join(f'{100 * r.horizontal_rms_m:.1f}' for r in rounds)} cm",
        f"lost {np.mean([r.lost for r in rounds]):.0%}",
        f"NEES/n {nees:.2f}",
        f"inside {inside:.0%}",
        f"wrong closures {wrong}",
        f"kept or told {kept} of {len(rounds)}",
        f"longest untold error {max(r.untold_s for r in rounds):.1f} s",
    ]
    print("; ".join(parts), flush=True)
    return passes


def main() -> None:
    photographs = [name for name, source in PACKAGE_FLOORS.items() if source.find_file() is not None]
    every = [*photographs, *map(MADE.__add__, weak.WEAK_FLOORS), *BUILT_IN]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--floors", default=",".join(every))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kept", type=Path, help="a line of JSON a round")
    a = parser.parse_args()
    passed, names = 0, a.floors.split(",")
    known: dict[tuple[str, int], Round] = {}
    if a.kept is not None and a.kept.exists():
        lines = map(json.loads, a.kept.read_text().splitlines())
        known = {(r.pop("floor"), r.pop("seed")): Round(**r) for r in lines}
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            rounds = []
            for seed in range(a.first, a.first + a.seeds):
                if (name, seed) in known:
                    rounds.append(known[name, seed])
                    continue
                floor = name
                if name.startswith(MADE):
                    floor = str(Path(folder) / f"{name}-{seed}.png")
                    Image.fromarray(weak.draw_floor(name.removeprefix(MADE), seed)).save(floor)
                rounds.append(fly_round(floor, seed))
                if a.kept is not None:
                    with a.kept.open("a") as file:
                        file.write(json.dumps({"floor": name, "seed": seed, **asdict(rounds[-1])}) + "\n")
            passed += judge_floor(name, rounds)
    print(f"{passed} of {len(names)} floors pass")


if __name__ == "__main__":
    main()
