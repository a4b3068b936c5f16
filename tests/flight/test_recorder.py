"""The writer: what is on disk, when, and how it ends."""

import os
import signal
import struct
import subprocess
import sys
import textwrap
from io import BytesIO

import numpy as np
import orjson
import pytest
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, MessageIndex

from mufly.errors import InputError, MuflyError
from mufly.flight import FlightRecorder
from mufly.logs import make_flight_row_layout, read_attachments, read_log, read_mcap, read_recording, write_log
from mufly.world import Box, Cylinder, World

START_NS = 1_700_000_000_000_000_000


def record(path, flight, stop=None, **options):
    with FlightRecorder(path, {"vehicle": "mufly-1.1", "seed": 7}, layout=flight.layout, **options) as recorder:
        events = list(flight.events)
        for row, state in zip(flight.rows[:stop], flight.states, strict=False):
            while events and events[0].time_s <= row[0]:
                recorder.add_event(*events.pop(0))
            recorder.append_row(row, state)
        recorder.set_outcome("succeeded", "landed", battery_at_end=0.9)
    return recorder


def test_what_is_written_comes_back_to_the_bit(tmp_path, flight):
    recorder = record(tmp_path / "flight.mcap", flight)
    back = read_recording(tmp_path / "flight.mcap")
    assert back.identical(recorder.to_dataset())
    for name, columns in flight.layout.column_slices.items():
        stored = back[name].values.reshape(len(flight.rows), -1)
        assert stored.tobytes() == np.ascontiguousarray(flight.rows[:, columns]).tobytes()
    assert back["mission_state"].values.tolist() == flight.states
    assert back.attrs["outcome"] == "succeeded"
    assert back.attrs["reason"] == "landed"
    assert back.attrs["battery_at_end"] == 0.9
    assert back.attrs["seed"] == 7
    assert back.attrs["complete"] is True


def test_memory_only_gives_the_same_dataset(tmp_path, flight):
    on_disk = record(tmp_path / "flight.mcap", flight, start_time_ns=START_NS).to_dataset()
    in_memory = record(None, flight, start_time_ns=START_NS).to_dataset()
    assert in_memory.identical(on_disk)


def test_the_mcap_library_reads_the_file_and_finds_every_checksum_right(tmp_path, flight):
    record(tmp_path / "flight.mcap", flight, start_time_ns=START_NS)
    with (tmp_path / "flight.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        counts = dict.fromkeys((c.topic for c in summary.channels.values()), 0)
        for _schema, channel, message in reader.iter_messages():
            counts[channel.topic] += 1
            assert isinstance(orjson.loads(message.data), dict)
    n = len(flight.rows)
    for topic in (*flight.layout.quantities_by_topic, "/mission", "/tf", "/reference_pose"):
        assert counts[topic] == n
    assert counts["/events"] == len(flight.events)
    assert counts["/scene"] == 1
    assert summary.statistics.message_count == sum(counts.values())
    assert summary.statistics.chunk_count == len(summary.chunk_indexes)


def test_the_index_points_at_every_message(tmp_path, flight):
    path = tmp_path / "flight.mcap"
    record(path, flight)
    data = path.read_bytes()

    def content(offset, opcode, inside=data):
        assert inside[offset] == opcode
        return inside[offset + 9 : offset + 9 + int.from_bytes(inside[offset + 1 : offset + 9], "little")]

    def stream(offset, opcode):
        return ReadDataStream(BytesIO(content(offset, opcode)))

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    for index in summary.chunk_indexes:
        chunk = Chunk.read(stream(index.chunk_start_offset, Opcode.CHUNK))
        plain = zstandard.decompress(chunk.data)
        for channel, offset in index.message_index_offsets.items():
            for time_ns, place in MessageIndex.read(stream(offset, Opcode.MESSAGE_INDEX)).records:
                number, _, stamp = struct.unpack_from("<HIQ", content(place, Opcode.MESSAGE, plain))
                assert (number, stamp) == (channel, time_ns)
                assert index.message_start_time <= time_ns <= index.message_end_time


def test_messages_match_their_schemas_and_the_viewers_subset_of_json_schema(tmp_path, flight):
    # Foxglove refuses unions of types and anything but these; PlotJuggler needs none.
    def conforms(schema, value, where):
        kind = schema["type"]
        assert kind in ("object", "array", "number", "integer", "string", "boolean"), where
        if kind == "object":
            assert set(value) >= set(schema["required"]), where
            for key, part in schema["properties"].items():
                conforms(part, value[key], f"{where}.{key}")
        elif kind == "array":
            for item in value:
                conforms(schema["items"], item, f"{where}[]")
        else:
            types = {"number": (int, float, type(None)), "integer": int, "string": str, "boolean": bool}
            assert isinstance(value, types[kind]), where

    world = World((Box((1, 1, -0.5), (1, 1, 1), 0.3),), (Cylinder((-1, 1), 0.2, 1.5),))
    view = {"waypoints": flight.waypoints, "world": world, "rotor_radius": 0.0875}
    record(tmp_path / "flight.mcap", flight, stop=200, scene_view=view)
    seen = set()
    with (tmp_path / "flight.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema.encoding == "jsonschema"
            assert channel.message_encoding == "json"
            conforms(orjson.loads(schema.data), orjson.loads(message.data), channel.topic)
            seen.add(schema.name)
    assert {"foxglove.Log", "foxglove.FrameTransforms", "foxglove.SceneUpdate", "foxglove.PoseInFrame"} < seen


def test_the_3d_view_puts_the_helicopter_where_the_truth_is(tmp_path, flight):
    record(tmp_path / "flight.mcap", flight)
    messages = read_mcap(tmp_path / "flight.mcap").messages_by_topic["/tf"]
    columns = flight.layout.column_slices
    for k in (0, 77, len(flight.rows) - 1):
        world, body = orjson.loads(messages[k][1])["transforms"]
        assert (world["parent_frame_id"], body["parent_frame_id"]) == ("world", "ned")
        position = flight.rows[k, columns["truth_position"]]
        assert list(body["translation"].values()) == pytest.approx(position, abs=1e-6)
        assert sum(v * v for v in body["rotation"].values()) == pytest.approx(1.0, abs=1e-5)


def test_every_second_reaches_the_disk_before_the_end(tmp_path, flight):
    path = tmp_path / "flight.mcap"
    with FlightRecorder(path, layout=flight.layout) as recorder:
        for row, state in zip(flight.rows[:400], flight.states, strict=False):
            recorder.append_row(row, state)
            if row[0] > 1.0:
                on_disk = len(read_mcap(path).messages_by_topic["/truth"]) if row[0] % 0.5 < 0.02 else None
                if on_disk is not None:
                    assert row[0] - flight.rows[on_disk, 0] <= 1.0


def test_a_killed_program_leaves_all_but_the_last_second(tmp_path):
    path = tmp_path / "flight.mcap"
    program = f"""
        import os, signal
        import numpy as np
        from mufly.flight.record.recorder import FlightRecorder
        recorder = FlightRecorder({str(path)!r})
        row = np.zeros(recorder.layout.column_count)
        for k in range(351):
            row[:] = k
            row[0] = 0.01 * k
            recorder.append_row(row, "hover")
        os.kill(os.getpid(), signal.SIGKILL)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], env=os.environ, check=False)
    assert done.returncode == -signal.SIGKILL
    back = read_recording(path)
    assert back.attrs["complete"] is False
    assert "outcome" not in back.attrs
    assert 2.5 <= back.time.values[-1] <= 3.5
    assert back["range"].values[-1, 0] == pytest.approx(100 * back.time.values[-1])
    # Other people's readers take it for what it is: a whole file, if without an index.
    with path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_summary() is None
        times = [m.log_time for _, channel, m in reader.iter_messages() if channel.topic == "/ranges"]
        assert len(times) == back.sizes["time"]
    # Converting it is mending it: it has an index.
    whole = tmp_path / "whole.mcap"
    write_log(read_log(path), whole)
    with whole.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 0
    np.testing.assert_array_equal(read_log(whole)["range"], back["range"])


@pytest.mark.parametrize(
    ("error", "outcome", "reason"),
    [(KeyboardInterrupt(), "interrupted", ""), (ValueError("no lift"), "crashed", "no lift")],
)
def test_an_exception_finishes_the_file_and_goes_on(tmp_path, flight, error, outcome, reason):
    path = tmp_path / "flight.mcap"

    def fly():
        with FlightRecorder(path, layout=flight.layout) as recorder:
            for row in flight.rows[:75]:
                recorder.append_row(row, "hover")
            raise error

    with pytest.raises(type(error)):
        fly()
    back = read_recording(path)
    assert back.sizes["time"] == 75
    assert back.attrs["complete"] is True
    assert (back.attrs["outcome"], back.attrs["reason"]) == (outcome, reason)


def test_a_half_written_chunk_is_written_over(tmp_path, flight):
    # What an interrupt in the middle of a write leaves behind the last whole record.
    path = tmp_path / "flight.mcap"
    with FlightRecorder(path, layout=flight.layout) as recorder:
        for k, row in enumerate(flight.rows[:150]):
            recorder.append_row(row, "hover")
            if k == 100:
                recorder._stream.write(b"\x06 half a chunk")
    back = read_recording(path)
    assert back.attrs["complete"] is True
    assert back.sizes["time"] == 150


def test_not_a_number_survives_and_infinity_becomes_it(tmp_path):
    layout = make_flight_row_layout(2)
    rows = np.full((3, layout.column_count), np.nan)
    rows[:, 0] = [0.0, 0.5, 5e-324 + 1.0]
    rows[0, 1:] = [-0.0, 5e-324, 1.7976931348623157e308, 0.1] + [1 / 3] * (layout.column_count - 5)
    rows[1, 3] = np.inf
    with FlightRecorder(tmp_path / "flight.mcap", layout=layout) as recorder:
        for row in rows:
            recorder.append_row(row, 'odd "state" \\ ä')
    back = read_recording(tmp_path / "flight.mcap")
    assert back.truth_position.values[0].tobytes() == rows[0, 1:4].tobytes()
    assert np.isnan(back.truth_position.values[1:]).all()
    assert np.isnan(back.battery_voltage.values[1:]).all()
    assert set(back.mission_state.values) == {'odd "state" \\ ä'}


def test_many_rows_within_a_second_are_all_kept(tmp_path):
    layout = make_flight_row_layout(8)
    row = np.zeros(layout.column_count)
    with FlightRecorder(tmp_path / "flight.mcap", layout=layout) as recorder:
        for k in range(3000):
            row[0] = k * 1e-4
            recorder.append_row(row, "hover")
    np.testing.assert_array_equal(read_recording(tmp_path / "flight.mcap").time, np.arange(3000) * 1e-4)


def test_attachments_come_back(tmp_path, flight):
    files = {"mission.toml": "# späte Mission\n", "vehicle.toml": b"mass = 1\n"}
    record(tmp_path / "flight.mcap", flight, stop=10, attachments=files)
    back = read_attachments(tmp_path / "flight.mcap")
    assert back == {"mission.toml": "# späte Mission\n".encode(), "vehicle.toml": b"mass = 1\n"}


def test_time_must_go_forward(tmp_path):
    path = tmp_path / "flight.mcap"

    def fly():
        with FlightRecorder(path) as recorder:
            row = np.zeros(recorder.layout.column_count)
            for time_s in (0.1, 0.3, 0.2, 0.4):
                row[0] = time_s
                recorder.append_row(row, "hover")

    with pytest.raises(MuflyError, match=r"0\.2 s follows 0\.3 s"):
        fly()


def test_a_file_that_cannot_be_made_is_named_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file/x\.mcap: cannot be written"):
        FlightRecorder(tmp_path / "file" / "x.mcap")


def test_an_attribute_that_json_cannot_hold_is_named(tmp_path):
    with pytest.raises(InputError, match=r"wind: cannot be recorded"):
        FlightRecorder(tmp_path / "x.mcap", {"wind": object()})


def test_closing_twice_changes_nothing(tmp_path, flight):
    recorder = record(tmp_path / "flight.mcap", flight, stop=60)
    before = (tmp_path / "flight.mcap").read_bytes()
    recorder.close()
    assert (tmp_path / "flight.mcap").read_bytes() == before


def test_the_same_flight_gives_the_same_bytes(tmp_path, flight):
    for name in ("a.mcap", "b.mcap"):
        record(tmp_path / name, flight, start_time_ns=START_NS)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
