"""Run verification campaigns of many flights; results are appended to a file, and existing ones are not repeated."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mufly.errors import InputError
from mufly.files.answer_store import StoredResultLines
from mufly.mission import Mission, check_mission_clearance
from mufly.results import to_plain_data

ResultT = TypeVar("ResultT")

_FAULT_CHOICES = (
    "", "", "", "sonar.jump=0.3", "sonar.outliers", "ring.outliers", "gyro.outliers", "gyro.jump=0.1",
    "position.dropout", "position.late", "position.jump=0.3", "pressure.drift", "magnetometer.jump",
    "rotor_speed.jump", "battery.jump", "accelerometer.clip", "ring.dropout", "sonar.dropout",
)  # fmt: skip


@dataclass(frozen=True)
class FlightConditions:
    """Conditions of a flight: steady wind and gusts (m/s), and sensor faults in the notation of `--fault`."""

    wind: float
    gust: float
    faults: tuple[str, ...]


def draw_wind_and_fault(seed: int) -> FlightConditions:
    """Draw random conditions: wind within ±0.5 m/s, gusts up to 0.3 m/s, in most flights a fault of 3 s."""
    rng = np.random.default_rng([19, seed])
    wind, gust = float(rng.uniform(-0.5, 0.5)), float(rng.uniform(0.0, 0.3))
    fault = _FAULT_CHOICES[int(rng.integers(len(_FAULT_CHOICES)))]
    at = float(rng.uniform(6.0, 40.0))
    return FlightConditions(wind, gust, (f"{fault}@{at:.1f}s+3s",) if fault else ())


def add_random_obstacle(mission: Mission, seed: int) -> Mission:
    """Return the mission with a random box or post near a leg; unchanged for every third seed, or if none fits."""
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
        met = mission.replace_parts(**more)
        try:
            check_mission_clearance(met, mission.name)
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
    """Return the results of the flights ``asked``: stored results, and those of flights that are flown now.

    Parameters
    ----------
    kind : callable
        Constructor of a result from the fields of a line.
    keep : path, optional
        File with a line of JSON per flight, appended after each flight.
    asked : sequence of (mission, seed)
    fly : callable
        Function that flies a mission with a seed.
    on_flight : callable, optional
        Called with every result, stored ones included.

    Raises
    ------
    InputError
        If the file contains other data.
    """

    def parse_stored_result(row: Any) -> tuple[tuple[str, int], ResultT]:
        name = str(row.pop("asked"))
        return (name, int(row["seed"])), kind(**row)

    kept = StoredResultLines(keep, parse_stored_result, damaged=("is no result of these flights", "give a new file"))
    results = []
    for name, seed in asked:
        if (name, seed) not in kept.known:
            one = fly(name, seed)
            gc.collect()  # a recording (5 MB) is part of a reference cycle
            kept.append_result((name, seed), one, {"asked": name, **to_plain_data(one)})
        results.append(kept.known[name, seed])
        if on_flight is not None:
            on_flight(results[-1])
    return results
