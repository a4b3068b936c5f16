"""Which signals belong together in one axis: a quantity, its components, and who says so.

A flat name is ``source_quantity_component`` (``measured_attitude_roll``) or, for what only one side knows,
``quantity_component`` (``motor_input_upper``). A plot shows one quantity: the colour tells the component, the kind of
line tells the source. Angles and rates are shown in degrees, rotor speeds in rpm: this is the edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from mufly.logs.flat import our_name

__all__ = ["SOURCES", "catalog", "display_unit"]

SOURCES = ("estimated", "measured", "reference", "truth")
_TITLES = {
    "position": "Position",
    "velocity": "Velocity",
    "attitude": "Attitude",
    "rates": "Body rates",
    "rotor_speed": "Rotor speed",
    "acceleration": "Specific force",
    "motor_input": "Motor input",
    "servo_input": "Servo input",
    "battery_voltage": "Battery voltage",
    "battery_current": "Battery current",
    "battery_charge": "Battery charge",
    "range": "Range",
    "wind": "Wind",
}
_ORDER = tuple(_TITLES)


def display_unit(unit: str, quantity: str) -> tuple[str, float]:
    """Return the unit that a person reads, and what to multiply an SI value by."""
    if unit == "rad":
        return "°", 180.0 / math.pi
    if unit == "rad/s":
        return ("rpm", 30.0 / math.pi) if "rotor_speed" in quantity else ("°/s", 180.0 / math.pi)
    if quantity == "battery_charge" and unit == "1":
        return "%", 100.0
    return ("" if unit == "1" else unit), 1.0


def _split(name: str) -> tuple[str, str, str]:
    """Return source, quantity and component of a flat name; the source is "" for what only one side knows."""
    known = our_name(name)
    variable, component = known if known is not None else (name, None)
    source, _, quantity = variable.partition("_")
    if source in SOURCES and quantity:
        return source, quantity, component or ""
    return "", variable, component or ""


def catalog(names: Iterable[str], unit: Callable[[str], str]) -> list[dict[str, Any]]:
    """Return the quantities that can be plotted, as the page wants them.

    Parameters
    ----------
    names : iterable of str
        Flat names of all signals.
    unit : callable
        SI unit of a signal.

    Returns
    -------
    list of dict
        ``key``, ``title``, ``unit`` and ``factor`` of display, ``components`` (list of str), ``sources`` (list of
        str) and ``signals`` (``{"source/component": flat name}``), best known first.
    """
    found: dict[str, dict[str, Any]] = {}
    for name in names:
        source, quantity, component = _split(name)
        if quantity not in found:
            shown, factor = display_unit(unit(name), quantity)
            title = _TITLES.get(quantity, quantity.replace("_", " ").capitalize())
            found[quantity] = {
                "key": quantity, "title": title, "unit": shown, "factor": factor,
                "components": [], "sources": [], "signals": {},
            }  # fmt: skip
        entry = found[quantity]
        if component not in entry["components"]:
            entry["components"].append(component)
        if source not in entry["sources"]:
            entry["sources"].append(source)
        entry["signals"][f"{source}/{component}"] = name
    for entry in found.values():
        entry["sources"].sort(key=lambda s: SOURCES.index(s) if s in SOURCES else -1)
    rank = {key: k for k, key in enumerate(_ORDER)}
    return sorted(found.values(), key=lambda e: (rank.get(e["key"], len(rank)), e["key"]))
