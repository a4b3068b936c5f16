"""What was done to a vehicle's parameters here: changes, undo, redo, and files of them.

Files are those that other ground stations write too: one parameter a line, ``system component NAME value type`` with
tabs (QGroundControl), or ``NAME,value`` (Mission Planner); both are read, the first is written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from mufly.errors import InputError
from mufly.station.view import Parameter

__all__ = ["ParameterSheet", "parameter_file", "read_parameter_file", "refused"]

MAV_PARAM_TYPE_INT32, MAV_PARAM_TYPE_REAL32 = 6, 9
MOST_STEPS = 200


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter, before and after."""

    name: str
    before: float
    after: float


@dataclass
class ParameterSheet:
    """The changes made to one vehicle's parameters.

    Attributes
    ----------
    baseline : dict of str to float
        Values as they were first heard.
    """

    baseline: dict[str, float] = field(default_factory=dict)
    _undo: list[Change] = field(default_factory=list)
    _redo: list[Change] = field(default_factory=list)

    def observe(self, parameters: Mapping[str, Parameter]) -> None:
        """Remember the first value of parameters not seen before."""
        if len(parameters) != len(self.baseline):
            for name, parameter in parameters.items():
                self.baseline.setdefault(name, parameter.value)

    def wrote(self, name: str, before: float, after: float) -> None:
        """Note a change that was made; what had been undone can no longer be redone."""
        self._undo = [*self._undo, Change(name, before, after)][-MOST_STEPS:]
        self._redo.clear()

    @property
    def can_undo(self) -> str:
        """Name of the parameter that undo would change, "" if none."""
        return self._undo[-1].name if self._undo else ""

    @property
    def can_redo(self) -> str:
        """Name of the parameter that redo would change, "" if none."""
        return self._redo[-1].name if self._redo else ""

    def undo(self) -> tuple[str, float] | None:
        """Take the last change back: the name and value to write, None if there is none."""
        if not self._undo:
            return None
        change = self._undo.pop()
        self._redo.append(change)
        return change.name, change.before

    def redo(self) -> tuple[str, float] | None:
        """Make the last undone change again."""
        if not self._redo:
            return None
        change = self._redo.pop()
        self._undo.append(change)
        return change.name, change.after


def refused(parameter: Parameter | None, name: str, value: float) -> str:
    """Return why a value cannot be written, "" if it can."""
    if parameter is None:
        return f"{name} is no parameter of this vehicle"
    if not math.isfinite(value):
        return f"{name}: {value} is no number"
    if not parameter.least <= value <= parameter.greatest:
        return f"{name}: {value:g} is outside {parameter.least:g} to {parameter.greatest:g} {parameter.unit}".rstrip()
    if parameter.whole and value != round(value):
        return f"{name}: {value:g} is not whole"
    return ""


def parameter_file(parameters: Mapping[str, Parameter], system: int) -> str:
    """Return parameters as the text of a file."""
    lines = ["# Vehicle-Id Component-Id Name Value Type, as QGroundControl and mufly write them"]
    for name in sorted(parameters):
        p = parameters[name]
        kind, value = (
            (MAV_PARAM_TYPE_INT32, str(round(p.value)))
            if p.whole
            else (MAV_PARAM_TYPE_REAL32, f"{p.value:.9g}")
        )
        lines.append(f"{system}\t1\t{name}\t{value}\t{kind}")
    return "\n".join(lines) + "\n"


def read_parameter_file(text: str, where: str) -> dict[str, float]:
    """Read a file of parameters.

    Raises
    ------
    InputError
        Naming the line that is no parameter.
    """
    out: dict[str, float] = {}
    for k, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if not line or line.startswith(("#", "//")):
            continue
        parts = line.replace(",", " ").replace("=", " ").split()
        name, value = (
            (parts[2], parts[3]) if len(parts) == 5 else (parts[0], parts[1] if len(parts) == 2 else "")
        )
        try:
            out[name] = float(value)
        except ValueError:
            remedy = "write NAME,value or the lines that QGroundControl writes"
            raise InputError(where, f"line {k}", f"{line[:60]!r} is no parameter", remedy) from None
    if not out:
        raise InputError(where, "", "holds no parameters", "choose another file")
    return out
