"""Positions from outside: VISION_POSITION_ESTIMATE becomes the filter's position fix, or is refused in a line."""

import math

import numpy as np
import pytest
from link_rig import Rig, m

from mufly.errors import InputError
from mufly.flight import Flight
from mufly.link.vision_input import pack_pose_covariance, unpack_pose_covariance

UNKNOWN = [math.nan] + [0.0] * 20
GOOD = pack_pose_covariance(np.diag([1e-4, 1e-4, 1e-4, 1e-4]))


class Outside:
    """Somebody who sees where the vehicle is: late, by a clock of his own."""

    def __init__(self, rig, clock_s=0.0, late_s=0.1, triangle=GOOD):
        self.rig, self.clock_s, self.late_s, self.triangle = rig, clock_s, late_s, triangle
        self.station = rig.station("slam", system=1, component=197)
        self.rng = np.random.default_rng(2)
        self.waiting = []
        self.every_s, self.due_s = 0.05, 0.0
        self.off = np.zeros(4)

    def seen(self):
        t = self.rig.flight.truth
        return np.append(t.position, t.attitude[2]) + self.off

    def message(self, time_s, place, triangle=None):
        n, e, d, psi = (float(v) for v in place)
        usec = round((time_s + self.clock_s) * 1e6)
        given = self.triangle if triangle is None else triangle
        return m.MAVLink_vision_position_estimate_message(usec, n, e, d, math.nan, math.nan, psi, given, 0)

    def go(self, seconds):
        end_s = self.rig.now_s + seconds
        while self.rig.now_s < end_s:
            now_s = self.rig.flight.time_s
            if now_s >= self.due_s:
                self.due_s = now_s + self.every_s
                place = self.seen() + 0.005 * self.rng.standard_normal(4) * [1, 1, 1, 0.3]
                self.waiting.append((now_s + self.late_s, self.message(now_s, place)))
            while self.waiting and self.waiting[0][0] <= now_s:
                self.station.say(self.waiting.pop(0)[1])
            self.rig.tick()


def refused(outside, message):
    """What is said to a message."""
    outside.station.heard.clear()
    outside.station.say(message)
    outside.rig.run(0.1)
    return outside.station.words


@pytest.fixture(scope="module")
def flown():
    """It takes off and hovers on positions from outside, by the clock of the day; then they fail it."""
    outside = Outside(rig := Rig(sensors="fitted", seed=4, outside=True), clock_s=1.7e9)
    station = rig.station("ground")
    outside.go(3.0)
    station.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    outside.go(0.5)
    station.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0.8)
    outside.go(9.0)
    return outside, station


def test_it_flies_where_it_is_told_to_be(flown) -> None:
    outside, station = flown
    rig = outside.rig
    flight = rig.flight
    assert -flight.truth.position[2] == pytest.approx(0.8, abs=0.1), station.text
    assert np.hypot(*flight.truth.position[:2]) < 0.15
    assert "positions are received over the link from" in station.text
    fix = flight.readings["position_fix"]
    # By another clock the fastest message counts as if it had taken no time.
    assert fix.time_s == pytest.approx(flight.time_s, abs=outside.every_s + 0.02)
    assert fix.covariance is not None
    # What is told on says so, with its time and covariance.
    told = station.last("VISION_POSITION_ESTIMATE")
    assert unpack_pose_covariance(told.covariance) == pytest.approx(np.diag([1e-4] * 4), rel=1e-6)
    assert told.usec * 1e-6 <= flight.time_s


def test_what_is_insane_late_or_doubled_is_refused_in_a_line(flown) -> None:
    outside, _ = flown
    flight = outside.rig.flight
    outside.clock_s = 0.0  # the vehicle's own, as by TIMESYNC
    place, now_s = outside.seen(), flight.time_s
    outside.station.say(outside.message(now_s, place))
    assert flight.outside_fixes._last_s == pytest.approx(now_s, abs=1e-6)
    before = flight.outside_fixes._last_s
    nan, far = place.copy(), place.copy()
    nan[1], far[0] = math.nan, 5e3
    bad, wide, vague = np.diag([1e-4, -1e-4, 1e-4, 1e-4]), np.diag([1e-4] * 4), np.diag([0.3, 0.3, 0.1, 0.1])
    wide[0, 1] = wide[1, 0] = 1.0
    now_s += 0.004
    for message, why in (
        (outside.message(now_s, nan), "its numbers are not finite"),
        (outside.message(now_s, far), "its position is 5000 m from the origin"),
        (outside.message(now_s, place, pack_pose_covariance(bad)), "negative variance"),
        (outside.message(now_s, place, pack_pose_covariance(wide)), "not positive semidefinite"),
        (outside.message(now_s, place, pack_pose_covariance(vague)), "its position has a standard deviation of "
        "0.55 m, more than 0.2 m"),
        (outside.message(now_s - 1.5, place), "s old, more than 1 s"),
        (outside.message(now_s + 1.5, place), "ahead of the vehicle's"),
        (outside.message(before, place), "repeated, or older"),
    ):  # fmt: skip
        said = refused(outside, message)
        assert "position by link refused" in said, why
        assert why.replace(" ", "") in said.replace(" ", ""), said
    assert flight.outside_fixes._last_s == before
    # The same again says nothing more for a while.
    assert "refused" not in refused(outside, outside.message(now_s, nan))


def test_a_second_sender_is_refused_while_the_first_is_heard(flown) -> None:
    outside, _ = flown
    outside.go(0.2)
    last_s = outside.rig.flight.outside_fixes._last_s
    other = outside.rig.station("other", system=9, component=1)
    other.say(outside.message(outside.rig.flight.time_s, outside.seen()))
    outside.rig.run(0.1)
    assert "sends, too" in other.words
    assert outside.rig.flight.outside_fixes._last_s == last_s


def test_a_covariance_is_believed_by_the_filter() -> None:
    """A jump by 5 cm is much for fixes that say they are sharp, and little for vague ones."""
    ratio = {}
    for sigma in (0.005, 0.15):
        triangle = pack_pose_covariance(np.diag([sigma**2] * 3 + [1e-3]))
        outside = Outside(Rig(sensors="fitted", seed=4, outside=True), late_s=0.02, triangle=triangle)
        outside.go(2.5)
        outside.off[0] = 0.05
        outside.go(0.1)
        checks = outside.rig.flight.status.estimate.auxiliary_states.checks
        ratio[sigma] = abs(next(c.ratio for c in checks if c.name == "position_fix"))
    assert ratio[0.005] > 3 * ratio[0.15]


def test_unknown_covariances_and_vehicles_that_want_none() -> None:
    assert unpack_pose_covariance(UNKNOWN) is None
    assert unpack_pose_covariance([0.0] * 21) is None
    rng = np.random.default_rng(0)
    a = rng.standard_normal((4, 4))
    assert unpack_pose_covariance(pack_pose_covariance(a @ a.T)) == pytest.approx(a @ a.T, rel=1e-6)
    outside = Outside(Rig())
    outside.go(0.3)
    assert (
        "the vehicle does not use external positions; start the vehicle with --position link" in outside.station.words
    )
    with pytest.raises(InputError, match="ideal sensors use no position fixes"):
        Flight("mufly-1.1", "demonstration", outside=True)
