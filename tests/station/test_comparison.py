"""Two recordings on one clock: aligned by what happened, whatever their rates, clocks and signals."""

import math

import numpy as np
import pytest

from mufly.errors import ArgumentError
from mufly.station.page.page_session import StationSession
from mufly.station.recording_comparison import (
    RecordingComparison,
    difference_rows,
    draw_comparison,
    find_event_time,
    find_shared_signals,
)
from mufly.station.replay import FlightRecording


def hop(
    name: str, start_s: float, rate_Hz: float, up_s: float, *, source: str = "estimated", turn: float = 0.0
) -> FlightRecording:
    """A climb of 1 m in a second, ``up_s`` after the start; motors run half a second before; the nose
    turns."""
    t = start_s + np.arange(0.0, 10.0, 1.0 / rate_Hz)
    since = t - start_s - up_s
    yaw = np.arctan2(np.sin(0.5 * since + turn), np.cos(0.5 * since + turn))
    columns = {
        f"{source}_position_N": 0.2 * since,
        f"{source}_position_D": -np.clip(since, 0.0, 1.0),
        f"{source}_attitude_yaw": yaw,
        "motor_input_upper": np.where(since > -0.5, 0.6, 0.0),
    }
    units = {f"{source}_position_N": "m", f"{source}_position_D": "m", f"{source}_attitude_yaw": "rad"}
    states = np.full(len(t), "")
    return FlightRecording(name, t, columns, units | {"motor_input_upper": "1"}, states, (), None, np.zeros(0), 1.0, {})


A, B = hop("a.mcap", 0.0, 100.0, 2.0), hop("b.ulg", 5000.0, 30.0, 3.5, source="measured")


def test_take_off_arming_and_start_coincide() -> None:
    assert find_event_time(A, "take-off") == pytest.approx(2.1, abs=0.02)
    assert find_event_time(A, "arming") == pytest.approx(1.5, abs=0.02)
    assert RecordingComparison(A, B).total_shift_s == pytest.approx(-5001.5, abs=0.06)
    assert RecordingComparison(A, B, "arming").total_shift_s == pytest.approx(-5001.5, abs=0.06)
    assert RecordingComparison(A, B, "start", 0.25).total_shift_s == pytest.approx(-4999.75)
    assert RecordingComparison(A, B, "clock", -1.0).total_shift_s == -1.0


def test_another_source_rate_and_clock_fall_on_the_first() -> None:
    c = RecordingComparison(A, B)
    assert c.find_counterpart("estimated_position_N") == "measured_position_N"
    for row in difference_rows(c, ["estimated_position_N", "estimated_attitude_yaw"]):
        assert row["rms"] < {"m": 0.02, "deg": 2.0}[row["units"]]
    assert c.second_recording_track().shape == (len(B.times_s), 3)
    assert find_shared_signals(c)["position"] == ["estimated_position_N", "estimated_position_D"]


def test_beyond_its_ends_in_gaps_and_without_a_signal_there_is_nothing() -> None:
    late = hop("late", 0.0, 50.0, 2.0)
    late.columns["estimated_position_N"][100:200] = math.nan  # 2 to 4 s
    c = RecordingComparison(A, late, "clock", 1.0)
    n = c.sample_second_recording("estimated_position_N", np.array([0.5, 2.0, 4.0, 6.0, 30.0]))
    assert np.isnan(n).tolist() == [True, False, True, False, True]
    assert np.isnan(c.sample_second_recording("battery_voltage", A.times_s)).all()
    with pytest.raises(ArgumentError, match="not in both recordings"):
        find_shared_signals(c, ["battery_voltage"])


def test_who_never_took_off_is_aligned_by_the_start_and_that_is_said() -> None:
    still = hop("still.mcap", 100.0, 50.0, 1e3)
    c = RecordingComparison(A, still)
    assert c.alignment_note == "no take-off in still.mcap: aligned by the start"
    assert c.total_shift_s == -100.0
    with pytest.raises(ArgumentError, match="is not an event"):
        RecordingComparison(A, still, "noon")


def test_angles_differ_by_less_than_half_a_turn() -> None:
    """Nearly half a turn to the left and to the right are close to each other."""
    c = RecordingComparison(A, hop("turned", 0.0, 100.0, 2.0, turn=math.radians(3.0)), "clock")
    (row,) = difference_rows(c, ["estimated_attitude_yaw"])
    assert row["rms"] == pytest.approx(3.0, abs=0.2)
    figure = draw_comparison(c, ["estimated_attitude_yaw"])
    (ax,) = figure.axes
    one, two = (line.get_ydata() for line in ax.get_lines())
    assert np.nanmax(np.abs(np.asarray(one) - np.asarray(two))) < 4.0
    assert "(deg)" in ax.get_ylabel()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a.mcap", "turned"]


def test_a_window_gets_the_second_on_the_first_ones_clock(tmp_path) -> None:
    view = StationSession(lambda: [], tmp_path).open_view("one")
    view.compare_recording(B)
    assert view.shown_comparison() is None  # over what?
    view.show_recording(A)
    assert view.replay is not None
    view.compare_recording(B, "arming", 0.5)
    view.replay.seek(9.0)
    times, values = view.replay.history.recent_rows(30.0, ["estimated_position_N", "compared/estimated_position_N"])
    k = int(np.searchsorted(times, 5.0))
    assert values[k, 0] - values[k, 1] == pytest.approx(0.1, abs=0.02)
    told = view.status_fields()["compared"]
    assert (told["name"], told["by"], told["offset"], told["note"]) == ("b.ulg", "arming", 0.5, "")
    view.close_recording()
    assert view.status_fields()["compared"] is None
