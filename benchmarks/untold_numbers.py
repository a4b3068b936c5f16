"""Each number that the simulator and the flight software both read, varied in the simulator alone.

    python benchmarks/untold_numbers.py [--flights 12] [--only sensors.imu] [--out FILE.csv]

Truth and filter, truth and fault detection, and truth and arming check read one vehicle file, so an error in it is
invisible to every flight on it. Each row flies one changed number; controllers, filter and checks keep the file's.
A share is tried at both ends of the scale (0.5 and 2 times, geometry and inertia 0.8 and 1.25 times); a number of 0 and
a position are shifted instead. Numbers that only one side reads are listed without flights. A run that is stopped
resumes: rows in the file are not flown again.

The mission is short (take off, 1.5 m, land), in wind of 0.5 m/s with gusts of 0.3 m/s; ``flight K`` of every row has
the same seed, so rows differ by the number alone. `mufly monte-carlo --vary KEY=200:200% --untold` repeats a row of a
single number over any mission.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np

from mufly.control import design_flight_controller
from mufly.errors import InputError
from mufly.firmware import GenericFirmwareSoftware
from mufly.flight.monte_carlo import Campaign, fly_case
from mufly.flight.monte_carlo.campaign import FlightCase
from mufly.mission import parse_mission
from mufly.vehicle import Parameter, list_parameters, load_vehicle, replace_parameters

MISSION = {"take_off": {"height_m": 1.0, "wait_s": 2.0}, "waypoint": [{"position_m": [1.5, 0.0, -1.0], "wait_s": 2.0}]}
# Ends of the scale of numbers that a builder weighs or measures, not guesses.
CLOSELY_KNOWN = ("body.mass", "body.inertia", "air.", "rotors.", "swash_plate.", "stabiliser_bar.", "motor.", "gear.",
                 "battery.nominal", "battery.open")  # fmt: skip
CLOSE, WIDE = (0.8, 1.25), (0.5, 2.0)
SHIFTS = {  # of numbers that are 0 in the file, and of positions (m, rad, 1, N m)
    "sensors.imu.mount_roll": 0.035, "sensors.imu.mount_pitch": 0.035, "sensors.imu.mount_yaw": 0.035,
    "sensors.imu.position": 0.02, "sensors.sonar.position": 0.02, "swash_plate.phase": 0.087,
    "rotors.ground_effect": 1.0, "motor.friction_torque": 2e-4,
}  # fmt: skip
UNREAD = {
    "mass_budget": "neither side: the flight model reads body.mass",
    "range_ring": "neither side: the ring camera's keys are read instead",
    "battery.low_voltage": "the flight software alone",
}
COLUMNS = ("key", "change", "flights", "succeeded", "tipped_over", "tilt_worst_deg", "off_waypoint_worst_m",
           "nees_median", "false_reports", "reason")  # fmt: skip


def changed_values(p: Parameter) -> list[tuple[str, Any]]:
    """Names and values (SI) of both changes of a parameter; none where a change has no meaning."""
    if p.key in SHIFTS:
        d = SHIFTS[p.key]
        if isinstance(p.value, tuple):  # a position: down is the axis that matters for a height
            return [
                (f"z {s * d:+g} m", tuple((*q[:2], q[2] + s * d) if k == 0 else q for k, q in enumerate(p.value)))
                for s in (-1, 1)
            ]
        low = -d if "mount" in p.key or "phase" in p.key else 0.5 * d
        return [(f"{x:+g} {p.unit}", x) for x in (low, d)]
    if isinstance(p.value, tuple):
        if np.ndim(p.value) > 1:
            return []
        return [(f"x {f:g}", tuple(f * x for x in p.value)) for f in (0.95, 1.05)]
    if not isinstance(p.value, float) or p.value == 0.0:
        return []
    ends = CLOSE if p.key.startswith(CLOSELY_KNOWN) else WIDE
    return [(f"x {f:g}", f * p.value) for f in ends]


def fly_row(campaign: Campaign, key: str, change: str, value: Any, flights: int) -> dict[str, Any]:
    """Fly one row; seeds and wind are those of the unchanged campaign."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS, "") | {"key": key, "change": change}
    if key:
        try:
            replace_parameters(campaign.vehicle, {key: value})
        except InputError as error:
            return row | {"flights": 0, "reason": f"refused: {error}"}
    results = []
    for k in range(flights):
        base = campaign.draw_case(k)
        results.append(fly_case(campaign, FlightCase(k, base.seed, {key: value} if key else {}, base.wind)))
    bad = [r for r in results if not r.success]

    def worst(name: str) -> str:
        values = [getattr(r, name) for r in results if getattr(r, name) is not None]
        return f"{max(values):.3g}" if values else ""

    told = [r.reported_outcome for r in results if not r.reported_outcome.startswith("succeeded")]
    nees = [r.nees for r in results if r.nees is not None]
    return row | {
        "flights": flights,
        "succeeded": flights - len(bad),
        "tipped_over": sum(r.ending == "tipped over" for r in results),
        "tilt_worst_deg": worst("tilt_peak_deg"),
        "off_waypoint_worst_m": worst("waypoint_error_m"),
        "nees_median": f"{np.median(nees):.3g}" if nees else "",
        "false_reports": len(told),
        "reason": "; ".join(dict.fromkeys([r.reason for r in bad] + told))[:160],
    }


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--flights", type=int, default=12)
    ask.add_argument("--only", default="", help="beginning of the keys to vary, or several, separated by commas")
    ask.add_argument("--out", type=Path, default=Path("untold-numbers.csv"))
    ask.add_argument("--vehicle", default="mufly-1.1")
    asked = ask.parse_args()
    vehicle = load_vehicle(asked.vehicle)
    campaign = Campaign.create_checked(
        vehicle, parse_mission(MISSION), wind=0.5, gust=0.3, seed=2911, controller=design_flight_controller(vehicle),
        fast_controllers=GenericFirmwareSoftware,
    )  # fmt: skip
    done: set[tuple[str, str]] = set()
    if asked.out.exists():
        with asked.out.open(newline="") as file:
            done = {(r["key"], r["change"]) for r in csv.DictReader(file)}
    with asked.out.open("a", newline="") as file:
        table = csv.DictWriter(file, COLUMNS)
        if not done:
            table.writeheader()

        def write(row: dict[str, Any]) -> None:
            table.writerow(row)
            file.flush()
            print(*(f"{row[c]}" for c in COLUMNS), sep="  ", flush=True)

        rows = [("", "as filed", None)]
        for p in list_parameters(vehicle):
            if p.key.startswith(tuple(asked.only.split(","))):
                unread = next((why for start, why in UNREAD.items() if p.key.startswith(start)), "")
                rows += [(p.key, f"not varied: {unread}", None)] if unread else [(p.key, *c) for c in changed_values(p)]
        for key, change, value in rows:
            if (key, change) in done:
                continue
            if key and value is None:
                write(dict.fromkeys(COLUMNS, "") | {"key": key, "change": change, "flights": 0})
            else:
                write(fly_row(campaign, key, change, value, asked.flights))


if __name__ == "__main__":
    main()
