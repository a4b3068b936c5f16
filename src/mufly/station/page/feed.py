"""What one window of the page is told, and how much of it.

The window asks for what it shows (:class:`Want`); a frame holds the present, the samples since the last frame of the
signals asked for, and each table only when it has changed. Nothing is kept for a window that does not keep up: a
frame is made when the window has said that it drew the one before the last (:meth:`Feed.ready`), out of whatever is
then present. A stalled or hidden window thus costs nothing, and gets the gap filled from the history when it comes
back.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
import orjson

from mufly.station.page.catalog import catalog
from mufly.station.page.source import Source
from mufly.station.page.spectrum import marks, spectrum
from mufly.station.view import Message, Snapshot

__all__ = ["Feed", "Viewer", "Want", "encode_snapshot"]

IN_FLIGHT = 2
MOST_POINTS = 6000
MOST_SIGNALS = 64
MOST_SECONDS = 36_000.0
SLOW_S = 0.25  # tables are looked at this often
SPECTRUM_S = 0.5
TRAIL_S = 600.0
ALIVE_S = 2.0
MOST_TRAIL = 3000
_SECTIONS = frozenset({"scene", "messages", "mission", "checks", "parameters", "catalog"})
_FIELDS = tuple(f.name for f in fields(Snapshot))


class Viewer(Protocol):
    """What a feed needs to know of the window that it serves."""

    def source(self) -> Source | None:
        """The vehicle or recording that is shown; None while there is none."""

    def epoch(self) -> str:
        """Changes when another source is shown or a slider jumps."""

    def others(self) -> Sequence[tuple[Source, int]]:
        """Further vehicles in the scene, with their colours."""

    def scenery(self) -> dict[str, Any]:
        """World, rotor radius, and whatever else the scene draws once."""

    def about(self) -> dict[str, Any]:
        """Small facts of every frame: replay, recorder, controls."""

    def baseline(self) -> Mapping[str, float]:
        """Values of parameters before anybody changed them here."""


@dataclass(frozen=True, slots=True)
class Want:
    """What a window shows: tables, signals, the length of its plots (s), and the signal of its spectrum."""

    sections: frozenset[str] = frozenset()
    signals: tuple[str, ...] = ()
    window_s: float = 30.0
    spectrum: str = ""
    spectrum_s: float = 10.0

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Want:
        """Read what a browser sent; what makes no sense is left out."""

        def texts(key: str) -> list[str]:
            found = content.get(key, [])
            return (
                [t for t in found if isinstance(t, str) and len(t) < 200] if isinstance(found, list) else []
            )

        def seconds(key: str, otherwise: float) -> float:
            value = content.get(key)
            good = isinstance(value, int | float) and math.isfinite(value) and value > 0
            return min(float(value), MOST_SECONDS) if good and value is not None else otherwise

        chosen = content.get("spectrum", "")
        return cls(
            frozenset(texts("sections")) & _SECTIONS,
            tuple(dict.fromkeys(texts("signals")))[:MOST_SIGNALS],
            seconds("window_s", 30.0),
            chosen if isinstance(chosen, str) else "",
            seconds("spectrum_s", 10.0),
        )


def encode_snapshot(s: Snapshot) -> dict[str, Any]:
    """Return a snapshot with arrays in single precision: seven digits are more than a page can show."""
    out: dict[str, Any] = {}
    for name in _FIELDS:
        value = getattr(s, name)
        out[name] = value.astype(np.float32) if isinstance(value, np.ndarray) else value
    return out


class Feed:
    """The stream of frames to one window."""

    def __init__(self, viewer: Viewer) -> None:
        self.viewer = viewer
        self.want = Want()
        self.sent = self.drawn = 0
        self._epoch = ""
        self._filled: tuple[Any, ...] = ()
        self._last_s = -math.inf
        self._said: Message | None = None
        self._tables: dict[str, Any] = {}
        self._alive: set[str] = set()
        self._slow_at = self._spectrum_at = -math.inf

    @property
    def ready(self) -> bool:
        """Whether the window can take a frame."""
        return self.sent - self.drawn < IN_FLIGHT

    def hear(self, text: str | bytes) -> None:
        """Take what the window says: ``{"drawn": n}``, ``{"want": {...}}``. Anything else is not understood."""
        try:
            content = orjson.loads(text)
        except orjson.JSONDecodeError:
            return
        if not isinstance(content, dict):
            return
        if isinstance(content.get("want"), dict):
            self.want = Want.of(content["want"])
            self._slow_at = self._spectrum_at = -math.inf
        drawn = content.get("drawn")
        if isinstance(drawn, int) and self.drawn < drawn <= self.sent:
            self.drawn = drawn

    def frame(self, now_s: float) -> bytes:
        """Return the next frame as JSON; NaN is null.

        Parameters
        ----------
        now_s : float
            Monotonic clock (s).
        """
        self.sent += 1
        out: dict[str, Any] = {"n": self.sent, "wall": time.time() * 1e3}
        source, epoch = self.viewer.source(), self.viewer.epoch()
        if epoch != self._epoch:
            self._epoch, self._filled, self._said, self._last_s = epoch, (), None, -math.inf
            self._tables.clear()
            self._alive.clear()
            self._slow_at = self._spectrum_at = -math.inf
            out["new"] = True
        out["about"] = self.viewer.about()
        if source is not None:
            snapshot = source.snapshot
            if snapshot.time_s < self._last_s - 1.0:  # the vehicle's clock began anew
                self._filled, self._last_s, out["new"] = (), -math.inf, True
            out["s"] = encode_snapshot(snapshot)
            if self.want.signals:
                out["h"] = self._samples(source)
            if "messages" in self.want.sections:
                self._messages(source, out)
            if now_s - self._slow_at >= SLOW_S:
                self._slow_at = now_s
                self._slowly(source, out)
            if self.want.spectrum and now_s - self._spectrum_at >= SPECTRUM_S:
                self._spectrum_at = now_s
                out["spectrum"] = self._spectrum(source, snapshot)
        if "scene" in self.want.sections:
            out["others"] = [_other(s, colour) for s, colour in self.viewer.others()]
        return orjson.dumps(out, option=orjson.OPT_SERIALIZE_NUMPY)

    def _samples(self, source: Source) -> dict[str, Any]:
        names = list(self.want.signals)
        asked = (*names, self.want.window_s)
        fill = asked != self._filled
        if fill:
            times, values = source.history.window(self.want.window_s, names)
            self._filled = asked
        else:
            times, values = source.history.since(self._last_s, names)
        if len(times):
            self._last_s = float(times[-1])
        elif fill:
            self._last_s = -math.inf
        step = max(1, math.ceil(len(times) / MOST_POINTS))
        # From the end, so that the newest sample is always among them.
        times, values = times[::-1][::step][::-1], values[::-1][::step][::-1]
        out: dict[str, Any] = {
            "t": np.round(times.astype(np.float64), 4),
            "v": np.ascontiguousarray(values.T, dtype=np.float32),
        }
        if fill:
            out["names"] = names
        return out

    def _messages(self, source: Source, out: dict[str, Any]) -> None:
        known = source.messages
        fresh: list[Message] = []
        for message in reversed(known):
            if message is self._said:
                break
            fresh.append(message)
        if "messages" not in self._tables:
            self._tables["messages"] = True
            out["messages_new"] = True
            fresh = list(reversed(known))
        if fresh:
            self._said = fresh[0]
            out["messages"] = [(m.time_s, m.level, m.text) for m in reversed(fresh)]

    def _slowly(self, source: Source, out: dict[str, Any]) -> None:
        """Add the tables that have changed since they were sent."""
        sections = self.want.sections
        for gone in [k for k in self._tables if k not in sections]:
            del self._tables[gone]  # it is hidden; when shown again it needs all of it

        def changed(key: str, value: Any) -> bool:
            if self._tables.get(key) == value:
                return False
            self._tables[key] = value
            return True

        if "scene" in sections and changed("scene", scenery := self.viewer.scenery()):
            out["scenery"] = scenery
            out["trail"] = _trail(source)
        if "mission" in sections and changed("mission", rows := list(source.mission)):
            out["mission"] = [
                {"action": r.action, "p": r.position, "heading": r.heading_rad, "wait": r.wait_s,
                 "reached": r.reached, "text": r.text} for r in rows
            ]  # fmt: skip
        if "checks" in sections and changed("checks", checks := list(source.checks)):
            out["checks"] = [(c.name, c.ok, c.text) for c in checks]
        if "catalog" in sections and changed("catalog", names := self._known_names(source)):
            out["catalog"] = catalog(names, source.history.unit)
        if "parameters" in sections:
            base = self.viewer.baseline()
            known = {n: (p, base.get(n, p.value)) for n, p in source.parameters.items()}
            sent = self._tables.get("parameters")
            if known != sent:
                out["parameters_new"] = sent is None or not sent.keys() <= known.keys()
                fresh = [entry for n, entry in known.items() if sent is None or sent.get(n) != entry]
                out["parameters"] = [
                    (p.name, p.value, p.unit, p.least, p.greatest, p.help, p.whole, was) for p, was in fresh
                ]
                self._tables["parameters"] = known

    def _known_names(self, source: Source) -> list[str]:
        """Signals that have had a value since the source is shown; a real vehicle has no truth to offer."""
        names = list(source.history.names)
        _, values = source.history.window(ALIVE_S, names)
        alive = np.asarray(np.isfinite(values).any(axis=0)).tolist()
        self._alive |= {n for n, yes in zip(names, alive, strict=True) if yes}
        return [n for n in names if n in self._alive]

    def _spectrum(self, source: Source, snapshot: Snapshot) -> dict[str, Any]:
        times, values = source.history.window(self.want.spectrum_s, [self.want.spectrum])
        found = None
        if self.want.spectrum in source.history.names:
            found = spectrum(times.astype(np.float64), values[:, 0].astype(np.float64))
        if found is None:
            return {"signal": self.want.spectrum, "rate": None}
        rate, frequency, density = found
        return {
            "signal": self.want.spectrum,
            "unit": source.history.unit(self.want.spectrum),
            "rate": rate,
            "f": frequency.astype(np.float32),
            "d": density.astype(np.float32),
            "marks": marks(snapshot.rotor_speed, rate),
        }


def _trail(source: Source) -> Any:
    """Where it has been, (n, 3), as far as its history goes back; nothing where that is not known."""
    names = source.history.names
    for believed in ("estimated", "measured", "truth"):
        wanted = [f"{believed}_position_{axis}" for axis in "NED"]
        if set(wanted) <= set(names):
            _, values = source.history.window(TRAIL_S, wanted)
            if np.isfinite(values).any():
                step = max(1, math.ceil(len(values) / MOST_TRAIL))
                return np.ascontiguousarray(values[::step], dtype=np.float32)
    return []


def _other(source: Source, colour: int) -> dict[str, Any]:
    s = source.snapshot
    return {
        "name": source.name, "color": colour, "p": s.position.astype(np.float32), "a": s.attitude.astype(np.float32),
        "w": s.rotor_speed.astype(np.float32),
    }  # fmt: skip
