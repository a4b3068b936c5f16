"""What a recording holds: one table of quantities, from which everything else derives.

A flight is a row of float64 values every sampling instant: column 0 is the time (s), the others are the
quantities in the order of the table. The table says the unit of each, its labelled dimension, and in which
topic of the file it travels. The writer, the schemas inside the file, the reader, the CSV header and
``docs/recordings.md`` follow it; a file carries its own copy, so that it stays readable when the table grows.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import groupby
from typing import NamedTuple

import orjson

__all__ = ["LABELS", "QUANTITIES", "Event", "Layout", "Quantity", "standard_layout"]


@dataclass(frozen=True)
class Quantity:
    """One quantity of a recording.

    Attributes
    ----------
    name : str
        Variable of the dataset (``truth_position``).
    topic, field : str
        Where it travels in the file (``/truth``, ``position``).
    dim : str or None
        Its labelled dimension besides time (see :data:`LABELS`), None for a scalar.
    units, long_name : str
        Written to the variable's attributes, the schema and the CSV header; ``"1"`` is a pure number.
    """

    name: str
    topic: str
    field: str
    dim: str | None
    units: str
    long_name: str


LABELS: dict[str, tuple[str, ...] | tuple[int, ...]] = {
    "axis": ("N", "E", "D"),
    "angle": ("roll", "pitch", "yaw"),
    "rate": ("p", "q", "r"),
    "rotor": ("upper", "lower"),
    "servo": (1, 2),
    "body": ("x", "y", "z"),
    "control": ("roll", "pitch", "yaw", "thrust"),
}
"""Labels of every dimension but ``beam`` and ``channel``, which count from 0 and from 1."""

_cg = "of the centre of gravity"
QUANTITIES: tuple[Quantity, ...] = (
    Quantity("truth_position", "/truth", "position", "axis", "m", f"true position {_cg}"),
    Quantity("truth_velocity", "/truth", "velocity", "axis", "m/s", f"true velocity {_cg}"),
    Quantity("truth_attitude", "/truth", "attitude", "angle", "rad", "true attitude"),
    Quantity("truth_rates", "/truth", "rates", "rate", "rad/s", "true body rates"),
    Quantity("truth_rotor_speed", "/truth", "rotor_speed", "rotor", "rad/s", "true rotor speed"),
    Quantity("wind", "/truth", "wind", "axis", "m/s", "velocity of the air"),
    Quantity("measured_position", "/measured", "position", "axis", "m", f"measured position {_cg}"),
    Quantity("measured_velocity", "/measured", "velocity", "axis", "m/s", f"measured velocity {_cg}"),
    Quantity("measured_attitude", "/measured", "attitude", "angle", "rad", "measured attitude"),
    Quantity("measured_rates", "/measured", "rates", "rate", "rad/s", "measured body rates"),
    Quantity("reference_position", "/reference", "position", "axis", "m", "reference position"),
    Quantity("reference_velocity", "/reference", "velocity", "axis", "m/s", "reference velocity"),
    Quantity("reference_attitude", "/reference", "attitude", "angle", "rad", "commanded attitude"),
    Quantity("motor_input", "/actuators", "motor_input", "rotor", "1", "motor input, 0 to 1"),
    Quantity("servo_input", "/actuators", "servo_input", "servo", "1", "servo input, -1 to 1"),
    Quantity("battery_voltage", "/battery", "voltage", None, "V", "battery terminal voltage"),
    Quantity("battery_current", "/battery", "current", None, "A", "battery current"),
    Quantity("battery_charge", "/battery", "charge", None, "1", "battery charge left, 0 to 1"),
    Quantity("range", "/ranges", "range", "beam", "m", "distance to the nearest obstacle along a beam"),
)
"""The table: what a recording holds, in the order of its columns (column 0 is the time)."""


class Event(NamedTuple):
    """Something that happened: time (s), mission state entered or held, text, level (info, warning, error)."""

    time_s: float
    state: str
    text: str
    level: str = "info"


@dataclass(frozen=True)
class Layout:
    """Which column of a row holds what.

    Attributes
    ----------
    quantities : tuple of Quantity
        In the order of the columns; those of one topic stand together.
    beams : int
        Number of range beams.
    other_labels : tuple of (dim, labels)
        Labels of dimensions that :data:`LABELS` does not have, in recordings made from other people's logs.
    """

    quantities: tuple[Quantity, ...]
    beams: int
    other_labels: tuple[tuple[str, tuple[str, ...] | tuple[int, ...]], ...] = ()

    def __post_init__(self) -> None:
        if list(self.topics) != [topic for topic, _ in groupby(q.topic for q in self.quantities)]:
            raise ValueError("the quantities of a topic must stand together")

    def labels(self, quantity: Quantity) -> tuple[str, ...] | tuple[int, ...]:
        """Labels along the quantity's dimension; empty for a scalar."""
        if quantity.dim is None:
            return ()
        if quantity.dim == "beam":
            return tuple(range(self.beams))
        return dict(self.other_labels).get(quantity.dim) or LABELS[quantity.dim]

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Columns of each variable in a row, ``{"truth_position": slice(1, 4), ...}``; time is column 0."""
        found: dict[str, slice] = {}
        first = 1
        for quantity in self.quantities:
            width = len(self.labels(quantity)) if quantity.dim else 1
            found[quantity.name] = slice(first, first + width)
            first += width
        return found

    @cached_property
    def width(self) -> int:
        """Number of columns of a row, the time included."""
        return max((part.stop for part in self.columns.values()), default=1)

    @cached_property
    def topics(self) -> dict[str, tuple[Quantity, ...]]:
        """The quantities of each topic, in order."""
        names = dict.fromkeys(quantity.topic for quantity in self.quantities)
        return {name: tuple(q for q in self.quantities if q.topic == name) for name in names}

    def to_json(self) -> str:
        """Text form, kept inside every recording."""
        content: dict[str, object] = {"beams": self.beams, "quantities": [asdict(q) for q in self.quantities]}
        if self.other_labels:
            content["labels"] = dict(self.other_labels)
        return orjson.dumps(content).decode()

    @classmethod
    def from_json(cls, text: str) -> Layout:
        """Inverse of :meth:`to_json`."""
        content = orjson.loads(text)
        others = tuple((dim, tuple(labels)) for dim, labels in content.get("labels", {}).items())
        return cls(tuple(Quantity(**q) for q in content["quantities"]), int(content["beams"]), others)


def standard_layout(beams: int = 8) -> Layout:
    """Layout of the rows of a flight with ``beams`` range beams (see :data:`QUANTITIES`)."""
    return Layout(QUANTITIES, beams)
