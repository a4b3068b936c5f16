"""The memory of a station: rows come out as they went in, and it does not grow."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.quantities.quantity_table import parse_column_name
from mufly.station import SignalHistory
from mufly.station.signal_history import PresentSignals


@given(n=st.integers(0, 300), since=st.floats(-1.0, 4.0))
def test_it_gives_back_the_newest_rows_that_fit_and_none_before_the_time_asked_for(n, since):
    history = SignalHistory(seconds=1.0, rate_Hz=100.0)
    for k in range(n):
        history.append_row(0.01 * k, np.full(len(history.names), k))
    times, values = history.rows_since(since, ["range_3", "truth_position_N"])
    kept = np.arange(max(0, n - 100), n)
    kept = kept[0.01 * kept > since]
    np.testing.assert_allclose(times, 0.01 * kept)
    np.testing.assert_array_equal(values, np.column_stack([kept, kept]))
    assert len(history) == min(n, 100)


def test_memory_is_allocated_once():
    history = SignalHistory(seconds=1.0)
    before = history._values.nbytes
    held = history._values
    names = history.names[:1]
    for k in range(1050):
        history.append_row(float(k), np.zeros(len(history.names)))
        assert history.rows_since(-np.inf, names)[0][0] == max(0, k - 99)
    assert history._values is held
    assert before == 100 * (len(history.names) + 1) * 4
    assert history.newest_s == 1049.0
    # Ten minutes, unless it is said otherwise.
    assert SignalHistory(rate_Hz=0.5)._size == 300
    assert SignalHistory(seconds=1.0)._size == 100


def test_rows_out_of_order_are_left_out():
    history = SignalHistory(seconds=1.0)
    for t in (1.0, 2.0, 2.0, 1.5, np.nan, 3.0):
        history.append_row(t, np.zeros(len(history.names)))
    assert history.rows_since(0.0)[0].tolist() == [1.0, 2.0, 3.0]


def test_what_it_returns_is_a_copy():
    history = SignalHistory(seconds=1.0)
    history.append_row(1.0, np.ones(len(history.names)))
    history.rows_since(0.0)[1][:] = 5.0
    assert (history.recent_rows(10.0)[1] == 1.0).all()


def test_an_empty_history_answers():
    history = SignalHistory(seconds=1.0)
    times, values = history.recent_rows(5.0, ["battery_voltage"])
    assert times.shape == (0,)
    assert values.shape == (0, 1)
    assert np.isnan(history.newest_s)


def test_signals_are_named_as_in_a_recording_and_have_units():
    history = SignalHistory(seconds=1.0)
    assert history.signal_unit("estimated_attitude_roll") == "rad"
    assert history.signal_unit("battery_voltage") == "V"
    ours = [name for name in history.names if not name.startswith("link_")]
    assert all(parse_column_name(name) is not None for name in ours)
    history.append_row(1.0, np.ones(len(history.names)))
    assert np.isnan(history.rows_since(0.0, ["no_such_signal"])[1]).all()


def test_what_is_told_seldom_is_believed_longer_and_a_heading_is_carried_on_past_north():
    present = PresentSignals(SignalHistory(seconds=1.0))
    for group, name in (("motion", "estimated_attitude_yaw"), ("battery", "battery_voltage")):
        assert present.accept_message(100.0, group)
        present.set_value(group, present.index_by_signal[name], 3.0)
    assert present.forget_stale(101.4) == []
    assert present.forget_stale(101.6) == ["motion"]
    assert np.isnan(present["estimated_attitude"][2])
    assert present.forget_stale(105.9) == []
    assert present["battery_voltage"] == 3.0
    assert present.forget_stale(106.1) == ["battery"]
    assert np.isnan(present["battery_voltage"])
    for turned in np.arange(0.0, 20.0, 0.5):  # three turns, told from -pi to pi
        present.set_value(
            "motion",
            present.index_by_signal["estimated_attitude_yaw"],
            np.remainder(turned + np.pi, 2 * np.pi) - np.pi,
        )
        assert present["estimated_attitude"][2] == pytest.approx(turned)
