"""mufly: coaxial micro helicopters, from blade geometry to autonomous flight.

The subpackages are ordered by the steps of a design; see ``docs/explanation/architecture.md``. They load on first use,
so that ``import mufly`` is fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mufly.errors import InputError, MuflyError
from mufly.version import __version__

if TYPE_CHECKING:
    from mufly import (
        bench,
        bridges,
        camera,
        cfd,
        cli,
        compiled,
        control,
        drive,
        dynamics,
        estimate,
        files,
        firmware,
        flight,
        fmi,
        gym,
        identify,
        link,
        logs,
        mission,
        quantities,
        results,
        rotor,
        sensors,
        slam,
        station,
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
    "bench",
    "bridges",
    "camera",
    "cfd",
    "cli",
    "compiled",
    "control",
    "drive",
    "dynamics",
    "estimate",
    "files",
    "firmware",
    "flight",
    "fmi",
    "gym",
    "identify",
    "link",
    "load_vehicle",
    "logs",
    "mission",
    "quantities",
    "results",
    "rotor",
    "sensors",
    "slam",
    "station",
    "study",
    "thesis",
    "vehicle",
    "world",
]


def __getattr__(name: str) -> Any:
    if name == "load_vehicle":
        return importlib.import_module("mufly.vehicle").load_vehicle
    if name in __all__:
        return importlib.import_module(f"mufly.{name}")
    raise AttributeError(f"module 'mufly' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
