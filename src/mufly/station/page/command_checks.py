"""Checks before a command: failed preflight checks, reachability of a destination, and confirmation.

QGroundControl asks for a slide before it arms, takes off, starts a mission, lands and returns ("guided actions"). On
this page the button, or its key, is pressed a second time within three seconds. A hover needs one press. The emergency
stop counts its two presses separately.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mufly.mission import Fence, Mission, describe_fence_violation, describe_path_fence_violation, fence_outlines
from mufly.mission.files.geofence import FENCE_MARGIN_M
from mufly.mission.files.mission_timing import compute_time_to_land_at
from mufly.station.mission_endurance import make_mission_with_limits
from mufly.station.preflight_checks import BATTERY_RESERVE_FRACTION, MIN_BATTERY_CHARGE_FRACTION, PREARM_CHECKS_NAME
from mufly.station.remote.remote_vehicle import RemoteVehicle
from mufly.station.signal_history import PreflightCheck, VehicleSnapshot, format_minutes_seconds

CONFIRM_TIMEOUT_S = 3.0
"""Time limit of the second press (s)."""
MAX_UNCONFIRMED_DISTANCE_M = 10.0
"""Distance from the vehicle beyond which a destination without a fence needs confirmation (m)."""
CRITICAL_CHARGE_FRACTION, CRITICAL_REMAINING_TIME_S, LOW_REMAINING_TIME_S = 0.15, 30.0, 60.0
COMMANDS_NEEDING_CONFIRMATION = {
    "mission": "start the mission",
    "take_off": "take off",
    "arm": "arm",
    "land": "land",
    "return": "return",
}
"""Commands that need a second press, and their descriptions."""


class Confirmation:
    """A command that was pressed once and waits for its second press.

    Parameters
    ----------
    now : callable
        Monotonic clock (s).
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._what: object = None
        self._since_s = -math.inf

    def would_be_second_press(self, what: object) -> bool:
        """Return whether a press of this command would be the second one."""
        return self._what == what and self._now() - self._since_s < CONFIRM_TIMEOUT_S

    def register_press(self, what: object) -> bool:
        """Register a press; return whether it is the second one of the same command."""
        sure = self.would_be_second_press(what)
        self._what, self._since_s = (None, -math.inf) if sure else (what, self._now())
        return sure


def failed_check_names(checks: Iterable[PreflightCheck]) -> list[str]:
    """Return the names of the station's failed checks, without the vehicle's own, which already disable the button."""
    return [c.name for c in checks if c.ok is False and c.name != PREARM_CHECKS_NAME]


@dataclass(frozen=True, slots=True)
class DestinationCheck:
    """The result of the check of a destination.

    Attributes
    ----------
    refusal_reason : str
        Reason of a refusal, with the numbers; "" if allowed.
    caution_reason : str
        Reason for a confirmation; "" if none is needed.
    """

    refusal_reason: str = ""
    caution_reason: str = ""


def check_destination(
    s: VehicleSnapshot, fence: Fence | None, limits: Mission, place: tuple[float, float, float]
) -> DestinationCheck:
    """Check whether a vehicle may be sent to a destination: distance, geofence and battery.

    Parameters
    ----------
    s : VehicleSnapshot
        Position and remaining battery time of the vehicle.
    fence : Fence or None
        Geofence of the vehicle.
    limits : Mission
        Mission with the vehicle's limits.
    place : (3,) tuple
        N, E, D (m).
    """
    if fault := describe_fence_violation(fence, place, FENCE_MARGIN_M):
        return DestinationCheck(refusal_reason=f"destination is {fault}")
    here = s.estimate.position
    if not np.isfinite(here).all():
        return DestinationCheck(caution_reason="position of the vehicle unknown")
    if fault := describe_path_fence_violation(fence, here, place):
        return DestinationCheck(refusal_reason=fault)
    away, needed = math.dist(here.tolist(), place), compute_time_to_land_at(limits, here, place)
    if needed > s.battery_left_s:
        return DestinationCheck(
            refusal_reason=(
                f"flight there and landing take {format_minutes_seconds(needed)}, battery time left is "
                f"{format_minutes_seconds(s.battery_left_s)}"
            )
        )
    if needed > (1.0 - BATTERY_RESERVE_FRACTION) * s.battery_left_s:
        return DestinationCheck(
            caution_reason=(
                f"flight takes {format_minutes_seconds(needed)}, "
                f"battery time left is {format_minutes_seconds(s.battery_left_s)}"
            )
        )
    if fence is None and away > MAX_UNCONFIRMED_DISTANCE_M:
        return DestinationCheck(caution_reason=f"{away:.0f} m away, no geofence")
    return DestinationCheck()


def check_vehicle_destination(vehicle: RemoteVehicle, place: tuple[float, float, float]) -> DestinationCheck:
    """Check a destination (N, E, D; m) for a vehicle."""
    limits = make_mission_with_limits(vehicle.parameters, vehicle.station_context.base_mission)
    return check_destination(vehicle.snapshot, vehicle.fence, limits, place)


def describe_battery(s: VehicleSnapshot) -> tuple[str, str] | None:
    """Return how serious a battery's state is ("", "warning" or "error"), and a description; None if unknown."""
    charge, left = s.battery_charge, s.battery_left_s
    volts = s.estimate.battery_voltage
    parts = [f"{100 * charge:.0f} %"] if math.isfinite(charge) else [f"{volts:.2f} V"] if math.isfinite(volts) else []
    if not parts:
        return None
    if math.isfinite(left):
        parts.append(f"{format_minutes_seconds(left)} left")
    empty, low = (
        charge <= CRITICAL_CHARGE_FRACTION or left <= CRITICAL_REMAINING_TIME_S,
        charge < MIN_BATTERY_CHARGE_FRACTION or left <= LOW_REMAINING_TIME_S,
    )
    return "error" if empty else "warning" if low else "", ", ".join(parts)


def encode_fence(fence: Fence | None) -> dict[str, Any] | None:
    """Return a fence as the 3-D scene draws it: zones ``{in: bool, p: [[N, E], ...]}`` and the ceiling (m) or None."""
    if fence is None:
        return None
    return {
        "zones": [{"in": inside, "p": corners} for inside, corners in fence_outlines(fence)],
        "ceiling": fence.ceiling_m,
    }
