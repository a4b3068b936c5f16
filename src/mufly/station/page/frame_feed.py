"""The stream of frames to one window of the page.

The window requests what it displays (:class:`DisplayRequest`). A frame holds the present state, the new samples of the
requested signals, and each table that has changed. Frames are not queued: a frame is made of the present data once the
window has drawn the last but one (:meth:`FrameFeed.is_ready`). A stalled or hidden window therefore costs nothing; on
its return the history fills the gap.
"""

from __future__ import annotations

import math
import time
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, takewhile
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray
from scipy.signal import detrend, welch

from mufly.flight.estimator_health import find_sensor_name
from mufly.quantities.quantity_table import FUSION_STATUSES, READINGS_WITH_FUSION_STATUS, parse_column_name
from mufly.quantities.units import find_conversion_factor
from mufly.slam import TrackedPicture
from mufly.station.page.page_session import PanelSource, WindowView, scene_shape
from mufly.station.replay import ReplayHistory
from mufly.station.signal_history import SignalHistory, StatusMessage, VehicleSnapshot

MAX_FRAMES_IN_FLIGHT = 2
MAX_PLOT_POINTS = 6000
MAX_SENT_SIGNALS = 64
MAX_PLOT_WINDOW_S = 36_000.0
TABLE_UPDATE_PERIOD_S = 0.25  # tables are looked at this often
SPECTRUM_UPDATE_PERIOD_S = 0.5
TRAIL_LENGTH_S = 600.0
MAX_RECENT_VALUE_AGE_S = 2.0
MAX_TRAIL_POINTS = 3000
MAX_MESSAGE_TEXT_LENGTH = 1000
"""Number of characters shown of a message; the recording has all."""
BLADE_COUNT = 2
MIN_SPECTRUM_SAMPLES = 64
_KNOWN_SECTIONS = frozenset({"scene", "messages", "mission", "checks", "sensors", "parameters", "catalog", "camera"})
_STATE_SIGNALS = (
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
    *("real_time_factor", "timing_overrun_count"),
)
_ESTIMATE_SIGNALS = ("position", "velocity", "attitude", "rates", "ranges", "battery_voltage")
_ACTUATOR_SIGNALS = ("motor_input", "servo_input")
_Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DisplayRequest:
    """Content that a window shows: tables, signals, the length of its plots (s), and a signal's spectrum."""

    sections: frozenset[str] = frozenset()
    signals: tuple[str, ...] = ()
    window_s: float = 30.0
    spectrum_signal: str = ""
    spectrum_window_s: float = 10.0

    @classmethod
    def from_message(cls, content: Mapping[str, Any]) -> DisplayRequest:
        """Read a browser's request; invalid entries are ignored."""

        def read_texts(key: str) -> list[str]:
            found = content.get(key)
            return [t for t in found if isinstance(t, str) and len(t) < 200] if isinstance(found, list) else []

        def read_seconds(key: str, otherwise: float) -> float:
            value = content.get(key)
            good = isinstance(value, int | float) and math.isfinite(value) and value > 0
            return min(float(value), MAX_PLOT_WINDOW_S) if good and value is not None else otherwise

        chosen = content.get("spectrum", "")
        return cls(
            frozenset(read_texts("sections")) & _KNOWN_SECTIONS,
            tuple(dict.fromkeys(read_texts("signals")))[:MAX_SENT_SIGNALS],
            read_seconds("window_s", 30.0),
            chosen if isinstance(chosen, str) else "",
            read_seconds("spectrum_s", 10.0),
        )


def encode_snapshot(s: VehicleSnapshot) -> dict[str, Any]:
    """Return a snapshot with arrays in single precision."""
    told = {"waypoint": s.mission_row}
    for part, names in (
        (s, _STATE_SIGNALS),
        (s.estimate, _ESTIMATE_SIGNALS),
        (s.actuators, _ACTUATOR_SIGNALS),
    ):
        told |= {name: getattr(part, name) for name in names}
    return {name: v.astype(np.float32) if isinstance(v, np.ndarray) else v for name, v in told.items()}


def encode_slam_picture(sight: TrackedPicture) -> dict[str, Any]:
    """Return a picture with its features and the state of SLAM."""
    answer, counts = sight.result, sight.counts
    out: dict[str, Any] = {
        "t": sight.time_s,
        "jpeg": b64encode(sight.jpeg).decode(),
        "said": sight.warning,
        "stands": sight.is_standing,
        "taken": counts.taken_count,
        "lost": counts.lost_count,
        "answered": counts.processed_count,
        "trusted": counts.trusted_count,
        "keyframes": len(sight.map_view.keyframe_poses),
        "closures": int(sight.map_view.edge_indices[:, 2].sum()),
    }
    if answer is not None:
        out |= {
            "features": sight.feature_pixels.round(1), "trusted_now": answer.trusted, "reason": answer.reason,
            "position": answer.position, "heading": answer.heading, "covariance": answer.covariance,
            "tracked": answer.tracked_count, "agreed": answer.inlier_count, "keyframe": answer.keyframe_index,
            "latency_s": sight.latency_s, "work_s": sight.processing_time_s,
        }  # fmt: skip
    return out


class FrameFeed:
    """The stream of frames to one window."""

    def __init__(self, view: WindowView) -> None:
        self._view = view
        self.display_request = DisplayRequest()
        self.sent_frame = self.drawn_frame = view.frames.newest_frame_number
        self._epoch = ""
        self._forget_sent_tables()

    def _forget_sent_tables(self) -> None:
        """Forget what the window was sent, after a change of source or a jump of the slider; all is sent again."""
        self._filled: tuple[Any, ...] = ()
        self._last_s = -math.inf
        self._said: StatusMessage | None = None
        self._tables: dict[str, Any] = {}
        self._alive: set[str] = set()
        self._sight: TrackedPicture | None = None
        self._slow_at = self._spectrum_at = -math.inf

    @property
    def is_ready(self) -> bool:
        """Return whether so few frames are sent but not yet drawn that the window may receive another one."""
        return self.sent_frame - self.drawn_frame < MAX_FRAMES_IN_FLIGHT

    def handle_message(self, text: str | bytes) -> None:
        """Process a message of the window: ``{"drawn": n}``, ``{"want": {...}}``; others are ignored."""
        try:
            content = orjson.loads(text)
        except orjson.JSONDecodeError:
            return
        if not isinstance(content, dict):
            return
        if isinstance(content.get("want"), dict):
            self.display_request = DisplayRequest.from_message(content["want"])
            self._slow_at = self._spectrum_at = -math.inf
        drawn = content.get("drawn")
        if isinstance(drawn, int) and self.drawn_frame < drawn <= self.sent_frame:
            self.drawn_frame = drawn

    def make_frame(self, now_s: float) -> bytes:
        """Return the next frame as JSON; NaN is null.

        Parameters
        ----------
        now_s : float
            Monotonic clock (s).
        """
        self.sent_frame = self._view.frames.register_frame()
        out: dict[str, Any] = {
            "n": self.sent_frame,
            "wall": time.time() * 1e3,
            "about": self._view.status_fields(),
        }
        source, epoch = self._view.shown_source(), self._view.display_change_key()
        if epoch != self._epoch:
            self._epoch, out["new"] = epoch, True
            self._forget_sent_tables()
        if source is not None:
            snapshot = source.snapshot
            if snapshot.time_s < self._last_s - 1.0:  # the vehicle's clock began anew
                self._filled, self._last_s, out["new"] = (), -math.inf, True
            out["s"] = encode_snapshot(snapshot)
            if self.display_request.signals:
                out["h"] = self._encode_samples(source)
            if "messages" in self.display_request.sections:
                self._add_messages(source, out)
            if now_s - self._slow_at >= TABLE_UPDATE_PERIOD_S:
                self._slow_at = now_s
                self._add_changed_tables(source, out)
            if self.display_request.spectrum_signal and now_s - self._spectrum_at >= SPECTRUM_UPDATE_PERIOD_S:
                self._spectrum_at = now_s
                out["spectrum"] = self._encode_spectrum(source, snapshot)
        if "camera" in self.display_request.sections and (sight := self._view.shown_slam_picture()) is not self._sight:
            self._sight = sight
            if sight is not None:
                out["camera"] = encode_slam_picture(sight)
        if "scene" in self.display_request.sections:
            out["others"] = [
                _encode_other_vehicle(self._view.session.vehicle_label(v), v.color, scene_shape(v), v.snapshot)
                for v in self._view.other_vehicles()
            ]
        return orjson.dumps(out, option=orjson.OPT_SERIALIZE_NUMPY)

    def _encode_samples(self, source: PanelSource) -> dict[str, Any]:
        names = list(self.display_request.signals)
        asked = (*names, self.display_request.window_s)
        fill = asked != self._filled
        self._filled = asked
        if fill:
            times, values = source.history.recent_rows(self.display_request.window_s, names)
            self._last_s = -math.inf
        else:
            times, values = source.history.rows_since(self._last_s, names)
        if len(times):
            self._last_s = float(times[-1])
        step = max(1, math.ceil(len(times) / MAX_PLOT_POINTS))
        # From the end, so that the newest sample is always among them.
        times, values = times[::-1][::step][::-1], values[::-1][::step][::-1]
        out: dict[str, Any] = {
            "t": np.round(times.astype(np.float64), 4),
            "v": np.ascontiguousarray(values.T, dtype=np.float32),
        }
        return out | {"names": names} if fill else out

    def _add_messages(self, source: PanelSource, out: dict[str, Any]) -> None:
        if "messages" not in self._tables:
            self._tables["messages"] = out["messages_new"] = True
            self._said = None
        fresh = list(takewhile(lambda message: message is not self._said, reversed(source.status_messages)))
        if fresh:
            self._said = fresh[0]
            out["messages"] = [(m.time_s, m.level, m.text[:MAX_MESSAGE_TEXT_LENGTH]) for m in reversed(fresh)]

    def _add_changed_tables(self, source: PanelSource, out: dict[str, Any]) -> None:
        """Add the tables that have changed since last sent."""
        sections = self.display_request.sections
        for gone in [k for k in self._tables if k not in sections]:
            del self._tables[gone]  # it is hidden; when shown again it needs all of it

        def take_changed(key: str, now: Callable[[], Any]) -> Any:
            """Return a table's content if it is shown and has changed, else None."""
            value = now() if key in sections else None
            if value is None or self._tables.get(key) == value:
                return None
            self._tables[key] = value
            return value

        if (scenery := take_changed("scene", self._view.encode_scenery)) is not None:
            out["scenery"] = scenery
            out["trail"] = _find_trail(source)
            compared = self._view.shown_comparison()
            out["compared_trail"] = [] if compared is None else _thin_track(compared.second_recording_track())
        if (rows := take_changed("mission", lambda: list(source.mission_rows))) is not None:
            out["mission"] = [
                {"action": r.action, "p": r.position, "heading": r.heading_rad, "wait": r.wait_s,
                 "reached": r.reached, "text": r.text} for r in rows
            ]  # fmt: skip
        if (checks := take_changed("checks", lambda: list(source.preflight_checks))) is not None:
            out["checks"] = [(c.name, c.ok, c.text) for c in checks]
        if (
            sensors := take_changed("sensors", lambda: list_sensor_states(source.history, source.status_messages))
        ) is not None:
            out["sensors"] = sensors
        if (names := take_changed("catalog", lambda: self._find_known_signals(source))) is not None:
            out["catalog"] = build_signal_catalog(names, source.history.signal_unit)
        if (
            take_changed("camera", self._map_redraw_key) is not None
            and (sight := self._view.shown_slam_picture()) is not None
        ):
            out["floor_map"] = {
                "keyframes": sight.map_view.keyframe_poses, "ties": sight.map_view.edge_indices,
                "path": sight.path_points_m,
            }  # fmt: skip
        sent = self._tables.get("parameters")
        base = self._view.parameter_baseline() if "parameters" in sections else {}
        known = take_changed("parameters", lambda: {n: (p, base.get(n, p.value)) for n, p in source.parameters.items()})
        if known is not None:
            out["parameters_new"] = sent is None or not sent.keys() <= known.keys()
            out["parameters"] = [
                (p.name, p.value, p.unit, p.minimum, p.maximum, p.description, p.is_integer, was)
                for n, (p, was) in known.items()
                if sent is None or sent.get(n) != (p, was)
            ]

    def _map_redraw_key(self) -> float | None:
        """Return a value that changes when the floor map must be redrawn."""
        sight = self._view.shown_slam_picture()
        return None if sight is None else sight.time_s

    def _find_known_signals(self, source: PanelSource) -> list[str]:
        """Return the signals that had a value from this source; a real vehicle has no true values."""
        names = list(source.history.names)
        _, values = source.history.recent_rows(MAX_RECENT_VALUE_AGE_S, names)
        alive = np.asarray(np.isfinite(values).any(axis=0)).tolist()
        self._alive |= {n for n, yes in zip(names, alive, strict=True) if yes}
        return [n for n in names if n in self._alive]

    def _encode_spectrum(self, source: PanelSource, snapshot: VehicleSnapshot) -> dict[str, Any]:
        name, history = self.display_request.spectrum_signal, source.history
        times, values = history.recent_rows(self.display_request.spectrum_window_s, [name])
        found = (
            compute_spectrum(times.astype(np.float64), values[:, 0].astype(np.float64))
            if name in history.names
            else None
        )
        if found is None:
            return {"signal": name, "rate": None}
        rate, frequency, density = found
        return {
            "signal": name, "unit": history.signal_unit(name), "rate": rate, "f": frequency.astype(np.float32),
            "d": density.astype(np.float32), "marks": make_rotor_frequency_marks(snapshot.rotor_speed, rate),
        }  # fmt: skip


def _find_trail(source: PanelSource) -> Any:
    """Return the vehicle's recent track, (n, 3), for the 3-D scene; empty if unknown."""
    names = source.history.names
    for believed in ("estimated", "measured", "truth"):
        wanted = [f"{believed}_position_{axis}" for axis in "NED"]
        if set(wanted) <= set(names):
            _, values = source.history.recent_rows(TRAIL_LENGTH_S, wanted)
            if np.isfinite(values).any():
                step = max(1, math.ceil(len(values) / MAX_TRAIL_POINTS))
                return np.ascontiguousarray(values[::step], dtype=np.float32)
    return []


def _thin_track(track: _Array) -> Any:
    step = max(1, math.ceil(len(track) / MAX_TRAIL_POINTS))
    return np.ascontiguousarray(track[::step], dtype=np.float32)


def _encode_other_vehicle(name: str, color: int, shape: str, s: VehicleSnapshot) -> dict[str, Any]:
    place = {"p": s.estimate.position, "a": s.estimate.attitude, "w": s.rotor_speed}
    told = {"name": name, "color": color, "shape": shape, "armed": s.armed}
    return told | {k: v.astype(np.float32) for k, v in place.items()}


# Grouping of signals by quantity, component and source. A flat name is ``source_quantity_component``
# (``measured_attitude_roll``) or, for quantities with a single source, ``quantity_component`` (``motor_input_upper``).
# A plot shows one quantity: colours mark components, line styles mark sources.

SIGNAL_SOURCES = ("estimated", "measured", "reference", "truth")
_QUANTITY_TITLES = {
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
_QUANTITY_ORDER = tuple(_QUANTITY_TITLES)
_UPWARD_COMPONENTS = {("position", "D"): "height", ("velocity", "D"): "climb"}
"""Components plotted upward, as elsewhere on the page: their sign is reversed."""


def display_unit(unit: str, quantity: str) -> tuple[str, float]:
    """Return the display unit, and the factor from the SI value."""
    if unit == "rad":
        return "°", find_conversion_factor("rad", "deg")
    if unit == "rad/s":
        if "rotor_speed" in quantity:
            return "rpm", find_conversion_factor(unit, "rpm")
        return "°/s", find_conversion_factor(unit, "deg/s")
    if quantity == "battery_charge" and unit == "1":
        return "%", 100.0
    return ("" if unit == "1" else unit), 1.0


def _split_signal_name(name: str) -> tuple[str, str, str]:
    """Split a signal's name into source, quantity and component; the source is "" if the quantity has a single one."""
    known = parse_column_name(name)
    variable, component = known if known is not None else (name, None)
    source, _, quantity = variable.partition("_")
    if source in SIGNAL_SOURCES and quantity:
        return source, quantity, component or ""
    return "", variable, component or ""


def list_sensor_states(
    history: SignalHistory | ReplayHistory, messages: Sequence[StatusMessage] = ()
) -> list[tuple[str, str, float, str]]:
    """Return the estimator's status of each sensor: name, status in words, innovation (sigmas), and reason.

    The reason is the vehicle's latest message about a sensor that is not fused; "" for a fused sensor.
    """
    names = [f"{kind}_{name}" for name in READINGS_WITH_FUSION_STATUS for kind in ("status", "innovation")]
    if not set(names) <= set(history.names):
        return []  # a recording of a flight on what is true
    _, values = history.recent_rows(MAX_RECENT_VALUE_AGE_S, names)
    if not len(values):
        return []
    now = values[-1].tolist()
    told = zip(READINGS_WITH_FUSION_STATUS, now[0::2], now[1::2], strict=True)
    return [
        (name.replace("_", " "), FUSION_STATUSES[int(status)], round(ratio, 1),
         _find_status_reason(name, messages) if FUSION_STATUSES[int(status)] in _DOUBTED_STATUSES else "")
        for name, status, ratio in told
        if 0.0 <= status < len(FUSION_STATUSES)
    ]  # fmt: skip


_DOUBTED_STATUSES = ("rejected", "missing", "faulty")
_MAX_SEARCHED_MESSAGES = 200  # messages


def _find_status_reason(reading: str, messages: Sequence[StatusMessage]) -> str:
    """Return the reason of a sensor's status, from the vehicle's latest message about the sensor; "" if none.

    The reason follows the colon (:func:`mufly.flight.estimator_health.describe_sensor_status`).
    """
    name = f"{find_sensor_name(reading)} "
    late = islice(reversed(messages), _MAX_SEARCHED_MESSAGES)
    last = next((m.text for m in late if m.text.startswith(name)), "")
    return last.partition(": ")[2]


def build_signal_catalog(names: Iterable[str], unit: Callable[[str], str]) -> list[dict[str, Any]]:
    """Return the quantities that can be plotted, in the format of the page.

    Parameters
    ----------
    names : iterable of str
        Flat names of all signals.
    unit : callable
        SI unit of a signal.

    Returns
    -------
    list of dict
        ``key``, ``title``, ``unit`` and ``factor`` of display, ``components`` (list of str), ``upward`` (components
        plotted with reversed sign), ``sources`` (list of str), ``signals`` (``{"source/component": flat name}``) and
        ``bands`` (the same for their standard deviations), the best-known quantity first.
    """
    found: dict[str, dict[str, Any]] = {}
    names = list(names)
    parts = {_split_signal_name(name): name for name in names}
    for name in names:
        source, quantity, component = _split_signal_name(name)
        sigma = parts.get((source, f"{quantity}_sigma", component))
        if quantity not in found:
            shown, factor = display_unit(unit(name), quantity)
            title = _QUANTITY_TITLES.get(quantity, quantity.replace("_", " ").capitalize())
            found[quantity] = {
                "key": quantity, "title": title, "unit": shown, "factor": factor,
                "components": [], "upward": [], "sources": [], "signals": {}, "bands": {},
            }  # fmt: skip
        entry = found[quantity]
        if (upward := _UPWARD_COMPONENTS.get((quantity, component))) is not None:
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
        entry["sources"].sort(key=lambda s: SIGNAL_SOURCES.index(s) if s in SIGNAL_SOURCES else -1)
    rank = {key: k for k, key in enumerate(_QUANTITY_ORDER)}
    return sorted(found.values(), key=lambda e: (rank.get(e["key"], len(rank)), e["key"]))


# The spectrum of a signal, with marks where the rotors would show.


def alias_frequency(frequency_hz: float, rate_hz: float) -> float:
    """Return the frequency (Hz) at which a frequency (Hz) appears in a signal sampled at ``rate_hz``."""
    return abs(frequency_hz - round(frequency_hz / rate_hz) * rate_hz)


def compute_spectrum(times: _Array, values: _Array) -> tuple[float, _Array, _Array] | None:
    """Return sampling rate (Hz), frequencies (m,) and densities (m,; unit^2/Hz) of samples (n,) at times (n,; s).

    Power spectral density by Welch's method (Hann window, halves overlapping), one-sided, so that its integral over
    frequency is the variance. Samples are interpolated linearly at the median step, also across gaps. None for too few
    samples.
    """
    good = np.isfinite(values)
    times, values = times[good], values[good]
    if len(times) < MIN_SPECTRUM_SAMPLES:
        return None
    step = float(np.median(np.diff(times)))
    if not step > 0.0:
        return None
    clock = np.arange(times[0], times[-1], step)
    if len(clock) < MIN_SPECTRUM_SAMPLES:
        return None
    even = np.interp(clock, times, values)
    length = min(len(even), 1024)
    frequency, density = welch(even, 1.0 / step, "hann", length, length // 2, detrend=detrend)
    return 1.0 / step, frequency[1:], density[1:]


def make_rotor_frequency_marks(rotor_speed: _Array, rate_hz: float) -> list[dict[str, Any]]:
    """Return the marks of both rotors' vibration frequencies in a spectrum.

    Keys of a mark: ``name``, ``hz`` (true frequency), ``at`` (where it is drawn), ``folded`` (whether that is an
    alias).

    A rotor of speed Omega with b blades excites vibration at f = Omega / 2 pi and at b f. The link
    samples at f_s; a frequency above f_s / 2 appears at its alias |f - round(f / f_s) f_s| and is marked there.
    """
    out = []
    for name, speed in zip(("upper", "lower"), rotor_speed.tolist(), strict=True):
        if not (math.isfinite(speed) and speed > 1.0):
            continue
        for label, times in ((name, 1), (f"{name} ×{BLADE_COUNT}", BLADE_COUNT)):
            true = times * speed / (2.0 * math.pi)
            at = alias_frequency(true, rate_hz)
            out.append({"name": label, "hz": true, "at": at, "folded": true > 0.5 * rate_hz})
    return out
