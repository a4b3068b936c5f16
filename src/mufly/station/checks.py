"""What to look at before a flight, as far as a vehicle and its station can tell.

Any MAVLink vehicle can answer most of it; what it does not tell cannot be judged (``ok`` is None), which is not a
fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mufly.link.mission_transfer import Item
from mufly.mission import Mission
from mufly.station.commands import StatusTexts
from mufly.station.endurance import planned_flight
from mufly.station.history import Check, Snapshot, clock
from mufly.station.telemetry import EstimatorStatus, Telemetry
from mufly.station.transfers import RemoteMission, RemoteParameters, same_mission
from mufly.vehicle_types import ARDUPILOT

LOSS_MOST = 0.1
CHARGE_LEAST = 0.3
TILT_MOST_RAD = math.radians(5.0)
STILL_M_S = 0.1
RESERVE = 0.2
"""Share of the battery that a mission must leave."""
DISK_LEAST_BYTES = 200e6
OWN_CHECKS = "vehicle's own checks"
_OF_STATION = ("heard", "link", "recording", "disk")
_PREARM = 268435456  # MAV_SYS_STATUS_PREARM_CHECK

_Judged = tuple[bool | None, str]


@dataclass(slots=True)
class Surroundings:
    """What the station knows besides what the vehicle tells.

    Attributes
    ----------
    recording : bool or None
        Whether the recorder runs; None: there is none.
    free_bytes : float
        Room on the disk it writes to; NaN where unknown.
    shown : tuple of Item or None
        The mission that the page shows, to be compared with what the vehicle holds.
    base : Mission or None
        The mission file that the vehicle was started with, where the station knows it: for what items do not carry.
    """

    recording: bool | None = None
    free_bytes: float = math.nan
    shown: tuple[Item, ...] | None = None
    base: Mission | None = None


def judge(
    s: Snapshot,
    told: Telemetry,
    texts: StatusTexts,
    mission: RemoteMission,
    parameters: RemoteParameters,
    around: Surroundings,
) -> list[Check]:
    """Return the checks of a vehicle, of what its parts know."""
    judged: dict[str, _Judged] = {
        "heard": _heard(s),
        "link": _link(s),
        "command": _commander(s, told.commander),
        OWN_CHECKS: _health(told.health, texts),
        "battery": _battery(s),
        "level and still": _level(s),
        "position": _position(s),
        **({} if told.estimator is None else {"estimator": _estimator(told.estimator)}),
        "mission": _mission(mission.items, around.shown),
        "time to fly": _endurance(s, told, mission.items or (), parameters, around.base),
        "parameters": _parameters(parameters),
        "recording": _recording(around.recording),
        "disk": _disk(around.free_bytes),
    }
    if not s.connected and math.isfinite(s.silent_s):
        # What it said last may be true no more.
        judged |= {
            name: (None, f"not heard for {s.silent_s:.0f} s; it was: {text}")
            for name, (_, text) in judged.items()
            if name not in _OF_STATION
        }
    return [Check(name, *answer) for name, answer in judged.items()]


def _heard(s: Snapshot) -> _Judged:
    return (
        (False, "not heard yet")
        if math.isinf(s.silent_s)
        else (s.connected, f"last heard {s.silent_s:.1f} s ago")
    )


def _link(s: Snapshot) -> _Judged:
    if math.isnan(s.link_loss):
        return None, "not measured yet"
    text = f"{100 * s.link_loss:.0f} % of packets lost, {s.link_rate_Hz:.0f} messages/s"
    return s.link_loss <= LOSS_MOST and s.link_rate_Hz > 0, text


def _commander(s: Snapshot, number: int | None) -> _Judged:
    if number is None:
        return None, "the vehicle does not tell who commands it"
    if s.in_command:
        return True, "this station commands it"
    return not number, f"{s.commander} commands it" if number else "nobody commands it yet"


def _health(health: tuple[int, int, int] | None, texts: StatusTexts) -> _Judged:
    if health is None:
        return None, "not told"
    present, enabled, good = health
    if present & _PREARM:
        last = next((m.text for m in reversed(texts.messages) if m.level != "info"), "see its messages")
        return (True, "ready to be armed") if good & _PREARM else (False, f"not ready: {last}")
    bad = (present & enabled & ~good).bit_count()
    return not bad, f"{bad} sensors are not healthy" if bad else "sensors healthy"


def _estimator(told: EstimatorStatus) -> _Judged:
    if told.wrong:
        return False, ", ".join(told.wrong)
    if told.unknown:
        return None, "no " + ", ".join(told.unknown)
    good = ", ".join(
        f"{1e2 * m:.0f} cm {way}" for m, way in ((told.level_m, "level"), (told.height_m, "up")) if m > 0.0
    )
    return True, "all is known" + (f", position to {good} (one sigma)" if good else "")


def _battery(s: Snapshot) -> _Judged:
    volts = s.estimate.battery_voltage
    voltage = "" if math.isnan(volts) else f"{volts:.2f} V"
    if math.isnan(s.battery_charge):
        return None, voltage or "not told"
    text = f"{100 * s.battery_charge:.0f} %" + (f", {voltage}" if voltage else "")
    return s.battery_charge >= CHARGE_LEAST, text


def _level(s: Snapshot) -> _Judged:
    if s.flying:
        return None, "in flight"
    e = s.estimate
    tilt, speed = math.hypot(*e.attitude[:2].tolist()), float((e.velocity**2).sum() ** 0.5)
    if math.isnan(tilt):
        return None, "attitude is not told"
    moving = "" if math.isnan(speed) else f", {speed:.2f} m/s"
    return tilt <= TILT_MOST_RAD and not speed > STILL_M_S, f"tilt {math.degrees(tilt):.1f} deg{moving}"


def _position(s: Snapshot) -> _Judged:
    if np.isnan(s.estimate.position).any():
        return False, "not known"
    n, e, d = s.estimate.position.tolist()
    return True, f"N {n:.2f}, E {e:.2f}, height {-d:.2f} m"


def _mission(held: tuple[Item, ...] | None, shown: tuple[Item, ...] | None) -> _Judged:
    if held is None:
        return None, "what the vehicle holds is not known"
    if shown is not None and not same_mission(held, shown):
        return False, "the vehicle holds another mission than the one shown; send it"
    return True, f"{len(held)} items in the vehicle" if held else "none"


def _endurance(
    s: Snapshot, told: Telemetry, items: Sequence[Item], parameters: RemoteParameters, base: Mission | None
) -> _Judged:
    own = items[1:] if told.autopilot == ARDUPILOT else items  # its first is its home
    plan = planned_flight(own, s, parameters.table, origin=told.origin, base=base)
    if plan is None:
        return None, "no mission"
    words = f"mission about {clock(plan.needed_s)}" + (f" ({plan.assumed})" if plan.assumed else "")
    if math.isnan(s.battery_left_s):
        return None, f"{words}; the battery's time is not told"
    words += f", battery {clock(s.battery_left_s)}"
    if plan.needed_s <= (1.0 - RESERVE) * s.battery_left_s:
        return True, words
    return False, f"{words}: {RESERVE:.0%} has to be left; charge it, or fly a shorter mission"


def _parameters(parameters: RemoteParameters) -> _Judged:
    missing, known = parameters.missing, len(parameters.table)
    if not known:
        return None, "not read yet"
    return (None, f"{missing} of {missing + known} not read yet") if missing else (True, f"{known} read")


def _recording(on: bool | None) -> _Judged:
    if on is None:
        return None, "there is no recorder"
    return on, "on" if on else "off; nothing of this flight is kept"


def _disk(free_bytes: float) -> _Judged:
    if math.isnan(free_bytes):
        return None, "free room is not known"
    return free_bytes >= DISK_LEAST_BYTES, f"{free_bytes / 1e9:.1f} GB free"
