"""Preflight checks of a vehicle from its telemetry and the state of the station.

Any MAVLink vehicle supports most checks. A check without data from the vehicle is undecided (``ok`` is None), which is
no fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mufly.link.mission_transfer import MissionItem
from mufly.mission import Mission
from mufly.station.mission_endurance import estimate_mission_duration
from mufly.station.mission_rows import is_same_mission
from mufly.station.remote.remote_commands import StatusTextLog
from mufly.station.remote.remote_transfers import RemoteMission, RemoteParameters
from mufly.station.remote.vehicle_telemetry import EstimatorStatus, VehicleTelemetry
from mufly.station.signal_history import PreflightCheck, VehicleSnapshot, format_minutes_seconds
from mufly.vehicle_types import MAV_AUTOPILOT_ARDUPILOT

MAX_LINK_LOSS_FRACTION = 0.1
MIN_BATTERY_CHARGE_FRACTION = 0.3
MAX_STANDING_TILT_RAD = math.radians(5.0)
MAX_STANDING_SPEED_M_S = 0.1
BATTERY_RESERVE_FRACTION = 0.2
"""Fraction of the battery that must remain after a mission."""
MIN_DISK_BYTES = 200e6
PREARM_CHECKS_NAME = "vehicle's pre-arm checks"
_STATION_CHECK_NAMES = ("heartbeat", "link", "recording", "free disk space")
_PREARM_CHECK_BIT = 268435456  # MAV_SYS_STATUS_PREARM_CHECK

_CheckResult = tuple[bool | None, str]


@dataclass(slots=True)
class StationContext:
    """State of the station that the preflight checks use.

    Attributes
    ----------
    is_recording : bool or None
        Whether the recorder runs; None without a recorder.
    free_disk_bytes : float
        Free space on the recorder's disk; NaN if unknown.
    shown_items : tuple of MissionItem or None
        Mission shown on the page, compared with the vehicle's.
    base_mission : Mission or None
        Mission file with which the vehicle was started, if known: supplies what items do not hold.
    """

    is_recording: bool | None = None
    free_disk_bytes: float = math.nan
    shown_items: tuple[MissionItem, ...] | None = None
    base_mission: Mission | None = None


def run_preflight_checks(
    s: VehicleSnapshot,
    told: VehicleTelemetry,
    texts: StatusTextLog,
    mission: RemoteMission,
    parameters: RemoteParameters,
    around: StationContext,
) -> list[PreflightCheck]:
    """Return the preflight checks of a vehicle."""
    judged: dict[str, _CheckResult] = {
        "heartbeat": _check_heartbeat(s),
        "link": _check_link(s),
        "operator control": _check_commander(s, told.commander_id),
        PREARM_CHECKS_NAME: _check_prearm_health(told.health, texts),
        "battery": _check_battery(s),
        "level and at rest": _check_level(s),
        "position": _check_position(s),
        **({} if told.estimator_status is None else {"estimator": _check_estimator(told.estimator_status)}),
        "mission": _check_mission(mission.items, around.shown_items),
        "endurance": _check_endurance(s, told, mission.items or (), parameters, around.base_mission),
        "parameters": _check_parameters(parameters),
        "recording": _check_recording(around.is_recording),
        "free disk space": _check_disk(around.free_disk_bytes),
    }
    if not s.connected and math.isfinite(s.silent_s):
        # The last values may be outdated.
        judged |= {
            name: (None, f"no message for {s.silent_s:.0f} s; last value: {text}")
            for name, (_, text) in judged.items()
            if name not in _STATION_CHECK_NAMES
        }
    return [PreflightCheck(name, *answer) for name, answer in judged.items()]


def _check_heartbeat(s: VehicleSnapshot) -> _CheckResult:
    return (
        (False, "no message received")
        if math.isinf(s.silent_s)
        else (s.connected, f"last message {s.silent_s:.1f} s ago")
    )


def _check_link(s: VehicleSnapshot) -> _CheckResult:
    if math.isnan(s.link_loss):
        return None, "not yet measured"
    text = f"{100 * s.link_loss:.0f} % packet loss, {s.link_rate_Hz:.0f} messages/s"
    return s.link_loss <= MAX_LINK_LOSS_FRACTION and s.link_rate_Hz > 0, text


def _check_commander(s: VehicleSnapshot, number: int | None) -> _CheckResult:
    if number is None:
        return None, "not reported by the vehicle"
    if s.in_command:
        return True, "this station has control"
    return not number, f"{s.commander} has control" if number else "no station has control"


def _check_prearm_health(health: tuple[int, int, int] | None, texts: StatusTextLog) -> _CheckResult:
    if health is None:
        return None, "not reported"
    present, enabled, good = health
    if present & _PREARM_CHECK_BIT:
        last = next((m.text for m in reversed(texts.messages) if m.level != "info"), "see the messages")
        return (True, "ready to arm") if good & _PREARM_CHECK_BIT else (False, f"not ready: {last}")
    bad = (present & enabled & ~good).bit_count()
    return not bad, f"{bad} sensors unhealthy" if bad else "sensors healthy"


def _check_estimator(told: EstimatorStatus) -> _CheckResult:
    if told.fault_texts:
        return False, ", ".join(told.fault_texts)
    if told.missing_estimates:
        return None, "no " + ", ".join(told.missing_estimates)
    good = ", ".join(
        f"{1e2 * m:.0f} cm {way}"
        for m, way in ((told.horizontal_accuracy_m, "horizontal"), (told.vertical_accuracy_m, "vertical"))
        if m > 0.0
    )
    return True, "all states estimated" + (f", position within {good} (1σ)" if good else "")


def _check_battery(s: VehicleSnapshot) -> _CheckResult:
    volts = s.estimate.battery_voltage
    voltage = "" if math.isnan(volts) else f"{volts:.2f} V"
    if math.isnan(s.battery_charge):
        return None, voltage or "not reported"
    text = f"{100 * s.battery_charge:.0f} %" + (f", {voltage}" if voltage else "")
    return s.battery_charge >= MIN_BATTERY_CHARGE_FRACTION, text


def _check_level(s: VehicleSnapshot) -> _CheckResult:
    if s.flying:
        return None, "in flight"
    e = s.estimate
    tilt, speed = math.hypot(*e.attitude[:2].tolist()), float((e.velocity**2).sum() ** 0.5)
    if math.isnan(tilt):
        return None, "attitude not reported"
    moving = "" if math.isnan(speed) else f", {speed:.2f} m/s"
    return (
        tilt <= MAX_STANDING_TILT_RAD and not speed > MAX_STANDING_SPEED_M_S,
        f"tilt {math.degrees(tilt):.1f} deg{moving}",
    )


def _check_position(s: VehicleSnapshot) -> _CheckResult:
    if np.isnan(s.estimate.position).any():
        return False, "no position estimate"
    n, e, d = s.estimate.position.tolist()
    return True, f"N {n:.2f}, E {e:.2f}, height {-d:.2f} m"


def _check_mission(held: tuple[MissionItem, ...] | None, shown: tuple[MissionItem, ...] | None) -> _CheckResult:
    if held is None:
        return None, "not yet downloaded"
    if shown is not None and not is_same_mission(held, shown):
        return False, "the vehicle's mission differs from the displayed one; upload it"
    return True, f"{len(held)} items in the vehicle" if held else "none"


def _check_endurance(
    s: VehicleSnapshot,
    told: VehicleTelemetry,
    items: Sequence[MissionItem],
    parameters: RemoteParameters,
    base: Mission | None,
) -> _CheckResult:
    own = items[1:] if told.autopilot == MAV_AUTOPILOT_ARDUPILOT else items  # ArduPilot's first item is its home
    plan = estimate_mission_duration(own, s, parameters.parameter_table, origin=told.origin, base=base)
    if plan is None:
        return None, "no mission"
    words = f"mission about {format_minutes_seconds(plan.duration_s)}" + (
        f" ({plan.assumptions})" if plan.assumptions else ""
    )
    if math.isnan(s.battery_left_s):
        return None, f"{words}; battery time not reported"
    words += f", battery {format_minutes_seconds(s.battery_left_s)}"
    if plan.duration_s <= (1.0 - BATTERY_RESERVE_FRACTION) * s.battery_left_s:
        return True, words
    return False, f"{words}: {BATTERY_RESERVE_FRACTION:.0%} reserve needed; charge the battery or shorten the mission"


def _check_parameters(parameters: RemoteParameters) -> _CheckResult:
    missing, known = parameters.missing_count, len(parameters.parameter_table)
    if not known:
        return None, "not yet downloaded"
    return (None, f"{missing} of {missing + known} missing") if missing else (True, f"{known} downloaded")


def _check_recording(on: bool | None) -> _CheckResult:
    if on is None:
        return None, "no recorder"
    return on, "on" if on else "off; this flight is not recorded"


def _check_disk(free_bytes: float) -> _CheckResult:
    if math.isnan(free_bytes):
        return None, "unknown"
    return free_bytes >= MIN_DISK_BYTES, f"{free_bytes / 1e9:.1f} GB free"
