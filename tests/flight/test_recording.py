"""Names, layout, reader and CSV."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.flight import FlightRecorder
from mufly.logs import (
    LogWarning,
    McapWriter,
    RecordingLayout,
    make_flight_row_layout,
    read_events,
    read_recording,
    rows_to_dataset,
    write_recording_csv,
)
from mufly.quantities.quantity_table import quantities_recorded_in


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, short_flight):
    """A finished recording of six seconds, its bytes, and where its chunks of rows end."""
    path = tmp_path_factory.mktemp("recorded") / "flight.mcap"
    chunk_ends = []
    with FlightRecorder(path, {"vehicle": "mufly-1.1"}, layout=short_flight.layout) as recorder:
        for k, (row, state) in enumerate(zip(short_flight.rows, short_flight.states, strict=True)):
            before = path.stat().st_size
            recorder.append_row(row, state)
            if path.stat().st_size > before:
                chunk_ends.append((path.stat().st_size, k))
        recorder.set_outcome("succeeded")
    return path.read_bytes(), chunk_ends


def test_the_columns_follow_the_table_without_gaps():
    layout = make_flight_row_layout(5)
    following = 1
    for quantity in quantities_recorded_in("flight"):
        part = layout.column_slices[quantity.name]
        assert part.start == following
        following = part.stop
    assert layout.column_count == following
    assert layout.column_slices["range"] == slice(layout.column_count - 5, layout.column_count)


def test_the_layout_survives_as_text():
    layout = make_flight_row_layout(3)
    assert RecordingLayout.from_json(layout.to_json()) == layout


def test_a_torn_topic_is_refused():
    first, *rest = quantities_recorded_in("flight")
    with pytest.raises(ValueError, match="be neighbours"):
        RecordingLayout((*rest, first), 8)


def test_the_dataset_has_the_contracts_names_dims_and_units(flight):
    data = flight.dataset()
    assert data.truth_position.dims == ("time", "axis")
    assert data.measured_attitude.dims == ("time", "angle")
    assert data.truth_rates.dims == ("time", "rate")
    assert data.truth_rotor_speed.dims == ("time", "rotor")
    assert data.servo_input.dims == ("time", "servo")
    assert data.range.dims == ("time", "beam")
    assert data.battery_voltage.dims == ("time",)
    assert data.axis.values.tolist() == ["N", "E", "D"]
    assert data.rotor.values.tolist() == ["upper", "lower"]
    assert data.truth_velocity.attrs["units"] == "m/s"
    assert data.truth_position.sel(axis="D").values == pytest.approx(flight.rows[:, 3])
    assert all("long_name" in variable.attrs for name, variable in data.items() if "event" not in name)
    assert read_events(data) == flight.events


def test_a_cut_at_any_byte_loses_at_most_the_last_second(tmp_path, recorded, short_flight):
    data, chunk_ends = recorded
    path = tmp_path / "cut.mcap"

    @settings(max_examples=150, deadline=None)
    @given(st.integers(0, len(data) - 1))
    def check(size):
        path.write_bytes(data[:size])
        whole = [rows for end, rows in chunk_ends if end <= size]
        if not whole:
            # Nothing but the file's head, or a first chunk without its index, which may do already.
            try:
                read_recording(path)
            except InputError:
                return
        back = read_recording(path)
        assert back.attrs["complete"] is False
        assert back.attrs["vehicle"] == "mufly-1.1"
        n = back.sizes["time"]
        assert n >= (whole[-1] if whole else 1)
        np.testing.assert_array_equal(back.time, short_flight.rows[:n, 0])
        np.testing.assert_array_equal(
            back.servo_input, short_flight.rows[:n, short_flight.layout.column_slices["servo_input"]]
        )

    check()


def test_the_chunks_of_the_test_above_are_a_second_long(recorded, short_flight):
    times = [short_flight.rows[rows, 0] for _, rows in recorded[1]]
    assert np.diff(times) == pytest.approx(1.0)
    assert len(times) == 5


def test_a_chunk_whose_kind_is_damaged_costs_its_own_rows_and_is_told(tmp_path, recorded, short_flight):
    data, chunk_ends = recorded
    path = tmp_path / "bad.mcap"
    for place in (k for k in range(chunk_ends[0][0] - 2000, len(data) - 9) if data[k] == 0x06):
        length = int.from_bytes(data[place + 1 : place + 9], "little")
        if data[place + 9 + length : place + 10 + length] == b"\x07":  # a chunk, which its index follows
            path.write_bytes(data[:place] + b"\x07" + data[place + 1 :])
            with pytest.warns(LogWarning, match=r"bad\.mcap: is damaged, cut off or still being written"):
                back = read_recording(path)
            assert 20 <= back.sizes["time"] < len(short_flight.rows)
            assert back.attrs["complete"] is False
            kept = np.isin(short_flight.rows[:, 0], back.time)
            np.testing.assert_array_equal(back.time, short_flight.rows[kept, 0])
            assert kept.sum() == len(kept) - 20
            return
    raise AssertionError("no chunk found")


def test_a_wrong_byte_anywhere_never_gives_wrong_numbers(tmp_path, recorded, short_flight):
    data, _ = recorded
    path = tmp_path / "bad.mcap"

    @settings(max_examples=150, deadline=None)
    @given(st.integers(8, len(data) - 1), st.integers(1, 255))
    def check(place, change):
        damaged = bytearray(data)
        damaged[place] ^= change
        path.write_bytes(damaged)
        try:
            back = read_recording(path)
        except InputError:
            return
        n = back.sizes["time"]
        kept = np.isin(short_flight.rows[:, 0], back.time)
        assert kept.sum() == n
        assert back.attrs["complete"] is False or n == len(kept)
        for name, columns in short_flight.layout.column_slices.items():
            stored = back[name].values.reshape(n, -1)
            np.testing.assert_array_equal(stored, short_flight.rows[kept][:, columns])
        assert back.attrs["vehicle"] == "mufly-1.1"
        assert back.attrs.get("outcome", "succeeded") == "succeeded"

    check()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"time,north\n0,1\n", "is not an MCAP file"),
        (b"\x89MCAP0\r\n", "not a recording of mufly"),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line(tmp_path, content, message):
    path = tmp_path / "flight.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as refusal:
        read_recording(path)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_recording(tmp_path / "none.mcap")


def test_another_programs_mcap_is_refused(tmp_path):
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        file = McapWriter(stream, "other")
        file.write_chunk([(file.add_channel("/x", "x", b"{}"), 0, b"{}")])
        file.finish_file()
    with pytest.raises(InputError, match="not a recording of mufly"):
        read_recording(path)


def test_a_recording_without_rows_is_refused(tmp_path):
    with FlightRecorder(tmp_path / "flight.mcap"):
        pass
    with pytest.raises(InputError, match="contains no rows"):
        read_recording(tmp_path / "flight.mcap")


def test_csv_has_units_and_every_digit(tmp_path, short_flight):
    rows = short_flight.rows.copy()
    rows[4, short_flight.layout.column_slices["battery_current"]] = np.nan
    data = rows_to_dataset(rows, short_flight.states, short_flight.layout)
    with write_recording_csv(data, tmp_path / "flight.csv").open(encoding="utf-8") as stream:
        header, *lines = csv.reader(stream)
    assert header[:2] == ["time [s]", "truth_position_N [m]"]
    assert {"truth_attitude_yaw [rad]", "truth_rates_r [rad/s]", "motor_input_upper", "servo_input_2"} < set(header)
    assert {"range_7 [m]", "battery_voltage [V]", "battery_charge", "mission_state"} < set(header)
    assert len(lines) == len(rows)
    column = header.index("battery_current [A]")
    assert lines[4][column] == ""
    back = np.array([[float(cell or "nan") for cell in line[:-1]] for line in lines])
    np.testing.assert_array_equal(back, rows)
    assert [line[-1] for line in lines] == short_flight.states


def test_the_documentation_lists_the_table():
    page = (Path(__file__).parents[2] / "docs" / "reference" / "recordings.md").read_text(encoding="utf-8")
    layout = make_flight_row_layout(8)
    for q in quantities_recorded_in("flight"):
        part = layout.column_slices[q.name]
        columns = f"{part.start}-{part.stop - 1}" if part.stop - part.start > 1 else f"{part.start}"
        units = "-" if q.units == "1" else q.units
        line = f"| `{q.name}` | {columns} | {q.dim or '-'} | {units} | `{q.topic}` `.{q.field}` | {q.long_name} |"
        assert line in page.splitlines()
