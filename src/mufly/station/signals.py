"""Which signals a station keeps of a vehicle: the columns of its history and of its recordings.

They are those of a flight's recording (:mod:`mufly.logs.layout`) with what else a vehicle tells over a link: what it
believes of itself (``estimated_``), what its rotors were measured to turn at, the pilot's sticks, and how good the link
is. As plain columns they are called ``variable_label`` (``estimated_position_N``), as in :mod:`mufly.logs.flat`.
"""

from __future__ import annotations

from mufly.logs.layout import QUANTITIES, Layout, Quantity

__all__ = ["BEAMS", "PILOT_CHANNELS", "column_names", "column_units", "station_layout"]

BEAMS = 8
"""So many beams are kept; a vehicle with more is shown, but its ranges are not kept."""
PILOT_CHANNELS = 8

_AXES = {
    "position": ("axis", "m"),
    "velocity": ("axis", "m/s"),
    "attitude": ("angle", "rad"),
    "rates": ("rate", "rad/s"),
}
_ESTIMATED = tuple(
    Quantity(
        f"estimated_{field}",
        "/estimated",
        field,
        dim,
        units,
        f"{field.replace('rates', 'body rates')} as estimated on board",
    )
    for field, (dim, units) in _AXES.items()
)
_ROTORS = Quantity(
    "measured_rotor_speed", "/measured", "rotor_speed", "rotor", "rad/s", "measured rotor speed"
)
_PILOT = Quantity("pilot_input", "/pilot", "input", "channel", "us", "channel of the pilot's remote control")
_LINK = (
    Quantity("link_loss", "/link", "loss", None, "1", "share of packets lost of late, 0 to 1"),
    Quantity("link_rate", "/link", "rate", None, "Hz", "messages a second"),
)


def station_layout() -> Layout:
    """Return the table of what a station keeps of one vehicle."""
    of_flight = {
        topic: [q for q in QUANTITIES if q.topic == topic]
        for topic in dict.fromkeys(q.topic for q in QUANTITIES)
    }
    of_flight["/measured"].append(_ROTORS)
    kept = [q for topic in ("/truth", "/measured") for q in of_flight.pop(topic)]
    kept += _ESTIMATED
    kept += [q for quantities in of_flight.values() for q in quantities]
    labels = (("channel", tuple(range(1, PILOT_CHANNELS + 1))),)
    return Layout((*kept, _PILOT, *_LINK), BEAMS, labels)


def column_names(layout: Layout) -> tuple[str, ...]:
    """Names of the columns behind the time, ``("truth_position_N", ...)``."""
    names: list[str] = []
    for quantity in layout.quantities:
        labels = layout.labels(quantity)
        names += [f"{quantity.name}_{label}" for label in labels] if quantity.dim else [quantity.name]
    return tuple(names)


def column_units(layout: Layout) -> tuple[str, ...]:
    """Units of the same columns."""
    return tuple(q.units for q in layout.quantities for _ in (layout.labels(q) if q.dim else (None,)))
