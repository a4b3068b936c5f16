"""Bridges: PX4, ArduPilot and Betaflight fly the simulated vehicle; live views for Foxglove and ROS 2.

The plant, its wind, its sensors with their faults, its battery and the recording are those of
:class:`mufly.flight.Flight` (:mod:`mufly.bridges.autopilot_plant`). PX4 exchanges MAVLink messages in lockstep
(:mod:`mufly.bridges.px4.px4_link`), ArduPilot packets of its JSON interface
(:mod:`mufly.bridges.ardupilot.ardupilot_link`), and Betaflight those of its software in the loop, with a pilot
(:mod:`mufly.bridges.betaflight.betaflight_link`). Gains, margins and parameter files for all come from the linear model
of the vehicle file (:mod:`mufly.bridges.autopilot_gains`). Attributes of the package load on first use, so that gains
are designed without the flight software.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mufly.bridges.ardupilot.ardupilot_link import ArduPilotSimulator
    from mufly.bridges.ardupilot.ardupilot_parameters import format_parameter_file, list_ardupilot_parameters
    from mufly.bridges.autopilot_gains import AutopilotGains, AxisMargins, CascadeGains, design_autopilot_gains
    from mufly.bridges.autopilot_plant import AutopilotPlant
    from mufly.bridges.betaflight.betaflight_cli import run_betaflight, send_cli_file
    from mufly.bridges.betaflight.betaflight_link import BetaflightSimulator
    from mufly.bridges.betaflight.betaflight_pilot import BetaflightPilot, PilotPlan
    from mufly.bridges.betaflight.betaflight_settings import design_betaflight_gains, format_cli_file
    from mufly.bridges.px4.px4_airframe import format_airframe_file, list_px4_parameters
    from mufly.bridges.px4.px4_link import Px4Simulator

_NAMES_BY_MODULE = {
    "mufly.bridges.ardupilot.ardupilot_link": ("ArduPilotSimulator",),
    "mufly.bridges.ardupilot.ardupilot_parameters": ("format_parameter_file", "list_ardupilot_parameters"),
    "mufly.bridges.autopilot_gains": ("AutopilotGains", "AxisMargins", "CascadeGains", "design_autopilot_gains"),
    "mufly.bridges.autopilot_plant": ("AutopilotPlant",),
    "mufly.bridges.betaflight.betaflight_cli": ("send_cli_file", "run_betaflight"),
    "mufly.bridges.betaflight.betaflight_link": ("BetaflightSimulator",),
    "mufly.bridges.betaflight.betaflight_pilot": ("BetaflightPilot", "PilotPlan"),
    "mufly.bridges.betaflight.betaflight_settings": ("design_betaflight_gains", "format_cli_file"),
    "mufly.bridges.px4.px4_airframe": ("format_airframe_file", "list_px4_parameters"),
    "mufly.bridges.px4.px4_link": ("Px4Simulator",),
}
__all__ = [
    "ArduPilotSimulator",
    "AutopilotGains",
    "AutopilotPlant",
    "AxisMargins",
    "BetaflightPilot",
    "BetaflightSimulator",
    "CascadeGains",
    "PilotPlan",
    "Px4Simulator",
    "design_autopilot_gains",
    "design_betaflight_gains",
    "format_airframe_file",
    "format_cli_file",
    "format_parameter_file",
    "list_ardupilot_parameters",
    "list_px4_parameters",
    "run_betaflight",
    "send_cli_file",
]


def __getattr__(name: str) -> Any:
    for home, names in _NAMES_BY_MODULE.items():
        if name in names:
            return getattr(importlib.import_module(home), name)
    raise AttributeError(f"module 'mufly.bridges' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
