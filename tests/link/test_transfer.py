"""Mission transfers through a channel that loses, doubles, delays and shuffles: whole or refused, never half."""

from __future__ import annotations

import heapq
import random
from itertools import count

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.link import (
    TRANSFER_TIMEOUT_S,
    MissionAck,
    MissionClearAll,
    MissionCount,
    MissionItem,
    MissionReceiver,
    MissionRequestItem,
    MissionRequestList,
    MissionResultCode,
    MissionSender,
    encode_transfer_message,
    mavlink,
    parse_transfer_message,
)
from mufly.link.mission_transfer import MAX_ITEMS, STALE_PACKET_TIME_S, RetryTimer

STEP_S = 0.05


def mission(n: int, mark: int = 0) -> tuple[MissionItem, ...]:
    return tuple(MissionItem(k, 1, 16, params=(float(mark), 0.0, 0.0, 0.0), x=10_000 * k, z=-1.0) for k in range(n))


class Channel:
    """Carries notes between named ends; what it does to them follows from its seed."""

    def __init__(self, seed: int, loss: float = 0.0, delay_s: float = 0.0, doubles: float = 0.0) -> None:
        self.random = random.Random(seed)
        self.loss, self.delay_s, self.doubles = loss, delay_s, doubles
        self.under_way: list = []
        self.order = count()
        self.carried = 0

    def send(self, now_s, source, notes):
        for target, note in notes:
            self.carried += 1
            for _ in range(1 + (self.random.random() < self.doubles)):
                if self.random.random() >= self.loss:
                    # Times that differ by up to half the delay put later packets before earlier ones.
                    due = now_s + self.delay_s * self.random.uniform(0.75, 1.25)
                    heapq.heappush(self.under_way, (due, next(self.order), source, target, note))

    def arrived(self, now_s):
        while self.under_way and self.under_way[0][0] <= now_s:
            _, _, source, target, note = heapq.heappop(self.under_way)
            yield source, target, note


def run(channel, ends, start, until_s, t=0.0):
    """Let the ends talk until nothing is open any more; ``ends`` maps a name to a machine. Returns the time."""
    channel.send(t, *start)
    while t < until_s:
        t += STEP_S
        for source, target, note in channel.arrived(t):
            end = ends.get(target)
            if end is None:
                continue
            known = (note,) if isinstance(end, MissionSender) else (source, note)
            channel.send(t, target, end.handle_message(t, *known))
        for name, end in ends.items():
            channel.send(t, name, end.take_due_messages(t))
        if all(e.result is not None for e in ends.values()):
            return t
    return t


class Judge:
    def __init__(self, result=MissionResultCode.ACCEPTED):
        self.delivered, self.result = [], result

    def __call__(self, items):
        self.delivered.append(items)
        return self.result


def upload(seed, n, **damage):
    judge, channel = Judge(), Channel(seed, **damage)
    vehicle = MissionReceiver(judge)
    station = MissionSender("vehicle", mission(n))
    took = run(channel, {"vehicle": vehicle, "station": station}, ("station", station.start_transfer(0.0)), 300.0)
    return judge, vehicle, station, took, channel


def test_an_upload_over_a_sound_link_takes_one_round_trip_an_item_and_no_packet_more():
    judge, vehicle, station, took, channel = upload(0, 20, delay_s=0.1)
    assert judge.delivered == [mission(20)]
    assert (vehicle.result, station.result) == (0, 0)
    assert channel.carried == 1 + 20 + 20 + 1
    assert took < 21 * (2 * 0.125 + 2 * STEP_S) + 0.2


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 25))
def test_an_upload_over_the_worst_link_ends_whole_within_a_minute_and_a_half(seed, n):
    judge, _, station, took, _ = upload(seed, n, loss=0.3, delay_s=0.3, doubles=0.2)
    # Mean: (0.6 s + 1.04 repetitions of about 0.7 s) an item, 33 s for 25.
    assert all(items == mission(n) for items in judge.delivered)
    assert judge.delivered
    assert station.result == MissionResultCode.ACCEPTED
    assert took < 90.0


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 20))
def test_a_download_over_the_worst_link_ends_whole(seed, n):
    judge, channel = Judge(), Channel(seed, loss=0.3, delay_s=0.3, doubles=0.2)
    station = MissionReceiver(judge, unasked=False)

    class Vehicle:
        sender, result = None, 0

        def handle_message(self, t, source, note):
            if isinstance(note, MissionRequestList) and self.sender is None:
                self.sender = MissionSender(source, mission(n), uploading=False)
                return self.sender.start_transfer(t)
            return self.sender.handle_message(t, note) if self.sender else []

        def take_due_messages(self, t):
            return self.sender.take_due_messages(t) if self.sender else []

    took = run(
        channel,
        {"station": station, "vehicle": Vehicle()},
        ("station", station.request_items(0.0, "vehicle")),
        300.0,
    )
    assert judge.delivered == [mission(n)]
    assert station.result == MissionResultCode.ACCEPTED
    assert took < 90.0


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), at=st.floats(0.1, 12.0), n=st.integers(1, 8), m=st.integers(1, 8))
def test_a_second_mission_in_mid_transfer_is_never_mixed_with_the_first(seed, at, n, m):
    judge, channel = Judge(), Channel(seed, loss=0.3, delay_s=0.3, doubles=0.3)
    vehicle, first = MissionReceiver(judge), MissionSender("vehicle", mission(n, mark=1))
    ends = {"vehicle": vehicle, "station": first}
    t = run(channel, ends, ("station", first.start_transfer(0.0)), at)
    second = MissionSender("vehicle", mission(m, mark=2))
    ends["station"] = second
    run(channel, ends, ("station", second.start_transfer(t, hush=True)), t + 200.0, t)
    assert all(items in (mission(n, 1), mission(m, 2)) for items in judge.delivered)
    if second.result == MissionResultCode.ACCEPTED:
        assert judge.delivered[-1] == mission(m, 2)


@pytest.mark.parametrize("after", range(5))
def test_a_sender_that_vanishes_leaves_nothing_and_frees_the_receiver(after):
    judge = Judge()
    vehicle = MissionReceiver(judge)
    items = mission(5)
    vehicle.handle_message(0.0, "a", MissionCount(5))
    for k in range(after):
        vehicle.handle_message(0.1 * k, "a", items[k])
    t, asked = 0.5, 0
    while vehicle.is_busy:
        t += STEP_S
        for _, note in vehicle.take_due_messages(t):
            asked += isinstance(note, MissionRequestItem)
            last = note
        assert t < TRANSFER_TIMEOUT_S + 2.0
    assert vehicle.timed_out
    assert last == MissionAck(MissionResultCode.OPERATION_CANCELLED)
    assert 5 <= asked <= TRANSFER_TIMEOUT_S / 0.25
    assert judge.delivered == []
    vehicle.handle_message(t + 5.0, "b", MissionCount(1))
    vehicle.handle_message(t + 5.1, "b", mission(1)[0])
    assert judge.delivered == [mission(1)]


def test_a_receiver_that_vanishes_is_given_up():
    station = MissionSender("vehicle", mission(3))
    counts = len(station.start_transfer(0.0))
    t = 0.0
    while station.result is None:
        t += STEP_S
        counts += sum(isinstance(n, MissionCount) for _, n in station.take_due_messages(t))
        assert t < TRANSFER_TIMEOUT_S + 2.0
    assert station.timed_out
    assert counts >= 5


def test_another_peer_in_mid_transfer_is_denied_and_does_not_disturb():
    judge = Judge()
    vehicle = MissionReceiver(judge)
    vehicle.handle_message(0.0, "a", MissionCount(2))
    assert vehicle.handle_message(0.1, "b", MissionCount(2)) == [("b", MissionAck(MissionResultCode.DENIED))]
    assert vehicle.handle_message(0.2, "b", mission(2, mark=9)[0]) == []
    vehicle.handle_message(0.3, "b", MissionAck(MissionResultCode.OPERATION_CANCELLED))
    for item in mission(2):
        vehicle.handle_message(0.4, "a", item)
    assert judge.delivered == [mission(2)]


def test_items_out_of_turn_and_of_other_kinds_are_passed_over():
    judge = Judge()
    vehicle = MissionReceiver(judge)
    a, b, c = mission(3)
    vehicle.handle_message(0.0, "a", MissionCount(3))
    assert vehicle.handle_message(0.1, "a", b) == []
    assert vehicle.handle_message(0.1, "a", MissionItem(0, 1, 16, mission_type=1)) == []
    assert vehicle.handle_message(0.1, "a", a) == [("a", MissionRequestItem(1))]
    assert vehicle.handle_message(0.2, "a", a) == []
    vehicle.handle_message(0.3, "a", b)
    assert vehicle.handle_message(0.4, "a", c) == [("a", MissionAck(0))]
    assert judge.delivered == [(a, b, c)]


def test_an_acknowledgement_that_was_lost_is_given_again_and_the_mission_delivered_once():
    judge = Judge()
    vehicle = MissionReceiver(judge)
    vehicle.handle_message(0.0, "a", MissionCount(1))
    vehicle.handle_message(0.1, "a", mission(1)[0])
    assert vehicle.handle_message(1.2, "a", mission(1)[0]) == [("a", MissionAck(0))]
    assert len(judge.delivered) == 1


def test_what_the_judge_refuses_the_sender_hears():
    judge = Judge(MissionResultCode.INVALID_PARAM5_X)
    vehicle, station = MissionReceiver(judge), MissionSender("vehicle", mission(2))
    run(Channel(0), {"vehicle": vehicle, "station": station}, ("station", station.start_transfer(0.0)), 20.0)
    assert station.result == MissionResultCode.INVALID_PARAM5_X
    assert not station.timed_out


def test_too_many_items_are_refused_before_any_is_sent():
    judge = Judge()
    vehicle = MissionReceiver(judge)
    assert vehicle.handle_message(0.0, "a", MissionCount(65535)) == [("a", MissionAck(MissionResultCode.NO_SPACE))]
    assert not vehicle.is_busy
    assert vehicle.handle_message(9.0, "a", MissionCount(MAX_ITEMS)) == [("a", MissionRequestItem(0))]


def test_a_transfer_can_be_cancelled_from_either_side():
    judge = Judge()
    vehicle, station = MissionReceiver(judge), MissionSender("vehicle", mission(2))
    station.start_transfer(0.0)
    vehicle.handle_message(0.0, "station", MissionCount(2))
    ((_, note),) = station.cancel_transfer()
    vehicle.handle_message(0.1, "station", note)
    assert not vehicle.is_busy
    station = MissionSender("vehicle", mission(2))
    vehicle.handle_message(5.0, "station", MissionCount(2))
    ((_, note),) = vehicle.cancel_transfer()
    station.handle_message(5.1, note)
    assert station.result == MissionResultCode.OPERATION_CANCELLED
    assert not station.timed_out
    assert judge.delivered == []


def test_a_receiver_that_starts_anew_lets_old_packets_run_dry():
    judge = Judge()
    vehicle = MissionReceiver(judge)
    vehicle.handle_message(0.0, "a", MissionCount(2))
    vehicle.handle_message(0.1, "a", mission(2, 1)[0])
    assert vehicle.handle_message(0.2, "a", MissionCount(2)) == []
    vehicle.handle_message(0.3, "a", mission(2, 1)[0])  # of the first transfer, late
    t = 0.3
    while not (notes := vehicle.take_due_messages(t)):
        t += STEP_S
    assert notes == [("a", MissionRequestItem(0))]
    assert t == pytest.approx(0.1 + STALE_PACKET_TIME_S, abs=2 * STEP_S)


@pytest.mark.parametrize(
    "note",
    [
        MissionCount(3),
        MissionRequestItem(2),
        MissionAck(14),
        MissionRequestList(),
        MissionClearAll(1),
        mission(3)[2],
        MissionItem(1, 6, 22, z=2.0),
    ],
)
def test_notes_survive_the_wire(note):
    link = mavlink.MAVLink(None)
    data = encode_transfer_message(note, 1, 1).pack(link)
    assert parse_transfer_message(link.decode(bytearray(data))) == note


@pytest.mark.parametrize(
    ("frame", "x", "expected"),
    [(1, 1.25, 12_500), (6, 47.5, 475_000_000), (1, float("nan"), 2**31 - 1), (6, 1e9, 2**31 - 1)],
)
def test_items_of_the_older_form_are_read_in_metres_or_degrees(frame, x, expected):
    message = mavlink.MAVLink_mission_item_message(1, 1, 0, frame, 16, 0, 1, 0, 0, 0, 0, x, 0, -1)
    assert parse_transfer_message(message).x == expected


def test_a_question_is_asked_again_after_a_round_trip_and_a_tenth():
    """MAVLink recommends 0.25 s for items and 1.5 s for the rest; over a slow link an answer takes longer."""

    def waits(*trips):
        retry, now_s = RetryTimer(), 0.0
        retry.mark_started(now_s)
        for trip in trips:
            now_s += trip
            retry.mark_progress(now_s)
        return next(0.005 * k for k in range(1000) if retry.take_due_retry(now_s + 0.005 * k))

    assert waits() == pytest.approx(0.8, abs=0.006)
    assert waits(0.01) == pytest.approx(0.25, abs=0.006)
    assert waits(1.0) == pytest.approx(1.1 * 1.0 + 0.05, abs=0.006)
    assert waits(1.0, 0.5) == pytest.approx(1.1 * (0.7 * 1.0 + 0.3 * 0.5) + 0.05, abs=0.006)
    assert waits(3.0) == pytest.approx(1.5, abs=0.006)


def test_a_sender_that_begins_anew_stops_the_receiver_until_it_is_silent():
    sender, cancel = (
        MissionSender("vehicle", mission(3)),
        ("vehicle", MissionAck(MissionResultCode.OPERATION_CANCELLED)),
    )
    assert sender.start_transfer(10.0, hush=True) == [cancel]
    # Five times in HUSH_S, and to every question; each question begins the wait anew.
    cancelled = [k for k in range(1, 15) if sender.take_due_messages(10.0 + 0.1 * k)]
    assert len(cancelled) == 3
    assert cancelled[0] == 4
    assert sender.handle_message(11.5, MissionRequestItem(0)) == [cancel]
    said = {k: sender.take_due_messages(11.5 + 0.1 * k + 1e-6) for k in range(1, 22)}
    assert [k for k, notes in said.items() if notes and notes[0][1] == MissionCount(3)] == [20]
    assert sender.handle_message(13.7, MissionRequestItem(0)) == [("vehicle", sender.items[0])]


def test_an_acceptance_that_comes_too_early_belongs_to_another_transfer():
    sender = MissionSender("vehicle", mission(3))
    sender.start_transfer(0.0)
    assert sender.handle_message(0.1, MissionAck(MissionResultCode.ACCEPTED)) == []
    assert sender.result is None
    # Once items have gone out it means that the receiver counts on fewer of them: it never heard how many.
    sender.handle_message(0.2, MissionRequestItem(0))
    assert sender.handle_message(0.3, MissionAck(MissionResultCode.ACCEPTED)) == [("vehicle", MissionCount(3))]
    giver = MissionSender("station", mission(3), uploading=False)
    giver.start_transfer(0.0)
    giver.handle_message(0.2, MissionRequestItem(0))
    assert giver.handle_message(0.3, MissionAck(MissionResultCode.ACCEPTED)) == []
    assert giver.result is None


def test_progress_is_the_share_of_the_items():
    taker = MissionReceiver(lambda items: 0)
    taker.request_items(10.0, "vehicle")
    taker.handle_message(12.0, "vehicle", MissionCount(4))
    for k in range(3):
        assert taker.completed_fraction == pytest.approx(k / 4)
        taker.handle_message(12.1, "vehicle", mission(4)[k])
