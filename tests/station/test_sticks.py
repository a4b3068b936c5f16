"""The pilot's sticks on their way: which way they point, how often they are told, when they are let go."""

import math

import pytest

from mufly.link.steering_input import StickDeflection, parse_manual_control
from mufly.station.remote.pilot_sticks import PilotSticks, manual_control_message

BEGIN_S = 5000.0  # of no clock's beginning


def fields(message):
    return message.target, message.x, message.y, message.z, message.r


@pytest.mark.parametrize(
    ("held", "told"),
    [
        (StickDeflection(), (0, 0, 500, 0)),
        (StickDeflection(0.5, -0.25, 1.0, -1.0), (250, 500, 1000, -1000)),
        (StickDeflection(-1.0, 1.0, -1.0, 0.125), (-1000, -1000, 0, 125)),
        (StickDeflection(climb=0.5), (0, 0, 750, 0)),
    ],
)
def test_they_point_as_other_vehicles_take_them_and_ours_does(held, told):
    message = manual_control_message(held, 7)
    assert fields(message) == (7, *told)
    back = parse_manual_control(message)  # but for a middle that is dead
    for name in ("roll", "pitch", "climb", "yaw"):
        assert getattr(back, name) == pytest.approx(getattr(held, name), abs=0.03)


def test_they_end_where_a_stick_does_and_what_is_no_number_is_not_taken():
    sticks = PilotSticks(7)
    assert sticks.set_deflections(2.0, -3.0, -1.5, 1.25)
    (message,) = sticks.take_due_messages(BEGIN_S)
    assert fields(message) == (7, 1000, 1000, 0, 1000)
    assert not sticks.set_deflections(0.0, 0.0, math.inf, 0.0)
    (again,) = sticks.take_due_messages(BEGIN_S + 0.1)
    assert fields(again) == fields(message)


def test_they_are_told_25_times_a_second_while_they_are_held_and_let_go_when_nobody_moves_them():
    sticks = PilotSticks(7)
    assert sticks.take_due_messages(BEGIN_S) == []
    sticks.set_deflections(0.0, 0.1, 0.0, 0.0)
    told = [k for k in range(100) if sticks.take_due_messages(BEGIN_S + 0.011 * k)]
    assert told == list(range(0, 73, 4))  # every 0.044 s, to 0.792 s
    assert not sticks.is_held
    sticks.set_deflections(0.0, 0.0, 0.0, 0.0)
    assert sticks.is_held
    assert len(sticks.take_due_messages(BEGIN_S + 1.0)) == 1
    sticks.release_sticks()
    assert sticks.take_due_messages(BEGIN_S + 2.0) == []
