"""mufly: coaxial micro helicopters, from blade geometry to autonomous flight.

The rooms of the package stand in the order in which an engineer works; see ``docs/architecture.md``.
They load on first use, so that ``import mufly`` is quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mufly.errors import InputError, MuflyError
from mufly.version import __version__

if TYPE_CHECKING:
    from mufly import (
        control,
        drive,
        dynamics,
        flight,
        logs,
        mission,
        rotor,
        sensors,
        study,
        thesis,
        vehicle,
        world,
    )
    from mufly.vehicle import load_vehicle

__all__ = [
    "InputError",
    "MuflyError",
    "__version__",
    "control",
    "drive",
    "dynamics",
    "flight",
    "load_vehicle",
    "logs",
    "mission",
    "rotor",
    "sensors",
    "study",
    "thesis",
    "vehicle",
    "world",
]

_ROOMS = frozenset(__all__) - {"InputError", "MuflyError", "__version__", "load_vehicle"}


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"mufly.{name}")
    if name == "load_vehicle":
        return importlib.import_module("mufly.vehicle").load_vehicle
    raise AttributeError(f"module 'mufly' has no attribute '{name}'")
