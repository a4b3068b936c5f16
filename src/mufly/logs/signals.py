"""Names of signals: what they measure, their labels and units, and how they look as one column of a table.

The names are those of our own recordings (:mod:`mufly.logs.layout`), a few more that other vehicles log, and whatever a
user likes to call the rest. ``signal`` names a whole variable, ``signal.label`` one component of it
(``measured_attitude.roll``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from mufly.errors import InputError
from mufly.logs.layout import LABELS, QUANTITIES

__all__ = ["Signal", "is_held", "signal_named", "split_name"]

_PREFIXES = ("truth", "measured", "estimated", "reference")
_KINDS: Mapping[str, tuple[str | None, str, str]] = {
    "position": ("axis", "m", "position"),
    "velocity": ("axis", "m/s", "velocity"),
    "attitude": ("angle", "rad", "attitude"),
    "rates": ("rate", "rad/s", "body rates"),
    "rotor_speed": ("rotor", "rad/s", "rotor speed"),
    "acceleration": ("body", "m/s^2", "specific force along the body axes"),
}
_OTHERS: Mapping[str, tuple[str | None, str, str]] = {
    "actuator_control": ("control", "1", "control to the mixer, -1 to 1"),
    "actuator_output": ("channel", "us", "output to the actuators, pulse length"),
    "pilot_input": ("channel", "us", "channel of the pilot's remote control, pulse length"),
}


class Signal(NamedTuple):
    """A variable: its labelled dimension (None for a scalar), labels (empty: any number), units, meaning."""

    name: str
    dim: str | None
    labels: tuple[str, ...] | tuple[int, ...]
    units: str
    long_name: str


def signal_named(name: str) -> Signal | None:
    """Return what is known of a variable by its name, None for a name of the user's own."""
    for quantity in QUANTITIES:
        if quantity.name == name:
            labels = () if quantity.dim in (None, "beam") else LABELS[str(quantity.dim)]
            return Signal(name, quantity.dim, labels, quantity.units, quantity.long_name)
    prefix, _, rest = name.partition("_")
    if prefix in _PREFIXES and rest in _KINDS:
        dim, units, meaning = _KINDS[rest]
        word = {"truth": "true", "reference": "reference"}.get(prefix, prefix)
        return Signal(name, dim, LABELS[dim] if dim else (), units, f"{word} {meaning}")
    if name in _OTHERS:
        dim, units, meaning = _OTHERS[name]
        return Signal(name, dim, LABELS.get(dim or "", ()), units, meaning)
    return None


def split_name(text: str, where: str) -> tuple[Signal | None, str, str | None]:
    """Split ``"measured_attitude.roll"`` into signal, variable and label.

    Returns
    -------
    signal : Signal or None
        What is known of the variable.
    variable : str
    label : str or None
        None for the whole variable.

    Raises
    ------
    InputError
        If a known variable has no such label.
    """
    variable, _, label = text.partition(".")
    signal = signal_named(variable)
    if signal is not None and label and signal.labels and label not in map(str, signal.labels):
        wanted = ", ".join(f"{variable}.{k}" for k in signal.labels)
        raise InputError(where, text, "is no component of this signal", f"use one of: {wanted}")
    if signal is not None and label and signal.dim is None:
        raise InputError(where, text, "is a scalar", f"write {variable}")
    if signal is None and not variable.isidentifier():
        raise InputError(where, text, "is no name for a signal", "use letters, digits and underscores")
    if label and signal is None:
        raise InputError(where, text, "is not a signal with components", f"write {variable}_{label}")
    return signal, variable, label or None


def is_held(name: str) -> bool:
    """Whether a signal is commanded: it jumps and stands still as it likes, and no outlier or drop-out can be told."""
    return name.startswith(("reference_", "motor_input", "servo_input", "actuator_", "pilot_input"))
