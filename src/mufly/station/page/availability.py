"""Which commands make sense now, and why the others do not: shown on the buttons themselves."""

from __future__ import annotations

from mufly.station.view import Snapshot

__all__ = ["COMMANDS", "availability", "mission_label"]

COMMANDS = ("arm", "disarm", "take_off", "pause", "mission", "go_to", "land", "return", "stop")
_UNDER_WAY = frozenset({"waypoint", "obstacle"})


def availability(
    s: Snapshot | None, *, kind: str, has_controls: bool, rows: int, unready: str = ""
) -> dict[str, str]:
    """Return for every command why it cannot be given now, "" if it can.

    Parameters
    ----------
    s : Snapshot or None
        None: there is no vehicle.
    kind : str
        "mufly", "other" or "recording".
    has_controls : bool
        Whether this window holds the controls.
    rows : int
        Length of the vehicle's mission.
    unready : str
        Why it cannot be armed, "" if it can.
    """

    def all_of(reason: str, stop: str | None = None) -> dict[str, str]:
        return dict.fromkeys(COMMANDS, reason) | {"stop": reason if stop is None else stop}

    if kind == "recording":
        return all_of("a recording")
    if s is None:
        return all_of("no vehicle heard")
    if not s.connected:
        return all_of("no link", stop="")  # it may still hear us
    if not has_controls:
        return all_of("watching only", stop="")
    if s.commander and not s.in_command:
        return all_of("watching only", stop="")
    up = "on the floor"
    flying = s.flying
    return {
        "arm": "armed" if s.armed else unready,
        "disarm": "in flight" if flying else "" if s.armed else "not armed",
        "take_off": "in the air" if flying else "" if s.armed else unready,
        "pause": "" if flying else up,
        "mission": "no mission loaded" if not rows else _mission(s, unready),
        "go_to": "" if flying else up,
        "land": "" if flying else "on the floor",
        "return": "" if flying else "on the floor",
        "stop": "",
    }


def _mission(s: Snapshot, unready: str) -> str:
    if s.flying:
        return "Hover interrupts it" if s.state in _UNDER_WAY else "landing" if s.state == "landing" else ""
    return "" if s.armed else unready


def mission_label(s: Snapshot | None, begun: bool) -> str:
    """Return what the mission button says; ``begun``: a waypoint of the mission was reached."""
    if s is not None and s.flying and s.state in _UNDER_WAY:
        return "Under way"
    return "Resume mission" if s is not None and s.flying and begun else "Fly the mission"
