"""The log of a board: a power cut loses at most a second, and no fault of the device stops a period."""

from __future__ import annotations

import io
import shutil

import numpy as np
import pytest
from board_station import Station
from pymavlink.dialects.v20 import common as mavlink
from pyulog import ULog
from typer.testing import CliRunner

from mufly.cli import app
from mufly.control import design_flight_controller
from mufly.firmware.emulated.image_build import build_host_board
from mufly.logs import read_log
from mufly.logs.block_log import split_image_into_sessions
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler: install gcc or clang"
)
RATE = 200
ROW_BYTES = 123
BLOCK_MAGIC, FILLED, FAILED, WORN = 0x676F6C6D, 1, 2, 4  # of block_log.h
HEADER = bytes(16)  # of a ULog file


@pytest.fixture(scope="module")
def library():
    vehicle = load_vehicle("mufly-1.1")
    return build_host_board(vehicle, design_flight_controller(vehicle), load_mission("demonstration"), single=False)


class Device:
    """A block device with its faults, and the log on it."""

    def __init__(self, library, blocks=256, noise=1, worn=None, **faults) -> None:
        self.ffi, self.lib = library
        self.array = np.zeros((blocks, 128), np.uint32)
        self.model = self.ffi.new("block_model_t *", {"blocks": blocks, "noise": noise, "cut_after": -1, **faults})
        self.model.words = self.ffi.cast("uint32_t *", self.ffi.from_buffer(self.array))
        self.worn = np.zeros(blocks, np.uint8) if worn is None else worn
        self.model.worn = self.ffi.cast("uint8_t *", self.ffi.from_buffer(self.worn))
        self.log = self.ffi.new("block_log_t *")
        self.messages: list[tuple[int, bytes]] = []
        self.begun = False

    def start(self, cut_after=-1) -> None:
        self.lib.block_model_attach(self.model)
        self.lib.block_model_start(self.model)
        self.model.operations, self.model.cut_after = 0, cut_after
        self.lib.block_log_start(self.log)
        self.messages, self.begun = [], False

    def step(self, k, every=4, may_work=True) -> None:
        """Run a period; every fourth a message is appended: its number, as a ULog message."""
        if not self.begun:
            self.begun = self.lib.block_log_append(self.log, HEADER, len(HEADER), True)
        elif k % every == 0:
            count = len(self.messages)
            message = (ROW_BYTES - 3).to_bytes(2, "little") + b"D" + count.to_bytes(4, "little") + bytes(ROW_BYTES - 7)
            if self.lib.block_log_append(self.log, message, ROW_BYTES, True):
                self.messages.append((k, message))
        self.lib.block_log_step(self.log, may_work)

    def run(self, periods, **options) -> int:
        """Run until the power is cut; return the period of the cut."""
        for k in range(periods):
            if self.model.is_off:
                return k
            self.step(k, **options)
        assert self.model.outside == 0  # no place is asked for that the device has not
        return periods

    def latest(self):
        return split_image_into_sessions(self.array.tobytes())[-1]

    def kept(self) -> list[int]:
        """Return the numbers of the messages of the latest session, whole and in order."""
        data = self.latest().ulog[len(HEADER) :]
        rows = [data[k : k + ROW_BYTES] for k in range(0, len(data) - ROW_BYTES + 1, ROW_BYTES)]
        assert all(r == self.messages[int.from_bytes(r[3:7], "little")][1] for r in rows)
        return [int.from_bytes(r[3:7], "little") for r in rows]


@pytest.mark.parametrize(("caches", "write_polls"), [(False, 0), (True, 0), (True, 3)])
def test_a_power_cut_at_every_write_loses_at_most_a_second(library, caches, write_polls) -> None:
    whole = Device(library, 128, caches=caches, write_polls=write_polls)
    whole.start()
    whole.run(900)
    assert whole.log.lost_messages <= 30  # those before the search was over
    assert whole.model.operations > 40
    for cut in range(whole.model.operations):
        device = Device(library, 128, noise=cut + 1, caches=caches, write_polls=write_polls)
        device.start(cut)
        off = device.run(900)
        sessions = split_image_into_sessions(device.array.tobytes())
        kept = device.kept() if sessions else []
        assert kept == sorted(set(kept))
        lost = [k for n, (k, _) in enumerate(device.messages) if n not in kept]
        assert not lost or off - lost[0] <= RATE, cut
        # The next start finds its place behind, and both sessions are there.
        before = sessions[-1].ulog if sessions else b""
        device.start()
        device.run(200)
        after = {s.number: s.ulog for s in split_image_into_sessions(device.array.tobytes())}
        assert len(device.kept()) > 5
        assert not sessions or after[sessions[-1].number] == before


def test_a_slow_trickle_is_on_the_device_within_a_third_of_a_second(library) -> None:
    """One message in two seconds, as on the floor: the next of four flushes a second writes each."""
    device = Device(library, caches=True)
    device.start()
    for k in range(3000):
        device.step(k, every=400)
        if k % 400 == RATE // 3 and device.messages:
            image = device.array.tobytes()
            assert len(split_image_into_sessions(image)[-1].ulog) == len(HEADER) + ROW_BYTES * len(device.messages)
    assert len(device.messages) > 5


def test_a_block_that_is_full_when_a_flush_is_due_is_flushed_alone(library) -> None:
    device = Device(library, caches=True)
    device.start()
    device.run(100)
    log, lib = device.log, device.lib
    assert lib.block_log_append(log, bytes(488 - log.fill), 488 - log.fill, True)
    for _ in range(200):
        if log.operation == 5:  # FLUSHES
            break
        lib.block_log_step(log, True)
    assert (log.operation, log.fill, log.full_count) == (5, 0, 0)


def test_blocks_are_filled_except_for_four_flushes_a_second(library) -> None:
    """Each flush closes a block before it is full; else the log wears and fills the device early."""
    device = Device(library)
    device.start()
    device.run(5 * RATE)
    filled = len(device.messages) * ROW_BYTES / 488  # bytes of payload of a block
    assert filled <= device.log.used_places <= filled + 4 * 5 + 8


def test_sessions_follow_each_other_round_the_device(library) -> None:
    device = Device(library, 100)
    for number in range(1, 60):
        device.start()
        device.run(300 + 7 * (number % 5))
        latest = device.latest()
        assert (latest.number, latest.missing_blocks, latest.has_begin) == (number, 0, True)
        assert device.kept() == list(range(len(device.kept())))
    numbers = [s.number for s in split_image_into_sessions(device.array.tobytes())]
    assert numbers == sorted(numbers)
    assert len(numbers) > 3


def test_a_full_log_is_reported_and_keeps_what_it_holds(library) -> None:
    device = Device(library, 80)
    device.start()
    device.run(4000)
    assert (device.log.state, device.log.faults) == (device.lib.BLOCK_LOG_FULL, FILLED)
    kept = device.kept()
    assert kept == list(range(len(kept)))
    assert len(kept) > 0.7 * 48 * 488 / ROW_BYTES  # blocks are closed early for each flush
    device.start()
    device.run(400)
    assert device.latest().number == 2


def test_worn_blocks_are_skipped_and_reported(library) -> None:
    rng = np.random.default_rng(3)
    for kind in (1, 2):
        worn = (kind * (rng.random(256) < 0.3)).astype(np.uint8)
        device = Device(library, worn=worn)
        device.start()
        device.run(1500)
        assert device.log.state == device.lib.BLOCK_LOG_WRITES
        assert device.log.bad_blocks > 5
        assert device.log.faults == WORN
        assert device.latest().missing_blocks == 0
        kept = device.kept()
        assert kept == list(range(len(kept)))
        assert len(kept) >= len(device.messages) - 60
    device = Device(library, worn=np.ones(256, np.uint8))
    device.start()
    device.run(600)
    assert device.log.faults & FAILED


@pytest.mark.parametrize(("blocks", "worn_count"), [(64, 9), (64, 16), (256, 16)])
def test_a_row_of_worn_blocks_hides_no_later_block_from_the_search(library, blocks: int, worn_count: int) -> None:
    """As many worn blocks in a row as the log bears; the next start goes on behind the latest block."""
    worn = np.zeros(blocks, np.uint8)
    worn[17 : 17 + worn_count] = 1
    device = Device(library, blocks, worn=worn)
    device.start()
    for k in range(2000):
        if device.log.state == device.lib.BLOCK_LOG_WRITES and device.log.place >= 20 + worn_count:
            break  # a few blocks behind the worn ones
        device.step(k)
    before = split_image_into_sessions(device.array.tobytes())
    device.start()
    device.run(300)
    assert device.log.session == 2
    after = split_image_into_sessions(device.array.tobytes())
    assert [s.ulog for s in after[:1]] == [s.ulog for s in before]
    assert len(after) == 2


def test_a_block_that_decays_later_costs_its_messages_only(library) -> None:
    device = Device(library)
    device.start()
    device.run(1200)
    all_of_it = device.kept()
    device.array[5, 40] ^= 0x10
    latest = device.latest()
    assert latest.missing_blocks == 1
    kept = device.kept()
    assert set(kept) < set(all_of_it)
    assert 3 <= len(all_of_it) - len(kept) <= 6
    device.array[0, 7] ^= 1
    assert not device.latest().has_begin


def test_a_device_that_refuses_or_is_silent_fails_in_two_seconds(library) -> None:
    for fault in ("refuses", "is_silent"):
        for at in (0, 500):  # in the search, and while writing
            device = Device(library)
            device.start()
            device.run(at)
            assert at == 0 or device.log.state == device.lib.BLOCK_LOG_WRITES
            setattr(device.model, fault, True)
            device.run(2 * RATE + 120)
            assert (device.log.state, device.log.faults) == (device.lib.BLOCK_LOG_FAILED, FAILED)
            assert not device.lib.block_log_append(device.log, b"x", 1, True)
    # Two seconds also where every fifth period appends a row and does not touch the device.
    device = Device(library)
    device.start()
    device.run(500)
    device.model.is_silent = True
    for k in range(2 * RATE + 20):
        device.step(k, may_work=k % 5 != 0)
    assert device.log.state == device.lib.BLOCK_LOG_FAILED
    device = Device(library, 8)
    device.start()
    device.run(300)
    assert device.log.state == device.lib.BLOCK_LOG_ABSENT
    # A device that takes 0.35 s for a block now and then loses nothing; the buffers hold 0.4 s.
    device = Device(library, 1024)
    device.start()
    for k in range(4000):
        device.model.write_polls = 70 if k % 400 == 399 else 0
        device.step(k)
        if k == 100:
            searched = device.log.lost_messages
    assert device.log.lost_messages == searched
    # One that is too slow loses messages, and says how many.
    device = Device(library, write_polls=60)
    device.start()
    device.run(2000)
    assert device.log.lost_messages > 100
    assert len(device.kept()) > 50  # and those that it took are whole


def test_a_message_is_taken_as_a_whole_or_not_at_all(library) -> None:
    """Appending stops with less room than a message needs, and the bytes that wait are not overwritten."""
    for first in (4, 100, 487, 488, 489):
        device = Device(library)
        device.start()
        device.run(200)
        kept, room = len(device.latest().ulog), device.lib.block_log_room(device.log)
        assert 5 * 488 < room <= 6 * 488
        taken = b""
        for number in range(60):
            size = (first if number == 0 else ROW_BYTES) - 3
            message = size.to_bytes(2, "little") + b"D" + bytes([number]) * size
            fits = device.lib.block_log_append(device.log, message, len(message), True)
            assert fits == (len(message) < room), number
            room -= len(message) if fits else 0
            assert device.lib.block_log_room(device.log) == room
            taken += message if fits else b""
        assert room <= ROW_BYTES
        for _ in range(200):
            device.lib.block_log_step(device.log, True)
        assert device.latest().ulog[kept:].endswith(taken)


def test_the_search_reads_every_stride_th_block_and_then_one_stride(library) -> None:
    """A start with 64 blocks takes 2 reads, and at most 63 more to pass the latest block by a stride of 32."""
    for periods in (0, 40, 300, 500, 700, 900):
        device = Device(library, 64)
        device.start()
        device.run(periods)
        written = bool(split_image_into_sessions(device.array.tobytes()))
        latest = device.log.place - 1
        device.start()
        reads = 0
        while device.log.state == device.lib.BLOCK_LOG_SEARCHES and reads < 100:
            device.lib.block_log_step(device.log, True)
            reads += device.log.operation != 0
        assert device.log.place == (latest + 1 if written else 0)
        assert reads == 2 + (latest % 32 + 32 if written else 0), periods


def test_the_search_bears_any_contents(library) -> None:
    rng = np.random.default_rng(1)
    for _ in range(60):
        device = Device(library, 64)
        device.array[:] = rng.integers(0, 2**32, device.array.shape, dtype=np.uint32)
        device.array[rng.random(64) < 0.5, 0] = BLOCK_MAGIC
        device.start()
        device.run(300)
        assert device.log.state == device.lib.BLOCK_LOG_WRITES
        assert (device.log.session, len(device.kept()) > 10) == (1, True)


def test_a_board_logs_names_units_and_texts_and_pyulog_reads_them(library, tmp_path) -> None:
    station = Station(library)
    board, r = station.board, station.board.record
    for k in range(600):
        station.step()
        if k >= 400:
            station.request.is_given = True
            station.request.given.armed = True
    image = tmp_path / "card.img"
    image.write_bytes(board.log_blocks[:200].tobytes())
    done = CliRunner().invoke(app, ["firmware", "log", str(image), "--out", str(tmp_path / "logs")])
    assert done.exit_code == 0, done.output
    file = tmp_path / "logs" / "session-0001.ulg"
    data = read_log(file)
    assert read_log(image).sizes == data.sizes
    assert data["estimated_position"].attrs["units"] == "m"
    assert data["servo_input"].dims == ("time", "servo")
    assert "ready for" in str(data["event_text"].values[0])
    assert set(data["mission_state"].values) == {"init"}
    steps = np.diff(data.time.values)
    assert abs(steps[-10:] - 0.02).max() < 1e-5  # armed
    assert abs(steps[0] - 1.0) < 1e-5
    place = list(r.belief.motion.position)
    assert data["estimated_position"].values[-1] == pytest.approx(place, abs=1e-4)
    (topic,) = ULog(str(file)).data_list
    assert topic.name == "table"
    assert len(topic.data["timestamp"]) == data.sizes["time"]
    # A level that no program sets counts as an error.
    entries = r.software.mission.log
    entries[r.software.mission.logged_event_count % len(entries)].level = 3
    r.software.mission.logged_event_count += 1
    for _ in range(600):
        station.step()
    (session,) = split_image_into_sessions(board.log_blocks[:200].tobytes())
    assert ULog(io.BytesIO(session.ulog)).logged_messages[-1].log_level == ord("3")
    # Faults of the log reach the station as text, and the board goes on.
    board.block_model.refuses = True
    station.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    station.heard.clear()
    for _ in range(200):
        station.step()
    said = [m.text for m in station.heard if m.get_type() == "STATUSTEXT"]
    assert any("the device fails" in t for t in said)
    done = CliRunner().invoke(app, ["firmware", "log", str(file), "--out", str(tmp_path / "logs")])
    assert "holds no log of a board" in str(done.exception)


def test_rows_that_a_slow_device_drops_are_noted_with_their_duration(library, tmp_path) -> None:
    station = Station(library)
    board, log = station.board, station.board.record.log
    station.request.is_given = station.request.given.armed = True
    for _ in range(400):
        station.step()
    assert log.dropped_rows == 0
    mission = station.board.record.software.mission
    board.block_model.write_polls = 150  # 0.75 s for a block
    for k in range(600):
        station.step()
        mission.logged_event_count += 20 * (k == 300)  # more entries than the log of the mission keeps
    assert log.dropped_rows > 20
    dropped = log.dropped_rows
    board.block_model.write_polls = 0
    for _ in range(400):
        station.step()
    assert log.dropped_rows == log.told_dropped_rows >= dropped
    assert log.texts_written == mission.logged_event_count
    (session,) = split_image_into_sessions(board.log_blocks[:300].tobytes())
    found = ULog(io.BytesIO(session.ulog))
    silent = np.diff(found.data_list[0].data["timestamp"]).max() / 1e6
    assert silent > 0.3
    assert sum(d.duration for d in found.dropouts) / 1e3 == pytest.approx(silent, abs=0.75)


def test_stamps_of_an_invalid_clock_are_zero(library) -> None:
    station = Station(library)
    for _ in range(300):
        station.step()
    ffi, record = station.ffi, station.board.record
    log = ffi.addressof(record, "log")
    vehicle = ffi.new("flight_log_vehicle_t *", {
        "belief": ffi.addressof(record, "belief"), "software": ffi.addressof(record, "software"),
        "acting": ffi.addressof(record, "acting"), "armed": True,
    })  # fmt: skip
    for time_s, stamp in ((2.5, 2_500_000), (0.0, 0), (-1.0, 0), (4e6, 0), (float("nan"), 0), (100.0, 100_000_000)):
        device = record.log.device
        for _ in range(400):  # until the block has room for both messages
            if device.fill < 200:
                break
            station.step()
        record.belief.time_s = time_s
        log.periods_to_row, before = 0, device.fill
        log.dropped_rows, log.told_dropped_rows, log.dropout_since_ms = 1, 0, 0  # a dropout is noted before the row
        buffer = device.buffers[(device.first + device.full_count) % len(device.buffers)]
        station.lib.flight_log_step(log, vehicle)
        data = bytes(ffi.buffer(buffer))[20 + before :]  # after the header of the block
        assert data[:3] == b"\2\0O"
        assert int.from_bytes(data[3:5], "little") == min(stamp // 1000, 0xFFFF)
        assert int.from_bytes(data[10:18], "little") == stamp, time_s


def test_a_device_that_refuses_one_operation_is_used_on(library) -> None:
    """A block that cannot be read back is written again at the next place, and a flush comes later."""
    device = Device(library)
    device.start()
    device.run(100)
    assert device.log.state == device.lib.BLOCK_LOG_WRITES
    log = device.log
    for k in range(400):  # until the block is written and not read back yet
        if log.operation == 3:
            break
        device.step(k)
    bad = log.bad_blocks
    device.model.refuses = True
    device.step(1)
    assert log.bad_blocks == bad + 1
    device.model.refuses = False
    device.run(200)
    refused = 0
    for k in range(400):  # after a block that is read back, the device is asked for a flush only
        before = log.bad_in_row
        device.model.refuses = log.operation == 4
        device.step(k)
        refused += log.bad_in_row > before
    assert refused > 1
    device.model.refuses = False
    device.run(400)
    assert log.state == device.lib.BLOCK_LOG_WRITES
    kept = device.kept()
    assert kept == list(range(len(kept)))
    # A device of which no block can be read fails in the search already.
    device = Device(library, 1024)
    device.start()
    device.model.refuses = True
    for k in range(40):
        device.step(k)
    assert (device.log.state, device.log.faults, device.log.session) == (device.lib.BLOCK_LOG_FAILED, FAILED, 0)
