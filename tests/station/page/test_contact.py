"""Requests of a window that come late are dropped, whatever the clock of its browser says."""

import asyncio
import math
from types import SimpleNamespace

import pytest

from mufly.link.ports import MAX_REQUEST_AGE_S, read_boot_clock
from mufly.station import RequestOutcome
from mufly.station.page.late_requests import FrameTimes, LateUploadFilter, drop_late_events


class Clock:
    now_s = 1000.0

    def __call__(self):
        return self.now_s


class Element:
    """As much of NiceGUI's as is asked for."""

    def __init__(self, number, text):
        self.id, self._text, self.tag, self.props, self.updates = number, text, "button", {}, 0
        types = ("click", "change", "update:modelValue")
        self._event_listeners = {name: SimpleNamespace(type=name) for name in types}

    def descendants(self):
        return ()

    def update(self):
        self.updates += 1


class Client:
    def __init__(self):
        self.handled = []
        self.elements = {7: Element(7, "Land"), 8: Element(8, "Hover")}
        self.handle_event = self.handled.append

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


@pytest.fixture
def window():
    clock, client, said = Clock(), Client(), []
    frames = FrameTimes(clock)
    drop_late_events(client, frames, said.append, clock)
    return SimpleNamespace(clock=clock, client=client, said=said, frames=frames)


@pytest.mark.parametrize(
    ("waits_s", "held_ms", "seen_ms", "obeyed"),
    [
        (0.0, 0.0, 0.0, True),
        (0.9, 0.0, 0.0, True),
        (1.1, 0.0, 0.0, False),
        (45.0, 0.0, 45e3, False),  # the page was grey
        (0.2, 900.0, 0.0, False),  # a busy page, and 0.2 s on the way
        (0.2, 900.0, 200.0, True),  # the frame had been there for 0.2 s
        (0.9, 0.0, -1e9, True),
        (0.5, 600.0, -1e9, False),
        (0.0, math.nan, 0.0, False),
        (0.0, -5000.0, 0.0, True),
        (0.0, "soon", 0.0, False),
    ],
)
def test_a_press_is_obeyed_within_a_second_of_it_and_of_its_frame(window, waits_s, held_ms, seen_ms, obeyed):
    press = {"id": 7, "listener_id": "click", "frame": window.frames.register_frame()}
    window.clock.now_s += waits_s
    window.client.handle_event({**press, "held_ms": held_ms, "seen_ms": seen_ms})
    assert bool(window.client.handled) == obeyed
    assert [r.outcome for r in window.said] == ([] if obeyed else [RequestOutcome.REFUSED])
    assert window.client.elements[7].updates == (not obeyed)  # the browser shows again what the station has


def test_what_stands_in_fields_and_which_tab_is_shown_is_taken_late_too(window):
    """Else the station would act on another number than the one that is seen."""
    number = window.frames.register_frame()
    window.clock.now_s += 5.0
    for name in ("change", "update:modelValue", "click"):
        window.client.handle_event({"id": 7, "listener_id": name, "frame": number})
    assert [e["listener_id"] for e in window.client.handled] == ["change", "update:modelValue"]


def test_what_names_no_frame_or_one_of_another_stream_is_dropped_and_told_once_a_second(window):
    numbers = [window.frames.register_frame() for _ in range(300)]
    for frame in (None, 0, -1, 301, numbers[0], "300", 1e30, True and [300]):
        window.client.handle_event({"id": 7, "frame": frame})
    assert window.client.handled == []
    assert [r.text for r in window.said] == ["land"]
    assert "too late" in window.said[0].answer
    window.client.handle_event({"id": 8, "frame": None})
    window.clock.now_s += 1.5
    window.client.handle_event({"id": 7, "frame": numbers[-1]})
    assert [r.text for r in window.said] == ["land", "hover", "land"]
    assert "1.5 s late" in window.said[-1].answer


def test_a_sleep_of_the_machine_counts():
    """Its clock runs on where ``time.monotonic`` stands still; it never goes back."""
    first = read_boot_clock()
    assert read_boot_clock() >= first


@pytest.mark.parametrize(("waits_s", "status"), [(0.3, 200), (MAX_REQUEST_AGE_S + 0.1, 408)])
def test_a_file_that_began_to_travel_too_late_is_refused(waits_s, status):
    clock, sent = Clock(), []
    frames = FrameTimes(clock)
    number = frames.register_frame()

    async def app(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    layer = LateUploadFilter(app, {"a-window": frames}.get)

    def ask(method, path, *headers):
        sent.clear()
        asyncio.run(layer({"type": "http", "method": method, "path": path, "headers": headers}, None, send))
        return sent[0]["status"]

    clock.now_s += waits_s
    path = "/_nicegui/client/a-window/upload/12"
    assert ask("POST", path, (b"x-mufly-frame", b"%d" % number)) == status
    assert ask("POST", path) == 408
    assert ask("POST", path, (b"x-mufly-frame", b"99999999999999999999999")) == 408
    assert ask("POST", path.replace("a-window", "nobody"), (b"x-mufly-frame", b"%d" % number)) == 408
    assert ask("GET", path) == ask("POST", "/login") == 200
