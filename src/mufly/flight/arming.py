"""Checks before arming and before the start of a mission; each failure is a sentence with its remedy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mufly.errors import InputError
from mufly.estimate import Estimate
from mufly.flight.estimator_health import describe_sensor_status, list_sensor_statuses
from mufly.mission import Mission, check_mission_clearance, check_mission_endurance, describe_start_fault
from mufly.world import World, compute_obstacle_distances, find_nearest_obstacle

BATTERY_MARGIN_V = 0.2
"""Margin above the landing voltage (V): a cell's voltage recovers at rest and drops again within seconds of hover."""

MAX_ARMING_SPEED_M_S, MAX_ARMING_RATE_RAD_S = 0.1, 0.2
MAX_ESTIMATE_AGE_S = 0.5
MAX_STANDING_HEIGHT_ERROR_M = 0.05
"""Largest error of the estimated height above the floor on the floor (m); the scatter there is below 0.01 m."""


def find_arming_faults(
    m: Estimate | None,
    stale_s: float,
    low_V: float,
    world: World,
    radius_m: float,
    crashed: str,
    *,
    standing_m: float | None = None,
) -> list[str]:
    """Return the reasons against arming the vehicle; empty if arming is allowed.

    Parameters
    ----------
    m : Estimate or None
        Latest estimate.
    stale_s : float
        Time since the estimate's clock last advanced (s).
    low_V : float
        Battery voltage at which the vehicle lands (V).
    world : World
        Known obstacles.
    radius_m : float
        Rotor radius (m).
    crashed : str
        Cause of a crash, or "".
    standing_m : float, optional
        Height of the centre of gravity of the standing vehicle above the floor (m); unchecked by default.
    """
    if crashed:
        return [f"crashed ({crashed}); reset the vehicle first"]
    if m is None:
        return ["no estimate yet; wait a moment"]
    why = []
    missing = [n for n in ("position", "velocity", "attitude", "rates") if not np.isfinite(getattr(m, n)).all()]
    if missing:
        why.append(f"{' and '.join(missing)} not measured; check the sensors")
    if stale_s > MAX_ESTIMATE_AGE_S:
        why.append(f"measurements are {stale_s:.1f} s old; check the link to the sensors")
    volts = m.battery_voltage
    if not volts > 0.0 or not math.isfinite(volts):
        why.append("battery voltage not measured; check the battery monitor")
    elif volts < low_V + BATTERY_MARGIN_V:
        needed = low_V + BATTERY_MARGIN_V
        why.append(
            f"battery low: {volts:.2f} V at rest; flights end at {low_V:.2f} V; charge the battery to {needed:.2f} V"
        )
    if not m.valid and not missing:
        wrong = [
            describe_sensor_status(c) for c in list_sensor_statuses(m) if c.status in ("missing", "faulty", "rejected")
        ]
        because = f" ({'; '.join(wrong)})" if wrong else ""
        why.append(f"estimate is not valid{because}; leave the vehicle at rest")
    if missing:
        return why
    tilted = describe_start_fault(replace(m, valid=True))
    if tilted:
        why.append(f"{tilted}; set the vehicle on level ground, or check the accelerometers")
    if m.auxiliary_states is not None and standing_m is not None:
        height = -float(m.position[2]) - m.auxiliary_states.floor_height
        if abs(height - standing_m) > MAX_STANDING_HEIGHT_ERROR_M:
            why.append(
                f"the estimate is {height:.2f} m above the floor, where the standing vehicle is {standing_m:.2f} m "
                "above it; check the sonar and its place, or set the vehicle on the floor"
            )
    if np.linalg.norm(m.velocity) > MAX_ARMING_SPEED_M_S or np.abs(m.rates).max() > MAX_ARMING_RATE_RAD_S:
        why.append("the vehicle is moving; set it down and leave it at rest")
    near = describe_obstacle_too_near(
        world, (float(m.position[0]), float(m.position[1]), float(m.position[2])), radius_m
    )
    if near:
        why.append(f"the vehicle stands {near}")
    return why


def describe_obstacle_too_near(world: World, position: tuple[float, float, float], keep_m: float) -> str:
    """Return why a position is refused: closer than ``keep_m`` (m) to a known obstacle; "" for a free position."""
    if world.is_empty:
        return ""
    away, name = find_nearest_obstacle(world, position)
    if away >= keep_m:
        return ""
    where = f"{away:.2f} m from the {name}" if away >= 0.0 else f"in or beyond the {name}"
    return f"{where}; keep {keep_m:.2f} m from it"


def describe_blocked_climb(world: World, position: tuple[float, float, float], up_to_m: float, keep_m: float) -> str:
    """Return why a vertical climb to the height ``up_to_m`` (m) is refused; "" if the climb is free.

    A climb is free if it passes no known obstacle within ``keep_m`` (m).
    """
    if world.is_empty:
        return ""
    count = max(2, math.ceil((up_to_m + position[2]) / 0.05) + 1)
    column = np.tile(np.array(position), (count, 1))
    column[:, 2] = np.linspace(position[2], -up_to_m, count)
    away, which = compute_obstacle_distances(world, column)
    k = int(np.argmin(away))
    if away[k] >= keep_m:
        return ""
    near, name = max(float(away[k]), 0.0), world.obstacle_names[which[k]]
    return (
        f"at a height of {-column[k, 2]:.2f} m the vehicle would be {near:.2f} m from the {name}; keep {keep_m:.2f} m"
    )


def describe_refused_start(
    mission: Mission,
    standing: tuple[float, float],
    heading: float,
    *,
    hover_current_A: float,
    capacity_Ah: float,
    charge: float,
) -> str:
    """Return why a mission must not start here; "" if the mission may start or has no waypoints.

    Parameters
    ----------
    mission : Mission
        Mission with the limits of the flight (:func:`mufly.mission.reduce_mission_limits`).
    standing : (2,) tuple
        Position of the vehicle, N, E (m).
    heading : float
        Heading of the vehicle (rad).
    hover_current_A, capacity_Ah : float
        Battery current in hover (A) and capacity (Ah).
    charge : float
        Present charge, as a fraction of the capacity.
    """
    if not mission.waypoint:
        return ""
    heading_deg = math.degrees(math.remainder(heading, math.tau))
    try:
        here = mission.replace_parts(start_m=standing, start_heading_deg=heading_deg)
        name = mission.name or "mission"
        check_mission_clearance(here, name)
        check_mission_endurance(
            here, hover_current_A=hover_current_A, capacity_Ah=capacity_Ah, charge=charge, where=name
        )
    except InputError as error:
        return str(error)
    return ""
