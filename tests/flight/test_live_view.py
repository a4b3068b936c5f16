"""Live views: the flight never waits for a viewer, and a failed viewer does not end it."""

import time
from types import SimpleNamespace

import numpy as np

from mufly.flight import FlightRecorder
from mufly.flight.record.live_view import MAX_QUEUED_ROWS, LiveViewThread


class Viewer:
    """Publisher that keeps what it gets, after a pause; it fails on request."""

    def __init__(self, pause_s=0.0, fails=False):
        self.times, self.events, self.pause_s, self.fails, self.closed = [], [], pause_s, fails, False

    def publish_rows_and_events(self, rows, states, events):
        if self.fails and len(rows):
            raise OSError("the viewer has vanished")
        assert len(rows) == len(states)
        self.times += rows[:, 0].tolist()
        self.events += [e.text for e in events]
        time.sleep(self.pause_s)

    def close(self):
        self.closed = True


def make_flight():
    events = []
    flight = SimpleNamespace(recorder=FlightRecorder(None), log_event=lambda text, level="info": events.append(text))
    return flight, events


def fly(flight, count, period_s=0.005):
    row = np.zeros(flight.recorder.layout.column_count)
    for k in range(count):
        row[0] = k * period_s
        flight.recorder.append_row(row, "hover")


def wait_for(condition, timeout_s=10.0):
    until = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.01)


def test_rows_come_in_order_at_the_rate_of_the_view():
    flight, _ = make_flight()
    viewer = Viewer()
    view = LiveViewThread(flight, viewer, rate_Hz=50.0, name="viewer")
    fly(flight, 200)
    flight.recorder.add_event(0.5, "hover", "half")
    view.close()
    assert np.allclose(viewer.times, 0.02 * np.arange(50))
    assert viewer.events == ["half"]
    assert viewer.closed
    assert flight.recorder.views == []


def test_a_slow_viewer_loses_the_oldest_rows_and_delays_nothing():
    flight, _ = make_flight()
    viewer = Viewer(pause_s=0.3)
    view = LiveViewThread(flight, viewer, rate_Hz=200.0, name="viewer")
    began = time.monotonic()
    fly(flight, 5000)
    assert time.monotonic() - began < 5000 * 0.005 / 4  # 25 s of flight, while the viewer takes 0.3 s a batch
    assert len(view._rows) <= MAX_QUEUED_ROWS
    view.close()
    assert viewer.times[-1] == 4999 * 0.005
    assert len(viewer.times) < 5000


def test_a_viewer_that_vanishes_ends_its_view_alone():
    flight, events = make_flight()
    viewer = Viewer(fails=True)
    view = LiveViewThread(flight, viewer, rate_Hz=200.0, name="the view")
    fly(flight, 10)
    wait_for(lambda: viewer.closed)
    view.serve_requests()
    assert events == ["the view has ended: OSError: the viewer has vanished"]
    assert flight.recorder.views == []
    view.close()


def test_requests_run_in_the_loop_of_the_flight():
    flight, _ = make_flight()
    answers = []

    class Asker(Viewer):
        def publish_rows_and_events(self, rows, states, events):
            if not answers:
                answers.append(view.request_flight_action(lambda f: f is flight, wait=True))

    view = LiveViewThread(flight, Asker(), rate_Hz=50.0, name="viewer")

    def serve():
        view.serve_requests()
        return bool(answers)

    wait_for(serve)
    assert answers == [True]
    view.close()
