"""Convert a mission and its vehicle to ``plan_t`` and ``flight_setup_t`` of the exported code."""

from __future__ import annotations

import json
import math
from typing import Any

from mufly.control import FlightController
from mufly.dynamics import standing_height
from mufly.errors import InputError
from mufly.flight.controllers import derive_trajectory_limits
from mufly.flight.tunable_parameters import StickRanges
from mufly.logs.tables import TABLE_TOPIC
from mufly.logs.ulog import DATASET_INFO_KEY, TEXTS_INFO_KEY, encode_ulog_file_head
from mufly.mission import Mission, MissionPlan, prepare_mission_plan, reduce_mission_limits
from mufly.mission.machine.log_messages import LogTemplate
from mufly.mission.machine.mission_state import State
from mufly.mission.machine.phases import nose_offset
from mufly.mission.trajectory import TrajectoryLimits
from mufly.quantities.quantity_table import find_quantity
from mufly.vehicle import Vehicle
from mufly.version import __version__

MAX_WAYPOINTS = 32
"""Waypoints that the exported code has room for: ``MISSION_WAYPOINTS`` of ``mission_state.h``."""
_BYTES_PER_LINE = 24
HOST_MAX_WAYPOINTS = 1000
"""Waypoints that the code built on this machine has room for."""
MAX_BEAMS = 64
LINK_LOSS_HOLD_DELAY_S, LINK_LOSS_LAND_DELAY_S = 10.0, 20.0
"""Silence of the commander until the vehicle holds, and then until it lands (s): COM_DL_LOSS_T, COM_DL_LAND_T."""
_MISSION_END_ACTIONS = ("land", "hover", "return")


def collect_plan_fields(plan: MissionPlan, max_waypoints: int = MAX_WAYPOINTS) -> dict[str, Any]:
    """Return the fields of ``plan_t`` by name, in the order of the C record; SI units and radians.

    Parameters
    ----------
    plan : MissionPlan
    max_waypoints : int
        Waypoints that the code has room for.

    Raises
    ------
    InputError
        If the mission has more than ``max_waypoints`` waypoints, or the vehicle more than MAX_BEAMS beams.
    """
    m, q = plan.mission, plan.mission.limits
    if len(m.waypoint) > max_waypoints:
        raise InputError(
            m.name,
            "waypoint",
            f"{len(m.waypoint)} are more than the {max_waypoints} that the exported code has room for",
            "fly it in parts, or raise MISSION_WAYPOINTS in mission_state.h",
        )
    count = len(plan.beam_ring.cos)
    if count > MAX_BEAMS:
        raise InputError("range_ring.count", str(count), f"is more than {MAX_BEAMS}", "leave some beams out")
    return {
        "count": len(m.waypoint),
        "waypoint": [_waypoint_fields(m, k) for k in range(len(m.waypoint))],
        "at_end": _MISSION_END_ACTIONS.index(m.at_end),
        "spline": m.path.kind == "spline",
        "start": list(m.start_m),
        "take_off_height": m.take_off.height_m,
        "take_off_wait_s": m.take_off.wait_s,
        "limits": _limit_fields(plan.trajectory_limits),
        "touchdown": q.touchdown_m_s,
        "reach": q.reach_m,
        "reach_speed": q.reach_m_s,
        "avoid": plan.avoids_obstacles,
        "scan": plan.scans_by_yawing,
        "clearance": m.avoidance.clearance_m,
        "avoid_speed": m.avoidance.speed_m_s,
        "give_up_s": m.avoidance.give_up_s,
        "nose_offset": nose_offset(plan),
        "low_voltage": plan.low_battery_V,
        "beam_ring": {
            "count": count,
            "cos": plan.beam_ring.cos.tolist(),
            "sin": plan.beam_ring.sin.tolist(),
            "max_range": float(plan.beam_ring.max_range),
            "first_angle": plan.beam_ring.first_angle,
            "spacing": plan.beam_ring.spacing,
        },
    }


def make_mission_plan(vehicle: Vehicle, controller: FlightController, mission: Mission) -> MissionPlan:
    """Return the plan of a mission with limits that the vehicle's controllers can follow."""
    return prepare_mission_plan(reduce_mission_limits(mission, derive_trajectory_limits(controller))[0], vehicle)


def render_plan_source(plan: MissionPlan, controller: FlightController) -> str:
    """Return the text of ``plan.c``: the mission and the constants of a flight."""
    lines = [
        f"/* The mission {(plan.mission.name or 'without a name').replace('*/', '* /')}, made by mufly {__version__}; "
        "do not edit. */",
        '#include "flight/flight_software.h"',
        "",
        "const plan_t mufly_plan = {",
        *render_initialiser(collect_plan_fields(plan)),
        "};",
        "",
        "const flight_setup_t mufly_setup = {",
        "    .gains = &mufly_gains,",
        "    .plan = &mufly_plan,",
        *render_initialiser(collect_setup_fields(controller)),
        "};",
        "",
    ]
    return "\n".join(lines)


def render_supervisor_source(vehicle: Vehicle) -> str:
    """Return the text of ``onboard/supervisor/supervisor_settings.c``."""
    lines = [
        f"/* Settings of the supervisor, made by mufly {__version__}; do not edit. */",
        '#include "onboard/supervisor/supervisor.h"',
        "",
        "const supervisor_settings_t mufly_supervisor = {",
        *render_initialiser(collect_supervisor_fields(vehicle)),
        "};",
        "",
    ]
    return "\n".join(lines)


def render_texts_source() -> str:
    """Return the text of ``onboard/link/texts.c``: the templates of the log messages."""
    rows = [f"    {json.dumps(message.value, ensure_ascii=True)}," for message in LogTemplate]
    return "\n".join(
        ["/* Templates of the log, made from those of Python; do not edit. */", '#include "onboard/link/text.h"', "",
         "const char *const mufly_texts[SAY_COUNT] = {", *rows, "};", ""]
    )  # fmt: skip


LOGGED_QUANTITIES = (
    "estimated_position", "estimated_velocity", "estimated_attitude", "estimated_rates", "estimated_valid",
    "measured_acceleration", "reference_position", "reference_velocity", "motor_input", "servo_input",
    "battery_voltage",
)  # fmt: skip
"""Signals of a row in the log on board, in the order of ``flight_log.c``; the mission's state follows."""


def render_log_head_source() -> str:
    """Return the text of ``onboard/log/flight_log_head.c``: the beginning of a ULog file, with names and units."""
    known = {name: find_quantity(name) for name in LOGGED_QUANTITIES}
    columns, variables = [], {}
    for name, quantity in known.items():
        assert quantity is not None, name
        labels = list(quantity.component_labels) if quantity.dim else None
        columns += [name] if labels is None else [f"{name}_{label}" for label in labels]
        attributes = {"units": quantity.units, "long_name": quantity.long_name}
        variables[name] = {"dim": quantity.dim, "labels": labels, "attrs": attributes}
    variables["mission_state"] = {"dim": None, "labels": None, "attrs": {"long_name": "state of the mission"}}
    declared = ["uint64_t timestamp", *(f"float {c}" for c in columns), "uint16_t mission_state"]
    head = encode_ulog_file_head(
        f"{TABLE_TOPIC}:{';'.join(declared)};".encode(),
        {
            "sys_name": "mufly",
            TEXTS_INFO_KEY: json.dumps({"mission_state": [str(s) for s in State]}),
            DATASET_INFO_KEY: json.dumps({"variables": variables, "events": {}, "attributes": {"source": "board"}}),
        },
    )
    rows = [f"    {', '.join(map(str, head[k : k + _BYTES_PER_LINE]))}," for k in range(0, len(head), _BYTES_PER_LINE)]
    lines = [
        f"/* Begin of a log, made by mufly {__version__}; do not edit. */", '#include "onboard/log/flight_log.h"', "",
        f"const int32_t mufly_log_head_size = {len(head)};", f"const uint8_t mufly_log_head[{len(head)}] = {{",
        *rows, "};", "",
    ]  # fmt: skip
    return "\n".join(lines)


def collect_supervisor_fields(vehicle: Vehicle) -> dict[str, Any]:
    """Return the fields of ``supervisor_settings_t`` by name: stick ranges, link timeouts, standing height."""
    most = StickRanges()
    return {
        "stick_tilt": most.tilt,
        "stick_yaw_rate": most.yaw_rate,
        "stick_climb": most.climb,
        "link_loss_s": LINK_LOSS_HOLD_DELAY_S,
        "link_land_s": LINK_LOSS_LAND_DELAY_S,
        "standing_m": standing_height(vehicle),
    }


def collect_setup_fields(controller: FlightController) -> dict[str, Any]:
    """Return the numeric fields of ``flight_setup_t`` by name."""
    return {
        "period_s": 1.0 / controller.rate_Hz,
        "mission_step_periods": controller.position_divider,
        "hover_V": (controller.motor_trim * controller.voltage_V).tolist(),
    }


def _limit_fields(q: TrajectoryLimits) -> dict[str, float]:
    return {
        name: getattr(q, name)
        for name in (
            "speed", "climb", "descent", "acceleration", "climb_acceleration", "yaw_rate", "yaw_acceleration",
        )
    }  # fmt: skip


def _waypoint_fields(m: Mission, k: int) -> dict[str, Any]:
    w = m.waypoint[k]
    return {
        "position": list(w.position_m),
        "wait_s": w.wait_s,
        "speed": m.leg_limits(k).speed,
        "has_heading": w.heading_deg is not None,
        "heading": 0.0 if w.heading_deg is None else math.radians(w.heading_deg),
    }


_FIELD_UNITS = {
    "position": "m", "start": "m", "take_off_height": "m", "reach": "m", "clearance": "m", "max_range": "m",
    "wait_s": "s", "take_off_wait_s": "s", "give_up_s": "s", "period_s": "s", "hover_V": "V", "low_voltage": "V",
    "speed": "m/s", "climb": "m/s", "descent": "m/s", "touchdown": "m/s", "reach_speed": "m/s", "avoid_speed": "m/s",
    "acceleration": "m/s2", "climb_acceleration": "m/s2", "yaw_rate": "rad/s", "yaw_acceleration": "rad/s2",
    "stick_tilt": "rad", "stick_yaw_rate": "rad/s", "stick_climb": "m/s", "link_loss_s": "s", "link_land_s": "s",
    "heading": "rad", "nose_offset": "rad", "first_angle": "rad", "spacing": "rad",
}  # fmt: skip


def render_initialiser(fields: dict[str, Any], indent: str = "    ") -> list[str]:
    """Return the lines of a C initialiser: hexadecimal floats with decimal and unit in a comment."""
    lines = []
    for name, value in fields.items():
        unit = _FIELD_UNITS.get(name, "")
        if isinstance(value, dict):
            lines += [
                f"{indent}.{name} =",
                f"{indent}    {{",
                *render_initialiser(value, indent + " " * 8),
                f"{indent}    }},",
            ]
        elif isinstance(value, bool):
            lines.append(f"{indent}.{name} = {'true' if value else 'false'},")
        elif isinstance(value, int):
            lines.append(f"{indent}.{name} = {value},")
        elif isinstance(value, float):
            lines.append(f"{indent}.{name} = {_real_literal(value)}, /* {value:.9g} {unit}".rstrip() + " */")
        elif value and isinstance(value[0], dict):
            lines += [f"{indent}.{name} =", f"{indent}    {{"]
            for one in value:
                lines += [
                    f"{indent}        {{",
                    *render_initialiser(one, indent + " " * 12),
                    f"{indent}        }},",
                ]
            lines += [f"{indent}    }},"]
        elif value:
            numbers = ", ".join(_real_literal(float(v)) for v in value)
            said = ", ".join(f"{float(v):.9g}" for v in value)
            lines.append(f"{indent}.{name} = {{{numbers}}}, /* {said} {unit}".rstrip() + " */")
    return lines


def _real_literal(value: float) -> str:
    return f"REAL({value.hex()})"
