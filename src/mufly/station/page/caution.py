"""Before a vehicle is sent off: which checks failed, whether a place can be flown to, and what is asked twice.

QGroundControl asks for a slide before it arms, takes off, starts a mission, lands and returns ("guided actions"). Here
the button, or its key, is pressed a second time within three seconds. A hover and the emergency stop's own two presses
stay as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mufly.mission import Fence, Mission, fence_fault, fence_outlines, way_fault
from mufly.mission.fence import KEEP_M
from mufly.mission.timing import reach_time
from mufly.station.checks import CHARGE_LEAST, OWN_CHECKS, RESERVE
from mufly.station.endurance import limited_mission
from mufly.station.history import Check, Snapshot, clock
from mufly.station.remote import RemoteVehicle

CONFIRM_S = 3.0
"""A second press has to follow within so long (s)."""
FAR_M = 10.0
"""A place without a fence around it is asked for twice beyond so far from where the vehicle is (m)."""
CHARGE_CRITICAL, LEFT_CRITICAL_S, LEFT_LOW_S = 0.15, 30.0, 60.0
CONFIRMED = {
    "mission": "fly the mission",
    "take_off": "take off",
    "arm": "arm",
    "land": "land",
    "return": "return",
}
"""Commands that are pressed twice, and what they do in words."""


class Confirmation:
    """What was pressed once and waits for its second press.

    Parameters
    ----------
    now : callable
        Monotonic clock (s).
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._what: object = None
        self._since_s = -math.inf

    def waits_for(self, what: object) -> bool:
        """Whether a press of this is the second one."""
        return self._what == what and self._now() - self._since_s < CONFIRM_S

    def press(self, what: object) -> bool:
        """Take a press; whether it is the second one of the same."""
        sure = self.waits_for(what)
        self._what, self._since_s = (None, -math.inf) if sure else (what, self._now())
        return sure


def failed_checks(checks: Iterable[Check]) -> list[str]:
    """Names of the checks that failed; the vehicle's own apart, since these disable the button by themselves."""
    return [c.name for c in checks if c.ok is False and c.name != OWN_CHECKS]


@dataclass(frozen=True, slots=True)
class Errand:
    """Whether a vehicle may be sent to a place.

    Attributes
    ----------
    refused : str
        Why not, with the numbers; "" if it may.
    beware : str
        Why it is asked for twice; "" if once will do.
    """

    refused: str = ""
    beware: str = ""


def judge_errand(
    s: Snapshot, fence: Fence | None, limits: Mission, place: tuple[float, float, float], far_m: float = FAR_M
) -> Errand:
    """Judge a place to fly to.

    Parameters
    ----------
    s : Snapshot
        Where the vehicle is, and how long its battery lasts.
    fence : Fence or None
        The vehicle's.
    limits : Mission
        With the vehicle's limits.
    place : (3,) tuple
        N, E, D (m).
    far_m : float
        Without a fence, farther than this from the vehicle it is asked for twice (m).
    """
    if fault := fence_fault(fence, place, KEEP_M):
        return Errand(refused=f"it is {fault}")
    here = s.estimate.position
    if not np.isfinite(here).all():
        return Errand(beware="nobody knows where the vehicle is")
    if fault := way_fault(fence, here, place):
        return Errand(refused=fault)
    away, needed = math.dist(here.tolist(), place), reach_time(limits, here, place)
    if needed > s.battery_left_s:
        return Errand(
            refused=f"getting there and down takes {clock(needed)}, the battery lasts {clock(s.battery_left_s)}"
        )
    if needed > (1.0 - RESERVE) * s.battery_left_s:
        return Errand(
            beware=f"it takes {clock(needed)} of the {clock(s.battery_left_s)} that the battery lasts"
        )
    if fence is None and away > far_m:
        return Errand(beware=f"{away:.0f} m away, and there is no fence")
    return Errand()


def errand_of(vehicle: RemoteVehicle, place: tuple[float, float, float]) -> Errand:
    """Judge a place (N, E, D; m) for a vehicle."""
    limits = limited_mission(vehicle.parameters, vehicle.surroundings.base)
    return judge_errand(vehicle.snapshot, vehicle.fence, limits, place)


def battery_words(s: Snapshot) -> tuple[str, str] | None:
    """Return how serious a battery is ("", "warning", "error") and the battery in words; None where it is not told."""
    charge, left = s.battery_charge, s.battery_left_s
    volts = s.estimate.battery_voltage
    parts = (
        [f"{100 * charge:.0f} %"]
        if math.isfinite(charge)
        else [f"{volts:.2f} V"]
        if math.isfinite(volts)
        else []
    )
    if not parts:
        return None
    if math.isfinite(left):
        parts.append(f"{clock(left)} left")
    empty, low = (
        charge <= CHARGE_CRITICAL or left <= LEFT_CRITICAL_S,
        charge < CHARGE_LEAST or left <= LEFT_LOW_S,
    )
    return "error" if empty else "warning" if low else "", ", ".join(parts)


def drawn_fence(fence: Fence | None) -> dict[str, Any] | None:
    """Return a fence as the 3-D scene draws it: zones ``{in: bool, p: [[N, E], ...]}`` and the ceiling (m) or None."""
    if fence is None:
        return None
    return {
        "zones": [{"in": inside, "p": corners} for inside, corners in fence_outlines(fence)],
        "ceiling": fence.ceiling_m,
    }
