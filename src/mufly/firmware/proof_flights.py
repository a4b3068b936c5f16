"""Many flights for a proof: results are kept in a file as they come, and what is there is not flown again."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mufly.answer_store import AnswerLines
from mufly.errors import InputError
from mufly.mission import Mission, check_geometry
from mufly.results import to_plain_data

ResultT = TypeVar("ResultT")

_FAULT_CHOICES = (
    "", "", "", "sonar.jump=0.3", "sonar.outliers", "ring.outliers", "gyro.outliers", "gyro.jump=0.1",
    "position.dropout", "position.late", "position.jump=0.3", "pressure.drift", "magnetometer.jump",
    "rotor_speed.jump", "battery.jump", "accelerometer.clip", "ring.dropout", "sonar.dropout",
)  # fmt: skip


@dataclass(frozen=True)
class FlightConditions:
    """What a flight of a campaign meets: steady wind and gusts (m/s), and faults of sensors as `--fault` takes them."""

    wind: float
    gust: float
    faults: tuple[str, ...]


def draw_conditions(seed: int) -> FlightConditions:
    """Draw what a flight meets: wind to 0.5 m/s either way, gusts to 0.3, mostly a fault for three seconds."""
    rng = np.random.default_rng([19, seed])
    wind, gust = float(rng.uniform(-0.5, 0.5)), float(rng.uniform(0.0, 0.3))
    fault = _FAULT_CHOICES[int(rng.integers(len(_FAULT_CHOICES)))]
    at = float(rng.uniform(6.0, 40.0))
    return FlightConditions(wind, gust, (f"{fault}@{at:.1f}s+3s",) if fault else ())


def add_random_obstacle(mission: Mission, seed: int) -> Mission:
    """Put a box or a post near a leg, drawn by the seed; every third flight, and where none fits, is as it was."""
    rng = np.random.default_rng([20, seed])
    places = [w.position_m for w in mission.waypoint]
    for _ in range(20 if seed % 3 and len(places) > 1 else 0):
        k = int(rng.integers(1, len(places)))
        (n, e, _), (gn, ge, _) = places[k - 1], places[k]
        share = float(rng.uniform(0.3, 0.7))
        at = (
            n + share * (gn - n) + float(rng.normal(0.0, 0.2)),
            e + share * (ge - e) + float(rng.normal(0.0, 0.2)),
        )
        size = float(rng.uniform(0.1, 0.5))
        if rng.integers(2):
            more: dict[str, Any] = {"cylinder": ({"centre_m": at, "radius_m": 0.5 * size, "height_m": 3.0},)}
        else:
            box = {
                "centre_m": (*at, -1.5),
                "size_m": (size, 0.4, 3.0),
                "yaw_deg": float(rng.uniform(-90.0, 90.0)),
            }
            more = {"box": (*mission.box, box)}
        met = mission.with_parts(**more)
        try:
            check_geometry(met, mission.name)
        except InputError:
            continue
        return met
    return mission


def resume_flights(
    kind: Callable[..., ResultT],
    keep: Path | None,
    asked: Sequence[tuple[str, int]],
    fly: Callable[[str, int], ResultT],
    on_flight: Callable[[ResultT], None] | None = None,
) -> list[ResultT]:
    """Fly what has not been flown yet.

    Parameters
    ----------
    kind : callable
        Makes a result of the fields of a line.
    keep : path, optional
        A line of JSON a flight, with its mission as it was asked for; written as they come.
    asked : sequence of (mission, seed)
    fly : callable
        Flies one of them.
    on_flight : callable, optional
        Told every result, also of those that are there.

    Raises
    ------
    InputError
        If the file holds something else.
    """

    def read(row: Any) -> tuple[tuple[str, int], ResultT]:
        name = str(row.pop("asked"))
        return (name, int(row["seed"])), kind(**row)

    kept = AnswerLines(keep, read, damaged=("is no result of these flights", "give a new file"))
    results = []
    for name, seed in asked:
        if (name, seed) not in kept.known:
            one = fly(name, seed)
            gc.collect()  # a flight's recording hangs in a ring of few, great objects: 5 MB each until someone looks
            kept.add((name, seed), one, {"asked": name, **to_plain_data(one)})
        results.append(kept.known[name, seed])
        if on_flight is not None:
            on_flight(results[-1])
    return results
