"""Flights of Betaflight's SITL on mufly's plant: arm, take off, hover, a square of 1 m, land; errors by the truth.

    python benchmarks/betaflight_flights.py BETAFLIGHT_SITL --seeds 20 --wind 0.3

BETAFLIGHT_SITL is the program that ``make TARGET=SITL EXTRA_FLAGS=-DUSE_SERVOS`` builds from Betaflight 4.6. Every seed
starts one of its own, with the CLI file of ``mufly autopilot gains betaflight``; seeds turn the wind by 137.5 degrees
each. Overshoot: largest distance of the height above its reference after the take-off, and of the position from its
reference in the square.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from pathlib import Path

import numpy as np

from mufly.bridges.autopilot_gains import AutopilotGains
from mufly.bridges.autopilot_plant import AutopilotPlant, warm_up_plant
from mufly.bridges.betaflight.betaflight_cli import run_betaflight
from mufly.bridges.betaflight.betaflight_link import BETAFLIGHT_RATE_HZ, BetaflightSimulator
from mufly.bridges.betaflight.betaflight_pilot import BetaflightPilot, PilotPlan
from mufly.bridges.betaflight.betaflight_settings import design_betaflight_gains, format_cli_file
from mufly.mission import Mission
from mufly.vehicle import Vehicle, load_vehicle

WALL_LIMIT_S, STOPPED_S = 600.0, 0.5
GOLDEN_ANGLE = math.radians(137.5)


def fly_seed(
    program: Path, vehicle: Vehicle, gains: AutopilotGains, seed: int, *, wind_m_s: float, gust_m_s: float, speed: float
) -> dict[str, float | str]:
    """Fly one seed and return its errors."""
    plan, pilot = PilotPlan(), BetaflightPilot(gains)
    wind = (wind_m_s * math.cos(seed * GOLDEN_ANGLE), wind_m_s * math.sin(seed * GOLDEN_ANGLE), 0.0)
    events: list[str] = []
    rows: list[tuple[str, float, float]] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        run_betaflight(program, Path(folder), format_cli_file(vehicle, gains)),
        AutopilotPlant(
            vehicle, Mission(name="hall"), rate_Hz=BETAFLIGHT_RATE_HZ, autopilot="Betaflight", wind=wind,
            gust=gust_m_s, seed=seed,
        ) as plant,
    ):  # fmt: skip
        plant.listeners.append(lambda event: events.append(event.text))
        simulator = BetaflightSimulator(plant, pilot, speed=speed)
        begun_s = time.monotonic()

        def keep_row() -> None:
            error = pilot.reference - plant.truth.position
            rows.append((pilot.phase, float(np.hypot(error[0], error[1])), float(error[2])))

        simulator.on_period = keep_row
        simulator.run(
            lambda: (pilot.phase == "landed" and pilot.phase_s > STOPPED_S) or time.monotonic() - begun_s > WALL_LIMIT_S
        )
        wall_s, crash = time.monotonic() - begun_s, plant.plant.crash_cause
        resent, tilt = simulator.unanswered_count, float(np.degrees(np.max(np.abs(plant.truth.attitude[:2]))))
        simulated_s = plant.time_s

    def errors(phase: str, column: int) -> np.ndarray:
        return np.array([row[column] for row in rows if row[0] == phase] or [math.nan])

    flown = pilot.phase == "landed" and not crash and tilt < 10.0 and len(errors("hover", 1)) > 1
    settled = errors("hover", 1)[len(errors("hover", 1)) // 2 :]
    return {
        "seed": seed, "flown": "yes" if flown else crash or f"ended in {pilot.phase}",
        "height_overshoot_m": float(np.max(errors("hover", 2))), "hover_error_m": float(np.max(errors("hover", 1))),
        "hover_rms_m": float(np.sqrt(np.mean(settled**2))), "square_error_m": float(np.max(errors("square", 1))),
        "hover_height_rms_m": float(np.sqrt(np.mean(errors("hover", 2)[len(settled) :] ** 2))),
        "resent": resent, "simulated_s": simulated_s, "wall_s": wall_s, "plan_height_m": plan.height_m,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=Path)
    parser.add_argument("--vehicle", default="mufly-1.1")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--wind", type=float, default=0.3, help="m/s")
    parser.add_argument("--gust", type=float, default=0.0, help="m/s")
    parser.add_argument("--speed", type=float, default=1.0)
    chosen = parser.parse_args()
    vehicle = load_vehicle(chosen.vehicle)
    gains = design_betaflight_gains(vehicle)
    warm_up_plant(vehicle, BETAFLIGHT_RATE_HZ)
    flights = []
    for seed in range(chosen.first, chosen.first + chosen.seeds):
        flights.append(
            fly_seed(
                chosen.program, vehicle, gains, seed, wind_m_s=chosen.wind, gust_m_s=chosen.gust, speed=chosen.speed
            )
        )
        print(json.dumps(flights[-1]), flush=True)
    flown = [f for f in flights if f["flown"] == "yes"]
    print(f"{len(flown)} of {len(flights)} flown")


if __name__ == "__main__":
    main()
