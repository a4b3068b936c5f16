"""The list of all flights in the folder of recordings: time, duration, vehicle, mission, outcome, read errors.

The list is shown at once from the directory entries; the files are read in the background, once each. mufly's own
recordings need a few milliseconds (:func:`mufly.logs.read_recording_summary`). Foreign logs must be read whole, and
wait until no vehicle flies.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments, UploadEventArguments

from mufly.errors import MuflyError
from mufly.logs import detect_log_format, read_log, read_recording_summary
from mufly.station.page.page_session import WindowView, find_recordings, is_flight_folder
from mufly.station.page.panels import (
    MAX_RECORDING_BYTES,
    JavaScriptPanel,
    add_file_picker,
    make_button,
    make_element,
    show_refusal,
)
from mufly.station.replay import open_recording
from mufly.station.signal_history import OperatorRequest, RequestOutcome

MAX_WHOLE_READ_BYTES = 60_000_000
"""Largest foreign log that is read whole for the list (bytes)."""
MAX_GROWING_FILE_AGE_S = 5.0
"""Age of the last write below which an unfinished recording counts as still running (s)."""
_LIST_UPDATE_PERIOD_S = 0.4


@dataclass(frozen=True, slots=True)
class FlightFacts:
    """Format, start, duration, vehicle, mission and outcome of a recording, for the list of flights.

    Attributes
    ----------
    file_format : str
        Format of the file.
    start_s : float
        Start (s since 1970); NaN if unknown.
    duration_s : float
        NaN if unknown without reading the whole file.
    vehicle, mission, outcome : str
        "" if unknown.
    read_error : str
        Error on reading, "" if none.
    """

    file_format: str = ""
    start_s: float = math.nan
    duration_s: float = math.nan
    vehicle: str = ""
    mission: str = ""
    outcome: str = ""
    read_error: str = ""


def read_flight_facts(path: Path) -> FlightFacts:
    """Read the facts of a recording; an unreadable file returns its error."""
    kind = ""
    try:
        kind = detect_log_format(path)
        if kind == "MCAP":
            facts = read_recording_summary(path)
            length_s = facts["duration_s"]
        elif (size := path.stat().st_size) > MAX_WHOLE_READ_BYTES:
            return FlightFacts(kind, outcome=f"{size / 1e6:.0f} MB: open it to read the facts")
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                data = read_log(path)
            facts, times = data.attrs, data["time"].values
            length_s = float(times[-1] - times[0]) if len(times) else math.nan
    except MuflyError as error:
        return FlightFacts(kind, read_error=str(error).removeprefix(f"{path}: "))
    except Exception as error:  # a damaged log can fail in any way, and the list goes on
        return FlightFacts(kind, read_error=f"damaged ({type(error).__name__}: {error})"[:200])
    start_ns = facts.get("start_time_ns")
    start_s = float(start_ns) * 1e-9 if isinstance(start_ns, int | float) and start_ns > 0 else _parse_start_time(facts)
    outcome = ": ".join(str(facts[k]) for k in ("outcome", "reason") if facts.get(k))
    if not facts.get("complete", True) and not outcome:
        growing = abs(time.time() - path.stat().st_mtime) < MAX_GROWING_FILE_AGE_S
        outcome = "being recorded" if growing else "incomplete"
    vehicle = facts.get("vehicle") or facts.get("system") or ""
    return FlightFacts(kind, start_s, length_s, str(vehicle), str(facts.get("mission") or ""), outcome)


def _parse_start_time(facts: dict[Any, Any]) -> float:
    try:
        return datetime.fromisoformat(str(facts.get("start_time", ""))).timestamp()
    except ValueError:
        return math.nan


def has_better_recording(path: Path) -> bool:
    """Return whether the list shows another recording of the same flight, in the same folder, instead of ``path``.

    The vehicle's own recording is better than a station's, and signals are better than packets.
    """
    best = path.with_name("flight.mcap")
    if best.is_file():
        return path.name != best.name and path.name.startswith(("station", "link"))
    return path.suffix != ".mcap" and path.name.startswith("station") and path.with_name("station.mcap").is_file()


def make_flight_row(path: Path, here: Path, facts: FlightFacts | None) -> dict[str, Any]:
    """Return a recording's row in the list of flights, named relative to ``here``; ``facts`` is None until read."""
    about = path.stat()
    known = facts or FlightFacts()
    return {
        "name": os.path.relpath(path, here),
        "size": about.st_size,
        "start": known.start_s if math.isfinite(known.start_s) else about.st_mtime,
        "length": known.duration_s if math.isfinite(known.duration_s) else None,
        "vehicle": known.vehicle,
        "mission": known.mission,
        "outcome": known.outcome,
        "fault": known.read_error,
        "known": facts is not None,
        "beside": has_better_recording(path),
    }


class FlightList:
    """The list of flights of one window.

    Parameters
    ----------
    view : WindowView
    """

    def __init__(self, view: WindowView) -> None:
        self._view, self._here = view, view.session.recordings_folder
        self._paths: dict[str, Path] = {}
        self._read: dict[Path, tuple[tuple[int, int], FlightFacts]] = {}  # of which state of the file
        self._looks = 0
        with make_element("div", classes="mf-tools"):
            make_button("Refresh", self.scan_folder, title="refresh the list")
            endings = ".mcap,.tlog,.ulg,.csv,.bin"
            add_file_picker("Open a file…", endings, self._open_upload, "recording-file", MAX_RECORDING_BYTES)
            self._place = make_element("span", "", "mf-dim mf-note")
        self._panel = JavaScriptPanel("flights")
        self._panel.on("open", lambda e: self._call_with_path(e, self._open_file))
        self._panel.on("compare", lambda e: self._call_with_path(e, self._compare_file))
        self._panel.on("download", lambda e: self._call_with_path(e, self._download_file))
        self._panel.on("hello", self.scan_folder)

    async def scan_folder(self) -> None:
        """Search for recordings again, and read the new ones."""
        self._looks += 1
        look = self._looks
        folder = self._view.session.recordings_folder
        found = await asyncio.to_thread(find_recordings, folder)
        # Those of a flight are named with its folder, as those of the flights beside it are.
        self._here = folder.parent if is_flight_folder(folder) else folder
        self._place._text = f"in {self._here}"
        self._place.update()
        self._paths = {os.path.relpath(path, self._here): path for path in found}
        unread = [path for path in found if self._read.get(path, ((0, 0),))[0] != _make_file_change_key(path)]
        self._send_rows(found)
        told = time.monotonic()
        # New files before grown ones: a look that ends early, by the next, still gets on.
        for path in sorted(unread, key=lambda path: (path in self._read, *recording_read_sort_key(path))):
            while path.suffix.lower() != ".mcap" and any(v.snapshot.flying for v in self._view.session.list_vehicles()):
                await asyncio.sleep(1.0)
            if look != self._looks or not self._view.is_stream_open:
                return
            state = _make_file_change_key(path)
            self._read[path] = (state, await asyncio.to_thread(read_flight_facts, path))
            if time.monotonic() - told > _LIST_UPDATE_PERIOD_S:
                self._send_rows(found)
                told = time.monotonic()
        if unread:
            self._send_rows(found)

    def _send_rows(self, found: list[Path]) -> None:
        rows = []
        for path in found:
            _, facts = self._read.get(path, (None, None))  # of a file that grows, what was read last
            with contextlib.suppress(OSError):  # gone meanwhile
                rows.append(make_flight_row(path, self._here, facts))
        self._panel.call_browser_method("show", rows)

    async def _call_with_path(self, e: GenericEventArguments, act: Callable[[Path], Any]) -> None:
        """Act on a file by its name; only files in the list are accepted."""
        path = self._paths.get(str(e.args))
        if path is None or not path.is_file():
            show_refusal(f"{str(e.args)[:100]} no longer exists; press Refresh")
            return
        await act(path)

    async def _download_file(self, path: Path) -> None:
        # What is still being recorded would be longer than the browser was told when it asked: a copy does not grow.
        folder = tempfile.mkdtemp(prefix="mufly-download-")
        ui.context.client.on_delete(lambda: shutil.rmtree(folder, ignore_errors=True))
        ui.download.file(await asyncio.to_thread(shutil.copy, path, folder), path.name)

    async def _open_file(self, path: Path) -> None:
        request = OperatorRequest(f"open {path.name}")
        self._view.keep_request(request)
        began = time.monotonic()
        try:
            recording = await asyncio.to_thread(open_recording, path)
        except MuflyError as error:
            request.set_outcome(RequestOutcome.REFUSED, str(error))
            show_refusal(str(error))
            return
        long_s = recording.times_s[-1] - recording.times_s[0]
        request.set_outcome(RequestOutcome.ACCEPTED, f"{long_s:.0f} s, read in {time.monotonic() - began:.1f} s")
        self._view.show_recording(recording)

    async def _compare_file(self, path: Path) -> None:
        """Overlay another recording on the displayed one."""
        view, shown = self._view, self._view.replay
        if shown is None:
            show_refusal("open a recording first; the second recording is overlaid on it")
            return
        request = OperatorRequest(f"compare with {path.name}")
        view.keep_request(request)
        try:
            second = await asyncio.to_thread(open_recording, path)
        except MuflyError as error:
            request.set_outcome(RequestOutcome.REFUSED, str(error))
            show_refusal(str(error))
            return
        if view.replay is not shown:
            request.set_outcome(RequestOutcome.REFUSED, "another recording has been opened")
            return
        if second.name == shown.name:  # two flights have files of the same name: their folders tell them apart
            second = replace(second, name=f"{path.parent.name}/{second.name}")
        view.compare_recording(second)
        request.set_outcome(
            RequestOutcome.ACCEPTED,
            view.compared_recording.alignment_note if view.compared_recording is not None else "",
        )

    async def _open_upload(self, e: UploadEventArguments) -> None:
        with tempfile.TemporaryDirectory() as place:
            path = Path(place) / Path(e.file.name).name
            await e.file.save(path)
            await self._open_file(path)


def recording_read_sort_key(path: Path) -> tuple[bool, bool]:
    """Return the sort key of reading: mufly's recordings before foreign logs, growing files last in each group."""
    return path.suffix.lower() != ".mcap", abs(
        time.time() - _make_file_change_key(path)[0] * 1e-9
    ) < MAX_GROWING_FILE_AGE_S


def _make_file_change_key(path: Path) -> tuple[int, int]:
    """Return a value that changes with the content of a file."""
    try:
        about = path.stat()
    except OSError:
        return 0, 0
    return about.st_mtime_ns, about.st_size
