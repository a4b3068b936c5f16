"""Classification of flights by their true ending.

A vehicle has *landed* if it is upright and at rest with its motors off, after a soft touchdown. A safe landing has the
right reason if the flight software reports a failure that names no sensor, or at least one wrong sensor. The errors
of a wrong sensor differ from the vehicle file by a fault or by a variation that the filter does not know.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Literal, get_args

import numpy as np
import xarray as xr

from mufly.flight.record.flight_summary import FlightSummary
from mufly.flight.simulated_plant import COLLISION_CAUSE_TEXT, TIP_OVER_CAUSE_TEXT
from mufly.mission import HARD_TOUCHDOWN_M_S
from mufly.quantities.sensor_table import READINGS, SENSORS
from mufly.sensors import FAULT_TARGETS, parse_fault

LANDED_HEIGHT_TOLERANCE_M, LANDED_MAX_SPEED_M_S, LANDED_MAX_TILT_DEG = 0.02, 0.05, 10.0
"""Largest height above the floor (m), speed (m/s) and tilt (deg) of a landed helicopter."""

FlightEnding = Literal["succeeded", "landed", "landed, wrong reason", "not started", "tipped over", "hit", "lost"]
ENDINGS: tuple[FlightEnding, ...] = get_args(FlightEnding)
"""Classes, the best first: mission flown; safe landing with the right or another reason; no take-off; tip-over;
collision with an obstacle or a hard touchdown; anything else, such as a flight without an end."""


def final_tilt_deg(data: xr.Dataset) -> float:
    """Return the tilt of the mast at the last instant of a recording (deg)."""
    roll, pitch = data.truth_attitude.values[-1, :2]
    return math.degrees(math.acos(math.cos(roll) * math.cos(pitch)))


def final_speed_m_s(data: xr.Dataset) -> float:
    """Return the speed at the last instant of a recording (m/s)."""
    return float(np.linalg.norm(data.truth_velocity.values[-1]))


def classify_ending(
    data: xr.Dataset, s: FlightSummary, success: bool, mismodelled_sensors: Collection[str] = ()
) -> FlightEnding:
    """Return how a flight ended, as one of :data:`ENDINGS`.

    Parameters
    ----------
    data : xarray.Dataset
        Recording of the flight.
    s : FlightSummary
        Summary of the recording.
    success : bool
        Whether the truth confirms a success.
    mismodelled_sensors : collection of str
        Sensors that the reason may blame, from :func:`mismodelled_sensors`.
    """
    if success:
        return "succeeded"
    tilt = final_tilt_deg(data)
    if s.reason.startswith(f"{TIP_OVER_CAUSE_TEXT}:") or tilt > LANDED_MAX_TILT_DEG:
        return "tipped over"
    if s.reason.startswith(COLLISION_CAUSE_TEXT):
        return "hit"
    x = data.truth_position.values
    at_rest = final_speed_m_s(data) <= LANDED_MAX_SPEED_M_S and not np.any(data.motor_input.values[-1] > 0.0)
    if not at_rest:
        return "lost"
    if not np.any(x[0, 2] - x[:, 2] > LANDED_HEIGHT_TOLERANCE_M):
        return "not started"
    if (s.touchdown_speed_m_s or 0.0) > HARD_TOUCHDOWN_M_S:
        return "hit"
    accused = {row.source for row in READINGS.values() if row.source and row.source in s.reason}
    is_wrong = s.outcome == "succeeded" or s.reason.startswith(TIP_OVER_CAUSE_TEXT)
    right = not is_wrong and (not accused or not accused.isdisjoint(mismodelled_sensors))
    return "landed" if right else "landed, wrong reason"


def mismodelled_sensors(
    faults: Iterable[str], values: Mapping[str, float], filed: Mapping[str, float]
) -> frozenset[str]:
    """Return the sensors whose errors differ from the vehicle file, by their names in messages.

    Parameters
    ----------
    faults : iterable of str
        Faults in the syntax of :func:`mufly.sensors.parse_fault`.
    values, filed : mapping
        Drawn parameters of the true vehicle, and parameters of the file, by key.
    """
    found = {READINGS[FAULT_TARGETS[parse_fault(text).name].reading].source for text in faults}
    for key, value in values.items():
        first, _, rest = key.partition(".")
        table, _, name = rest.partition(".")
        if first != "sensors" or value == filed.get(key):
            continue
        rows = [row for row in SENSORS[table] if row.source]
        own = [row for row in rows if row.fault and name.startswith(f"{row.fault}_")]
        found |= {row.source for row in own or rows}
    return frozenset(found)
