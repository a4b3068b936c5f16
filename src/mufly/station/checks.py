"""What to look at before a flight, as far as a vehicle and its station can tell.

Any MAVLink vehicle can answer most of it; what it does not tell cannot be judged (``ok`` is None), which is not a
fault.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from mufly.link.mission_transfer import Item
from mufly.station.missions import rows_of
from mufly.station.view import Check, MissionRow, Snapshot

if TYPE_CHECKING:
    from mufly.station.remote import RemoteVehicle

LOSS_MOST = 0.1
CHARGE_LEAST = 0.3
TILT_MOST_RAD = math.radians(5.0)
STILL_M_S = 0.1
RESERVE = 0.2
"""Share of the battery that a mission must leave."""
DISK_LEAST_BYTES = 200e6
_SPEED_M_S, _CLIMB_M_S = 0.5, 0.4
_PREARM = 268435456  # MAV_SYS_STATUS_PREARM_CHECK


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
    """

    recording: bool | None = None
    free_bytes: float = math.nan
    shown: tuple[Item, ...] | None = None


def judge(vehicle: RemoteVehicle, around: Surroundings) -> list[Check]:
    """Return the checks of a vehicle."""
    s = vehicle.snapshot
    return [
        _heard(s),
        _link(s),
        _commander(vehicle, s),
        _health(vehicle),
        _battery(s),
        _level(s),
        _position(s),
        _mission(vehicle, around),
        _endurance(vehicle, s),
        _parameters(vehicle),
        _recording(around),
        _disk(around),
    ]


def flight_time(rows: list[MissionRow], speed_m_s: float = _SPEED_M_S) -> float:
    """Return about how long a mission takes (s): level ways at a speed, climbs at 0.4 m/s, and the waits."""
    speed, total = speed_m_s, 0.0
    flown = []
    for row in rows:
        if row.action == "speed":
            speed = next((float(w) for w in row.text.split() if _is_number(w)), speed_m_s)
        elif all(map(math.isfinite, row.position)):
            flown.append((row, speed if speed > 0 else speed_m_s))
    for (before, _), (row, pace) in pairwise(flown):
        total += math.dist(before.position[:2], row.position[:2]) / pace
        total += abs(before.position[2] - row.position[2]) / _CLIMB_M_S + row.wait_s
    if flown:
        total += abs(flown[0][0].position[2]) / _CLIMB_M_S + flown[0][0].wait_s
    return total


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _heard(s: Snapshot) -> Check:
    if math.isinf(s.silent_s):
        return Check("heard", False, "not heard yet")
    return Check("heard", s.connected, f"last heard {s.silent_s:.1f} s ago")


def _link(s: Snapshot) -> Check:
    if math.isnan(s.link_loss):
        return Check("link", None, "not measured yet")
    text = f"{100 * s.link_loss:.0f} % of packets lost, {s.link_rate_Hz:.0f} messages/s"
    return Check("link", s.link_loss <= LOSS_MOST and s.link_rate_Hz > 0, text)


def _commander(vehicle: RemoteVehicle, s: Snapshot) -> Check:
    if vehicle.telemetry.commander is None:
        return Check("command", None, "the vehicle does not tell who commands it")
    if s.in_command:
        return Check("command", True, "this station commands it")
    free = not vehicle.telemetry.commander
    return Check("command", free, "nobody commands it yet" if free else f"{s.commander} commands it")


def _health(vehicle: RemoteVehicle) -> Check:
    health = vehicle.telemetry.health
    if health is None:
        return Check("vehicle's own checks", None, "not told")
    present, enabled, good = health
    if present & _PREARM:
        ready = bool(good & _PREARM)
        last = next((m.text for m in reversed(vehicle.messages) if m.level != "info"), "see its messages")
        return Check("vehicle's own checks", ready, "ready to be armed" if ready else f"not ready: {last}")
    bad = (present & enabled & ~good).bit_count()
    return Check(
        "vehicle's own checks", not bad, "sensors healthy" if not bad else f"{bad} sensors are not healthy"
    )


def _battery(s: Snapshot) -> Check:
    if math.isnan(s.battery_charge) and math.isnan(s.battery_voltage):
        return Check("battery", None, "not told")
    voltage = "" if math.isnan(s.battery_voltage) else f"{s.battery_voltage:.2f} V"
    if math.isnan(s.battery_charge):
        return Check("battery", None, voltage)
    text = f"{100 * s.battery_charge:.0f} %" + (f", {voltage}" if voltage else "")
    return Check("battery", s.battery_charge >= CHARGE_LEAST, text)


def _level(s: Snapshot) -> Check:
    if s.flying:
        return Check("level and still", None, "in flight")
    tilt = math.hypot(*s.attitude[:2].tolist())
    speed = float((s.velocity**2).sum() ** 0.5)
    if math.isnan(tilt):
        return Check("level and still", None, "attitude is not told")
    still = math.isnan(speed) or speed <= STILL_M_S
    text = f"tilt {math.degrees(tilt):.1f} deg" + ("" if math.isnan(speed) else f", {speed:.2f} m/s")
    return Check("level and still", tilt <= TILT_MOST_RAD and still, text)


def _position(s: Snapshot) -> Check:
    known = bool((s.position == s.position).all())
    if not known:
        return Check("position", False, "not known")
    n, e, d = s.position.tolist()
    return Check("position", True, f"N {n:.2f}, E {e:.2f}, D {d:.2f} m")


def _mission(vehicle: RemoteVehicle, around: Surroundings) -> Check:
    held = vehicle.transfers.items
    if held is None:
        return Check("mission", None, "what the vehicle holds is not known")
    if around.shown is not None and not same_mission(held, around.shown):
        return Check("mission", False, "the vehicle holds another mission than the one shown; send it")
    return Check("mission", True, f"{len(held)} items in the vehicle" if held else "none")


def _endurance(vehicle: RemoteVehicle, s: Snapshot) -> Check:
    rows = rows_of(vehicle.transfers.items or (), vehicle.telemetry.origin)
    speed = vehicle.parameters.get("LIM_SPEED")
    needed = flight_time(rows, speed.value if speed is not None and speed.value > 0 else _SPEED_M_S)
    if not needed:
        return Check("time to fly", None, "no mission")
    if math.isnan(s.battery_left_s):
        return Check("time to fly", None, f"mission about {needed:.0f} s; the battery's time is not told")
    enough = needed <= (1.0 - RESERVE) * s.battery_left_s
    return Check("time to fly", enough, f"mission about {needed:.0f} s, battery {s.battery_left_s:.0f} s")


def _parameters(vehicle: RemoteVehicle) -> Check:
    missing, known = vehicle.parameters_missing, len(vehicle.parameters)
    if missing or not known:
        return Check(
            "parameters", None, f"{missing} of {missing + known} not read yet" if known else "not read yet"
        )
    return Check("parameters", True, f"{known} read")


def _recording(around: Surroundings) -> Check:
    if around.recording is None:
        return Check("recording", None, "there is no recorder")
    return Check(
        "recording", around.recording, "on" if around.recording else "off; nothing of this flight is kept"
    )


def _disk(around: Surroundings) -> Check:
    if math.isnan(around.free_bytes):
        return Check("disk", None, "free room is not known")
    text = f"{around.free_bytes / 1e9:.1f} GB free"
    return Check("disk", around.free_bytes >= DISK_LEAST_BYTES, text)


def same_mission(a: tuple[Item, ...], b: tuple[Item, ...]) -> bool:
    """Whether two missions would be flown alike; which item is current does not matter, NaN equals NaN."""
    return len(a) == len(b) and all(_key(x) == _key(y) for x, y in zip(a, b, strict=True))


def _key(item: Item) -> tuple[object, ...]:
    params = tuple(None if math.isnan(p) else round(p, 4) for p in item.params)
    z = None if math.isnan(item.z) else round(item.z, 4)
    return item.frame, item.command, params, item.x, item.y, z
