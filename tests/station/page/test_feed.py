"""What one window is told: increments, tables, and nothing for a window that does not keep up."""

import base64
import json
import math
import tracemalloc
from collections import deque
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mufly.estimate import Estimate
from mufly.flight import FlightState, TunableParameter
from mufly.slam import MapView, PictureCounts, TrackedPicture, TrackingResult
from mufly.station import (
    MissionRow,
    OperatorRequest,
    PreflightCheck,
    RequestOutcome,
    SignalHistory,
    StatusMessage,
    VehicleSnapshot,
)
from mufly.station.page.frame_feed import (
    MAX_FRAMES_IN_FLIGHT,
    MAX_PLOT_POINTS,
    DisplayRequest,
    FrameFeed,
    build_signal_catalog,
    encode_snapshot,
    list_sensor_states,
)
from mufly.station.page.page_session import ANSWER_DISPLAY_S, CONTROLS_RELEASE_DELAY_S, StationSession


class Vehicle:
    """A vehicle that a test makes move."""

    kind, system, color, name, display_name, key = "mufly", 1, 0, "test vehicle", "test vehicle", "1@link"

    def __init__(self) -> None:
        self.history = SignalHistory(seconds=60.0)
        self.snapshot = VehicleSnapshot()
        self.status_messages: deque[StatusMessage] = deque(maxlen=500)
        self.mission_rows: list[MissionRow] = []
        self.parameters: dict[str, TunableParameter] = {}
        self.preflight_checks: list[PreflightCheck] = []
        self.k = 0

    def go(self, rows: int) -> None:
        for _ in range(rows):
            self.k += 1
            values = np.full(len(self.history.names), math.nan)
            values[self.history.names.index("estimated_position_N")] = math.sin(0.01 * self.k)
            values[self.history.names.index("battery_voltage")] = 8.0 - 1e-4 * self.k
            self.history.append_row(0.01 * self.k, values)
        self.snapshot = replace(self.snapshot, time_s=0.01 * self.k, connected=True)


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def vehicle() -> Vehicle:
    return Vehicle()


@pytest.fixture
def session(vehicle: Vehicle) -> StationSession:
    return StationSession(lambda: [vehicle], Path("nowhere"), clock=Clock())  # type: ignore[list-item, return-value]


@pytest.fixture
def feed(session: StationSession) -> FrameFeed:
    return FrameFeed(session.open_view("window"))


def frame(feed: FrameFeed, now_s: float = 0.0) -> dict[str, Any]:
    got = json.loads(feed.make_frame(now_s))
    feed.handle_message(json.dumps({"drawn": got["n"]}))
    return got


def want(feed: FrameFeed, **content: Any) -> None:
    feed.handle_message(json.dumps({"want": content}))


def test_increments_put_together_are_the_history(vehicle: Vehicle, feed: FrameFeed) -> None:
    names = ["estimated_position_N", "battery_voltage", "no such signal"]
    want(feed, signals=names, window_s=30)
    times: list[float] = []
    values: list[list[float | None]] = [[], [], []]
    for k in range(40):
        vehicle.go(k % 9)
        h = frame(feed, 0.05 * k)["h"]
        assert ("names" in h) == (k == 0)
        times += h["t"]
        for mine, new in zip(values, h["v"], strict=True):
            mine += new
    t, x = vehicle.history.recent_rows(1e9, names)
    np.testing.assert_allclose(times, t, atol=1e-4)
    np.testing.assert_array_equal(np.float32(values[0]), x[:, 0])
    np.testing.assert_array_equal(np.float32(values[1]), x[:, 1])
    assert set(values[2]) == {None}  # NaN travels as null


def test_a_window_that_does_not_draw_gets_nothing_and_then_the_gap(vehicle: Vehicle, feed: FrameFeed) -> None:
    want(feed, signals=["battery_voltage"], window_s=60)
    vehicle.go(10)
    frame(feed)
    for _ in range(MAX_FRAMES_IN_FLIGHT):
        assert feed.is_ready
        feed.make_frame(0.0)
    assert not feed.is_ready
    vehicle.go(500)  # stalled for five seconds
    feed.handle_message(json.dumps({"drawn": feed.sent_frame}))
    assert feed.is_ready
    assert len(frame(feed)["h"]["t"]) == 500


def test_a_stalled_window_costs_no_memory(vehicle: Vehicle, feed: FrameFeed) -> None:
    want(feed, signals=["battery_voltage", "estimated_position_N"], sections=["messages", "catalog"])
    vehicle.go(6000)  # the ring is full: it does not grow any more
    frame(feed)

    def run(rounds: int) -> None:
        for k in range(rounds):
            vehicle.go(5)
            if feed.is_ready:
                feed.make_frame(0.05 * k)

    run(50)
    tracemalloc.start()
    run(20)
    before = tracemalloc.get_traced_memory()[0]
    run(600)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert feed.sent_frame - feed.drawn_frame == MAX_FRAMES_IN_FLIGHT
    assert grown < 20_000


def test_a_long_window_is_thinned_with_its_newest_sample_kept(vehicle: Vehicle, feed: FrameFeed) -> None:
    vehicle.history = SignalHistory(seconds=400.0)
    vehicle.go(30_000)
    want(feed, signals=["battery_voltage"], window_s=600)
    h = frame(feed)["h"]
    assert len(h["t"]) <= MAX_PLOT_POINTS
    assert h["t"][-1] == pytest.approx(300.0)


def test_tables_are_sent_when_they_change_and_whole_when_shown_again(vehicle: Vehicle, feed: FrameFeed) -> None:
    vehicle.mission_rows = [MissionRow("take off")]
    vehicle.preflight_checks = [PreflightCheck("link", True, "fine")]
    vehicle.parameters = {"A": TunableParameter("A", 1.0), "B": TunableParameter("B", 2.0)}
    want(feed, sections=["mission", "checks", "parameters"])
    first = frame(feed, 0.0)
    assert [len(first[k]) for k in ("mission", "checks", "parameters")] == [1, 1, 2]
    assert not {"mission", "checks", "parameters"} & frame(feed, 1.0).keys()
    vehicle.parameters = {**vehicle.parameters, "B": TunableParameter("B", 3.0)}
    changed = frame(feed, 2.0)
    assert [p[:2] for p in changed["parameters"]] == [["B", 3.0]]
    assert changed["parameters"][0][-1] == 2.0  # what it was at first
    assert not changed["parameters_new"]
    want(feed, sections=[])
    frame(feed, 3.0)
    want(feed, sections=["parameters"])
    assert len(frame(feed, 4.0)["parameters"]) == 2


def test_messages_come_once_even_when_the_log_is_full(vehicle: Vehicle, feed: FrameFeed) -> None:
    want(feed, sections=["messages"])
    got: list[str] = []
    for k in range(700):
        vehicle.status_messages.append(StatusMessage(k, "info", f"line {k}"))
        if k % 3 == 0:
            got += [m[2] for m in frame(feed, 0.05 * k).get("messages", [])]
    assert got == [f"line {k}" for k in range(700)]


def test_another_source_or_a_vehicle_started_anew_begins_anew(session: StationSession, vehicle: Vehicle) -> None:
    feed = FrameFeed(session.open_view("window"))
    want(feed, signals=["battery_voltage"])
    vehicle.go(300)
    assert frame(feed)["new"]
    assert "new" not in frame(feed)
    vehicle.history.clear()
    vehicle.k = 0
    vehicle.go(5)
    restarted = frame(feed)
    assert restarted["new"]
    assert len(restarted["h"]["t"]) == 5


@pytest.mark.parametrize(
    "text",
    [
        *("", "{", "[]", "null", "7", "\x00", '{"want": 3}', '{"want": {"signals": {"a": 1}}}'),
        *('{"drawn": "x"}', '{"drawn": 1e9}', '{"drawn": -1}', '{"want": {"window_s": -3}}'),
        *('{"want": {"window_s": 1e400}}', '{"want": {"sections": [[]], "signals": [1, null]}}'),
    ],
)
def test_what_makes_no_sense_is_not_understood(vehicle: Vehicle, feed: FrameFeed, text: str) -> None:
    vehicle.go(3)
    frame(feed)
    feed.handle_message(text)
    assert 0 < feed.display_request.window_s < 1e6
    assert feed.drawn_frame <= feed.sent_frame
    frame(feed)


def test_a_greedy_window_is_limited() -> None:
    greedy = DisplayRequest.from_message(
        {"signals": [f"s{k}" for k in range(5000)], "window_s": 1e12, "sections": ["x", "scene"]}
    )
    assert len(greedy.signals) == 64
    assert greedy.window_s <= 36_000
    assert greedy.sections == {"scene"}


def test_a_snapshot_travels_whole() -> None:
    at = Estimate(position=np.array([1.0, math.nan, -2.5]))
    s = VehicleSnapshot(estimate=at, mission_row=3, state="hover", commander="station 255")
    content = encode_snapshot(s)
    own = set(VehicleSnapshot.__dataclass_fields__) - set(FlightState.__dataclass_fields__) - {"mission_row"}
    motion = {"position", "velocity", "attitude", "rates", "ranges", "motor_input", "servo_input"}
    followed = {"reference_position", "reference_velocity", "reference_attitude"}
    battery = {"battery_voltage", "battery_current", "battery_charge", "battery_left_s"}
    assert set(content) == own | motion | followed | battery | {
        "time_s",
        "armed",
        "flying",
        "state",
        "waypoint",
    }
    assert isinstance(s, FlightState)
    assert content["position"].dtype == np.float32
    assert content["waypoint"] == 3


def test_the_first_window_holds_the_controls_and_the_last_one_left_gets_them(session: StationSession) -> None:
    clock = session.clock
    one, two, three = (session.open_view(n) for n in ("one", "two", "three"))
    assert not one.has_controls  # a page that was fetched and never opened its stream is no window
    for view in (one, two, three):
        view.open_stream()
    assert [v.has_controls for v in (one, two, three)] == [True, False, False]
    two.take_controls()
    assert [v.has_controls for v in (one, two, three)] == [False, True, False]
    two.close_stream()
    clock.now += 0.5 * CONTROLS_RELEASE_DELAY_S  # type: ignore[attr-defined]
    assert not one.has_controls  # it may only have been reloaded
    clock.now += CONTROLS_RELEASE_DELAY_S  # type: ignore[attr-defined]
    assert not one.has_controls  # there are two: somebody has to press
    assert not three.has_controls
    three.close_stream()
    session.close_view("two")
    session.close_view("three")
    assert one.has_controls
    assert session.open_stream_count == 1


def test_the_flight_is_told_behind_a_recording_with_its_last_warning(session: StationSession, vehicle: Vehicle) -> None:
    view = session.open_view("one")
    feed = FrameFeed(view)
    at = Estimate(position=np.array([0.0, 0.0, -1.5]))
    vehicle.go(3000)
    vehicle.snapshot = replace(vehicle.snapshot, armed=True, flying=True, state="hover", estimate=at)
    vehicle.status_messages += [StatusMessage(25.0, "warning", "it swings"), StatusMessage(29.0, "info", "reached")]
    view.replay = SimpleNamespace(
        time_s=0.0,
        start_s=0.0,
        end_s=1.0,
        jumps=0,
        playing=False,
        speed=1.0,
        name="old.mcap",
        snapshot=VehicleSnapshot(),
    )  # type: ignore[assignment]
    told = frame(feed)
    assert not told["s"]["flying"]  # the recording
    flight = told["about"]["flight"]
    assert (flight["flying"], flight["state"], flight["height"]) == (True, "hover", 1.5)
    assert flight["alert"] == ["warning", "it swings", pytest.approx(5.0)]
    vehicle.go(2000)
    assert frame(feed)["about"]["flight"]["alert"] is None  # 25 s later it is history
    assert view.shown_vehicle() is None
    assert view.selected_vehicle() is vehicle  # type: ignore[comparison-overlap]


def test_answers_go_after_a_while_and_a_refusal_when_something_was_granted(session: StationSession) -> None:
    clock, view = session.clock, session.open_view("one")
    refused, granted, waiting = (OperatorRequest(text) for text in ("land", "take off", "go"))
    for request in (refused, granted, waiting):
        view.keep_request(request)
    refused.set_outcome(RequestOutcome.REFUSED, "on the floor")
    assert view.recent_requests() == [refused, granted, waiting]
    granted.set_outcome(RequestOutcome.ACCEPTED)
    assert view.recent_requests() == [granted, waiting]
    clock.now += ANSWER_DISPLAY_S + 1.0  # type: ignore[attr-defined]
    assert view.recent_requests() == [waiting]
    waiting.set_outcome(RequestOutcome.TIMED_OUT, "no answer")
    assert view.recent_requests() == [waiting]
    clock.now += ANSWER_DISPLAY_S + 1.0  # type: ignore[attr-defined]
    assert view.recent_requests() == []


def test_controls_taken_before_the_stream_is_open_are_kept(session: StationSession) -> None:
    clock = session.clock
    one = session.open_view("one")
    one.open_stream()
    clock.now += 10.0  # type: ignore[attr-defined]
    two = session.open_view("two")
    two.take_controls()  # on a slow machine the press comes first
    clock.now += 10.0  # type: ignore[attr-defined]
    assert two.has_controls
    assert not one.has_controls


def test_sensors_and_bands_are_told_where_an_estimator_says_what_it_believes() -> None:
    """Status in words and innovation of what is on board; an estimate's deviation is the band of its plot."""
    history = SignalHistory(seconds=10.0)
    assert list_sensor_states(history) == []
    row = np.full(len(history.names), np.nan, dtype=np.float32)
    at = {name: k for k, name in enumerate(history.names)}
    row[at["status_position_fix"]], row[at["innovation_position_fix"]] = 2.0, -7.31
    row[at["status_rates"]], row[at["innovation_rates"]] = 1.0, 0.0
    row[at["status_pressure"]] = 77.0  # what a stranger says
    history.append_row(1.0, row)
    assert list_sensor_states(history) == [
        ("rates", "fused", 0.0, ""),
        ("position fix", "rejected", -7.3, ""),
    ]
    said = [
        StatusMessage(0.2, "warning", "position fix is missing: no reading for 0.52 s"),
        StatusMessage(0.8, "warning", "position fix is rejected: differs from the estimate by 0.4 m"),
        StatusMessage(0.9, "warning", "gyroscope is faulty: has spikes"),  # that was; it is believed again
    ]
    assert [why for *_, why in list_sensor_states(history, said)] == [
        "",
        "differs from the estimate by 0.4 m",
    ]
    (position,) = (q for q in build_signal_catalog(history.names, history.signal_unit) if q["key"] == "position")
    assert position["bands"]["estimated/height"] == "estimated_position_sigma_D"
    assert "truth/height" not in position["bands"]


def test_the_camera_is_shown_to_who_looks_at_it(vehicle: Vehicle, session: StationSession) -> None:
    vehicle.go(5)
    sketch = MapView(np.zeros((3, 3), np.float32), np.array([[0, 1, 0], [1, 2, 0], [0, 2, 1]], np.int32))
    answer = TrackingResult(0.03, True, "", np.array([1.0, 2.0, -1.0]), 0.5, np.diag([1e-4, 4e-4, 1e-4, 1e-4]), 2, 9, 7)
    now = TrackedPicture(0.01, b"floor")
    session.get_slam_picture = lambda: now
    feed = FrameFeed(session.open_view("window"))
    want(feed, sections=["messages"])
    assert "camera" not in frame(feed)
    want(feed, sections=["camera"])
    standing = frame(feed, 1.0)["camera"]
    assert base64.b64decode(standing["jpeg"]) == b"floor"
    assert "features" not in standing
    assert "camera" not in frame(feed, 1.1)  # the same again
    now = TrackedPicture(
        0.03, b"jpeg", answer, np.ones((7, 2), np.float32), 0.21, 0.004, "", PictureCounts(9, 1, 8, 7), sketch,
        np.ones((4, 2), np.float32),
    )  # fmt: skip
    got = frame(feed, 2.0)
    told = got["camera"]
    assert (told["keyframes"], told["closures"], len(told["features"])) == (3, 1, 7)
    assert told["trusted_now"]
    assert told["covariance"][1][1] == 4e-4
    assert got["floor_map"]["ties"][2] == [0, 2, 1]
    assert len(got["floor_map"]["path"]) == 4
    lost = replace(answer, trusted=False, position=np.full(3, math.nan))
    now = replace(now, result=lost, warning="too few points of the floor are recognised")
    told = frame(feed, 3.0)["camera"]
    assert told["position"] == [None, None, None]
    assert told["said"].startswith("too few points")


def two_windows() -> tuple[StationSession, list[Any]]:
    """A session, and two vehicles of one name and number on two links."""
    vehicles: list[Any] = []
    for k, link in enumerate(("udpin:0.0.0.0:14550", "serial:/dev/ttyUSB0:57600")):
        vehicle = Vehicle()
        vehicle.key, vehicle.color = f"1@{link}", k
        vehicles.append(vehicle)
    return StationSession(lambda: vehicles, Path()), vehicles


def test_a_window_that_is_loaded_anew_shows_the_vehicle_that_it_showed() -> None:
    """Whatever the order in which they are heard now, and also if it was never chosen by hand."""
    session, vehicles = two_windows()
    first = session.open_view("first")
    assert first.selected_vehicle() is vehicles[0]
    key = first.status_fields()["selected"]
    vehicles.reverse()
    assert first.selected_vehicle() is vehicles[1]
    assert session.open_view("again", key).selected_vehicle() is vehicles[1]
    names = dict(first.status_fields()["vehicles"])
    assert names[vehicles[0].key] == "test vehicle (serial:/dev/ttyUSB0:57600)"
    assert first.encode_selected_vehicle()["name"] == "test vehicle (udpin:0.0.0.0:14550)"  # type: ignore[index]


def test_a_vehicle_that_is_gone_is_not_replaced_by_another() -> None:
    session, vehicles = two_windows()
    view = session.open_view("window", "7@udpin:0.0.0.0:14550")
    assert view.selected_vehicle() is None
    assert view.encode_selected_vehicle() is None
    words = session.describe_waiting(view.selected)
    assert "system 7 on udpin:0.0.0.0:14550" in words
    assert "select another" in words
    view.select_vehicle(vehicles[1].key)
    assert view.selected_vehicle() is vehicles[1]
    # A name that becomes known later changes nothing.
    vehicles[1].display_name = "mufly, system 1"
    assert view.selected_vehicle() is vehicles[1]


def test_a_window_without_a_vehicle_says_what_is_wrong_with_the_link() -> None:
    session = StationSession(
        list, Path(), describe_link_problems=lambda: ["serial:/dev/ttyUSB9:57600: there is no such device"]
    )
    view = session.open_view("window")
    assert "there is no such device" in session.describe_waiting(view.selected)
    assert "there is no such device" in view.status_fields()["trouble"]
