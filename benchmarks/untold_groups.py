"""Groups of sensor errors, multiplied in the simulator alone.

    python benchmarks/untold_groups.py [--factors 2 3] [--flights 100] [--jobs N] [--out FILE.csv]

Controllers, filter and fault detection keep the vehicle file's errors. Each row flies the demonstration in wind of
0.5 m/s with gusts of 0.3 m/s. ``all`` multiplies noise, bias, drift, wander and dropout of every sensor at once;
ranges, rates, delays and positions keep their values. A run that is stopped resumes: rows in the file stay.
`mufly monte-carlo --vary KEY=200:200% --untold --seed 46100` repeats a group of few keys.
"""

from __future__ import annotations

import argparse
import csv
import os
from pathlib import Path

from mufly.firmware import GenericFirmwareSoftware
from mufly.flight.monte_carlo import Campaign, WorkerPool, parse_variations, run_campaign, summarise_outcome
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

_FIX = "sensors.position_fix."
_ALL = {
    "imu": "accelerometer_noise_density accelerometer_bias accelerometer_drift "
    "accelerometer_temperature_coefficient gyro_noise_density gyro_bias gyro_drift "
    "gyro_temperature_coefficient gyro_g_sensitivity scale_error misalignment "
    "standing_tilt_error vibration.once_per_rev vibration.twice_per_rev "
    "vibration.blade_passing",
    "sonar": "noise resolution dropout_probability multipath_probability",
    "pressure": "noise drift downwash_coefficient",
    "magnetometer": "noise distortion hard_iron field_per_current",
    "rotor_speed": "voltage_noise back_emf_constant_error",
    "battery": "voltage_noise current_noise current_scale_error",
    "position_fix": "latency_jitter noise drift heading_noise heading_drift dropout_probability",
    "ring_camera": "calibration_error spot_radius missed_spot_probability",
}
GROUPS = {
    "wander": [f"{_FIX}drift"],
    "heading": [f"{_FIX}heading_noise", f"{_FIX}heading_drift"],
    "noise": [f"{_FIX}noise"],
    "all": [f"sensors.{sensor}.{key}" for sensor, keys in _ALL.items() for key in keys.split()],
}
COLUMNS = ("group", "factor", "flights", "succeeded", "tipped_over", "overshoot_worst_cm", "tilt_worst_deg", "reasons")


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--factors", type=float, nargs="+", default=[2.0, 3.0])
    ask.add_argument("--flights", type=int, default=100)
    ask.add_argument("--jobs", type=int, default=os.cpu_count())
    ask.add_argument("--seed", type=int, default=46100)
    ask.add_argument("--out", type=Path, default=Path("untold-groups.csv"))
    asked = ask.parse_args()
    vehicle, mission = load_vehicle("mufly-1.1"), load_mission("demonstration")
    done: set[tuple[str, float]] = set()
    if asked.out.exists():
        with asked.out.open(newline="") as file:
            done = {(r["group"], float(r["factor"])) for r in csv.DictReader(file)}
    with asked.out.open("a", newline="") as file, WorkerPool(asked.jobs) as crew:
        table = csv.DictWriter(file, COLUMNS)
        if not done:
            table.writeheader()
        for group, factor in ((g, f) for f in asked.factors for g in GROUPS):
            if (group, factor) in done:
                continue
            share = f"{100 * factor:g}:{100 * factor:g}%"
            campaign = Campaign.create_checked(
                vehicle, mission, variations=parse_variations([f"{k}={share}" for k in GROUPS[group]], vehicle),
                wind=0.5, gust=0.3, seed=asked.seed, sensors="fitted", fast_controllers=GenericFirmwareSoftware,
            )  # fmt: skip
            outcome = summarise_outcome(run_campaign(campaign, asked.flights, crew=crew), campaign.tolerance_m)
            worst = {m.label: f"{m.worst:.3g}" for m in outcome.metric_summaries}
            row = {
                "group": group,
                "factor": factor,
                "flights": outcome.flights,
                "succeeded": outcome.successes,
                "tipped_over": next((n for ending, n, *_ in outcome.endings if ending == "tipped over"), 0),
                "overshoot_worst_cm": worst["overshoot, worst"],
                "tilt_worst_deg": worst["tilt, peak"],
                "reasons": "; ".join(f"{n} x {reason}" for reason, n in outcome.reasons),
            }
            table.writerow(row)
            file.flush()
            print(*row.values(), sep="  ", flush=True)


if __name__ == "__main__":
    main()
