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
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray
from scipy.signal import detrend, welch

from mufly.flight.trust import sensor_name
from mufly.quantities import CHECKED, STATUSES, our_name
from mufly.slam import Sight
from mufly.station.history import History, Message, Snapshot
from mufly.station.page.session import Source, View, shape_of
from mufly.station.replay import ReplayHistory
from mufly.units import factor_of

IN_FLIGHT = 2
MOST_POINTS = 6000
MOST_SIGNALS = 64
MOST_SECONDS = 36_000.0
SLOW_S = 0.25  # tables are looked at this often
SPECTRUM_S = 0.5
TRAIL_S = 600.0
ALIVE_S = 2.0
MOST_TRAIL = 3000
MOST_TEXT = 1000
"""So many characters of a message are shown; the recording has all."""
BLADES = 2
LEAST_SAMPLES = 64
_SECTIONS = frozenset(
    {"scene", "messages", "mission", "checks", "sensors", "parameters", "catalog", "camera"}
)
_OF_STATE = (
    *("time_s", "connected", "silent_s", "armed", "flying", "in_command", "commander", "state"),
    *(
        "reference_position",
        "reference_velocity",
        "reference_attitude",
        "rotor_speed",
        "range_angles",
        "range_max_m",
    ),
    *("battery_current", "battery_charge", "battery_left_s", "link_loss", "link_rate_Hz"),
    *("real_time_factor", "slips"),
)
_OF_ESTIMATE = ("position", "velocity", "attitude", "rates", "ranges", "battery_voltage")
_OF_ACTUATORS = ("motor_input", "servo_input")
_Array = NDArray[np.float64]


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
            found = content.get(key)
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
    told = {"waypoint": s.mission_row}
    for part, names in ((s, _OF_STATE), (s.estimate, _OF_ESTIMATE), (s.actuators, _OF_ACTUATORS)):
        told |= {name: getattr(part, name) for name in names}
    return {name: v.astype(np.float32) if isinstance(v, np.ndarray) else v for name, v in told.items()}


def encode_sight(sight: Sight) -> dict[str, Any]:
    """Return a picture with its features, and what SLAM says of it and of itself."""
    answer, counts = sight.answer, sight.counts
    out: dict[str, Any] = {
        "t": sight.time_s, "jpeg": b64encode(sight.jpeg).decode(), "said": sight.said, "stands": sight.stands,
        "taken": counts.taken, "lost": counts.lost, "answered": counts.answered, "trusted": counts.trusted,
        "keyframes": len(sight.sketch.keyframes), "closures": int(sight.sketch.ties[:, 2].sum()),
    }  # fmt: skip
    if answer is not None:
        out |= {
            "features": sight.features.round(1), "trusted_now": answer.trusted, "reason": answer.reason,
            "position": answer.position, "heading": answer.heading, "covariance": answer.covariance,
            "tracked": answer.tracked, "agreed": answer.agreed, "keyframe": answer.keyframe,
            "latency_s": sight.latency_s, "work_s": sight.work_s,
        }  # fmt: skip
    return out


class Feed:
    """The stream of frames to one window."""

    def __init__(self, view: View) -> None:
        self._view = view
        self.want = Want()
        self.sent = self.drawn = view.frames.newest
        self._epoch = ""
        self._begin()

    def _begin(self) -> None:
        """Forget what was sent: another source is shown, or a slider jumped."""
        self._filled: tuple[Any, ...] = ()
        self._last_s = -math.inf
        self._said: Message | None = None
        self._tables: dict[str, Any] = {}
        self._alive: set[str] = set()
        self._sight: Sight | None = None
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
        self.sent = self._view.frames.next_number()
        out: dict[str, Any] = {"n": self.sent, "wall": time.time() * 1e3, "about": self._view.about()}
        source, epoch = self._view.source(), self._view.epoch()
        if epoch != self._epoch:
            self._epoch, out["new"] = epoch, True
            self._begin()
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
        if "camera" in self.want.sections and (sight := self._view.sight()) is not self._sight:
            self._sight = sight
            if sight is not None:
                out["camera"] = encode_sight(sight)
        if "scene" in self.want.sections:
            out["others"] = [
                _other(self._view.session.label(v), v.color, shape_of(v), v.snapshot)
                for v in self._view.others()
            ]
        return orjson.dumps(out, option=orjson.OPT_SERIALIZE_NUMPY)

    def _samples(self, source: Source) -> dict[str, Any]:
        names = list(self.want.signals)
        asked = (*names, self.want.window_s)
        fill = asked != self._filled
        self._filled = asked
        if fill:
            times, values = source.history.window(self.want.window_s, names)
            self._last_s = -math.inf
        else:
            times, values = source.history.since(self._last_s, names)
        if len(times):
            self._last_s = float(times[-1])
        step = max(1, math.ceil(len(times) / MOST_POINTS))
        # From the end, so that the newest sample is always among them.
        times, values = times[::-1][::step][::-1], values[::-1][::step][::-1]
        out: dict[str, Any] = {
            "t": np.round(times.astype(np.float64), 4),
            "v": np.ascontiguousarray(values.T, dtype=np.float32),
        }
        return out | {"names": names} if fill else out

    def _messages(self, source: Source, out: dict[str, Any]) -> None:
        known = source.messages
        fresh: list[Message] = []
        if "messages" not in self._tables:
            self._tables["messages"] = out["messages_new"] = True
            self._said = None
        for message in reversed(known):
            if message is self._said:
                break
            fresh.append(message)
        if fresh:
            self._said = fresh[0]
            out["messages"] = [(m.time_s, m.level, m.text[:MOST_TEXT]) for m in reversed(fresh)]

    def _slowly(self, source: Source, out: dict[str, Any]) -> None:
        """Add the tables that have changed since they were sent."""
        sections = self.want.sections
        for gone in [k for k in self._tables if k not in sections]:
            del self._tables[gone]  # it is hidden; when shown again it needs all of it

        def changed(key: str, now: Callable[[], Any]) -> Any:
            """What a table holds, if it is shown and has changed; else None."""
            value = now() if key in sections else None
            if value is None or self._tables.get(key) == value:
                return None
            self._tables[key] = value
            return value

        if (scenery := changed("scene", self._view.scenery)) is not None:
            out["scenery"] = scenery
            out["trail"] = _trail(source)
            compared = self._view.comparison()
            out["compared_trail"] = [] if compared is None else _thinned(compared.track())
        if (rows := changed("mission", lambda: list(source.mission))) is not None:
            out["mission"] = [
                {"action": r.action, "p": r.position, "heading": r.heading_rad, "wait": r.wait_s,
                 "reached": r.reached, "text": r.text} for r in rows
            ]  # fmt: skip
        if (checks := changed("checks", lambda: list(source.checks))) is not None:
            out["checks"] = [(c.name, c.ok, c.text) for c in checks]
        if (sensors := changed("sensors", lambda: sensors_of(source.history, source.messages))) is not None:
            out["sensors"] = sensors
        if (names := changed("catalog", lambda: self._known_names(source))) is not None:
            out["catalog"] = catalog(names, source.history.unit)
        if changed("camera", self._sketch) is not None and (sight := self._view.sight()) is not None:
            out["floor_map"] = {
                "keyframes": sight.sketch.keyframes, "ties": sight.sketch.ties, "path": sight.path,
            }  # fmt: skip
        sent = self._tables.get("parameters")
        base = self._view.baseline() if "parameters" in sections else {}
        known = changed(
            "parameters", lambda: {n: (p, base.get(n, p.value)) for n, p in source.parameters.items()}
        )
        if known is not None:
            out["parameters_new"] = sent is None or not sent.keys() <= known.keys()
            out["parameters"] = [
                (p.name, p.value, p.unit, p.least, p.greatest, p.help, p.whole, was)
                for n, (p, was) in known.items()
                if sent is None or sent.get(n) != (p, was)
            ]

    def _sketch(self) -> float | None:
        """Changes when the map of the floor is to be drawn anew."""
        sight = self._view.sight()
        return None if sight is None else sight.time_s

    def _known_names(self, source: Source) -> list[str]:
        """Signals that have had a value since the source is shown; a real vehicle has no truth to offer."""
        names = list(source.history.names)
        _, values = source.history.window(ALIVE_S, names)
        alive = np.asarray(np.isfinite(values).any(axis=0)).tolist()
        self._alive |= {n for n, yes in zip(names, alive, strict=True) if yes}
        return [n for n in names if n in self._alive]

    def _spectrum(self, source: Source, snapshot: Snapshot) -> dict[str, Any]:
        name, history = self.want.spectrum, source.history
        times, values = history.window(self.want.spectrum_s, [name])
        found = (
            spectrum(times.astype(np.float64), values[:, 0].astype(np.float64))
            if name in history.names
            else None
        )
        if found is None:
            return {"signal": name, "rate": None}
        rate, frequency, density = found
        return {
            "signal": name, "unit": history.unit(name), "rate": rate, "f": frequency.astype(np.float32),
            "d": density.astype(np.float32), "marks": marks(snapshot.rotor_speed, rate),
        }  # fmt: skip


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


def _thinned(track: _Array) -> Any:
    step = max(1, math.ceil(len(track) / MOST_TRAIL))
    return np.ascontiguousarray(track[::step], dtype=np.float32)


def _other(name: str, color: int, shape: str, s: Snapshot) -> dict[str, Any]:
    place = {"p": s.estimate.position, "a": s.estimate.attitude, "w": s.rotor_speed}
    told = {"name": name, "color": color, "shape": shape, "armed": s.armed}
    return told | {k: v.astype(np.float32) for k, v in place.items()}


# Which signals belong together in one axis: a quantity, its components, and who says so. A flat name is
# ``source_quantity_component`` (``measured_attitude_roll``) or, for what only one side knows, ``quantity_component``
# (``motor_input_upper``). A plot shows one quantity: the colour tells the component, the kind of line tells the source.

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
_UPWARD = {("position", "D"): "height", ("velocity", "D"): "climb"}
"""Components that people read upward, as everywhere else on the page: their sign is turned."""


def display_unit(unit: str, quantity: str) -> tuple[str, float]:
    """Return the unit that a person reads, and what to multiply an SI value by."""
    if unit == "rad":
        return "°", factor_of("rad", "deg")
    if unit == "rad/s":
        if "rotor_speed" in quantity:
            return "rpm", factor_of(unit, "rpm")
        return "°/s", factor_of(unit, "deg/s")
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


def sensors_of(
    history: History | ReplayHistory, messages: Sequence[Message] = ()
) -> list[tuple[str, str, float, str]]:
    """Return what the estimator thinks of each sensor now: name, a status in words, innovation (sigmas), and why.

    The reason is what the vehicle said last of a sensor that it does not believe; "" of one that it does.
    """
    names = [f"{kind}_{name}" for name in CHECKED for kind in ("status", "innovation")]
    if not set(names) <= set(history.names):
        return []  # a recording of a flight on what is true
    _, values = history.window(ALIVE_S, names)
    if not len(values):
        return []
    now = values[-1].tolist()
    told = zip(CHECKED, now[0::2], now[1::2], strict=True)
    return [
        (name.replace("_", " "), STATUSES[int(status)], round(ratio, 1),
         _reason(name, messages) if STATUSES[int(status)] in _DOUBTED else "")
        for name, status, ratio in told
        if 0.0 <= status < len(STATUSES)
    ]  # fmt: skip


_DOUBTED = ("rejected", "missing", "faulty")
_LOOKED_AT = 200  # messages


def _reason(reading: str, messages: Sequence[Message]) -> str:
    """What the vehicle said last of a sensor, behind the colon (:func:`mufly.flight.trust.told`)."""
    name = f"{sensor_name(reading)} "
    late = islice(reversed(messages), _LOOKED_AT)
    last = next((m.text for m in late if m.text.startswith(name)), "")
    return last.partition(": ")[2]


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
        ``key``, ``title``, ``unit`` and ``factor`` of display, ``components`` (list of str), ``upward`` (those of
        them whose sign is turned), ``sources`` (list of str), ``signals`` (``{"source/component": flat name}``) and
        ``bands`` (the same of their standard deviations), best known first.
    """
    found: dict[str, dict[str, Any]] = {}
    names = list(names)
    parts = {_split(name): name for name in names}
    for name in names:
        source, quantity, component = _split(name)
        sigma = parts.get((source, f"{quantity}_sigma", component))
        if quantity not in found:
            shown, factor = display_unit(unit(name), quantity)
            title = _TITLES.get(quantity, quantity.replace("_", " ").capitalize())
            found[quantity] = {
                "key": quantity, "title": title, "unit": shown, "factor": factor,
                "components": [], "upward": [], "sources": [], "signals": {}, "bands": {},
            }  # fmt: skip
        entry = found[quantity]
        if (upward := _UPWARD.get((quantity, component))) is not None:
            component = upward
            if upward not in entry["upward"]:
                entry["upward"].append(upward)
        if component not in entry["components"]:
            entry["components"].append(component)
        if source not in entry["sources"]:
            entry["sources"].append(source)
        entry["signals"][f"{source}/{component}"] = name
        if sigma is not None:
            entry["bands"][f"{source}/{component}"] = sigma
    for entry in found.values():
        entry["sources"].sort(key=lambda s: SOURCES.index(s) if s in SOURCES else -1)
    rank = {key: k for k, key in enumerate(_ORDER)}
    return sorted(found.values(), key=lambda e: (rank.get(e["key"], len(rank)), e["key"]))


# The spectrum of a signal, with marks where the rotors would show.


def folded(frequency_hz: float, rate_hz: float) -> float:
    """Where a frequency (Hz) shows in a signal sampled at ``rate_hz``."""
    return abs(frequency_hz - round(frequency_hz / rate_hz) * rate_hz)


def spectrum(times: _Array, values: _Array) -> tuple[float, _Array, _Array] | None:
    """Return sampling rate (Hz), frequencies (m,) and densities (m,; unit^2/Hz) of samples (n,) at times (n,; s).

    Power spectral density by Welch's method (Hann window, halves overlapping), one-sided, so that its integral over
    frequency is the variance. Gaps are bridged by straight lines, onto an even clock at the median step. None if there
    is too little to say.
    """
    good = np.isfinite(values)
    times, values = times[good], values[good]
    if len(times) < LEAST_SAMPLES:
        return None
    step = float(np.median(np.diff(times)))
    if not step > 0.0:
        return None
    clock = np.arange(times[0], times[-1], step)
    if len(clock) < LEAST_SAMPLES:
        return None
    even = np.interp(clock, times, values)
    length = min(len(even), 1024)
    frequency, density = welch(even, 1.0 / step, "hann", length, length // 2, detrend=detrend)
    return 1.0 / step, frequency[1:], density[1:]


def marks(rotor_speed: _Array, rate_hz: float) -> list[dict[str, Any]]:
    """Return where rotors (upper, lower; rad/s) show: ``name``, ``hz`` (true), ``at`` (in the picture), ``folded``.

    A rotor of speed Omega shakes the fuselage at its rate of turn f = Omega / 2 pi and, with b blades, at b f. The link
    samples at f_s; what lies above f_s / 2 shows, folded, at |f - round(f / f_s) f_s|, and is marked there.
    """
    out = []
    for name, speed in zip(("upper", "lower"), rotor_speed.tolist(), strict=True):
        if not (math.isfinite(speed) and speed > 1.0):
            continue
        for label, times in ((name, 1), (f"{name} ×{BLADES}", BLADES)):
            true = times * speed / (2.0 * math.pi)
            at = folded(true, rate_hz)
            out.append({"name": label, "hz": true, "at": at, "folded": true > 0.5 * rate_hz})
    return out
