"""What each command asks of the autopilot, by the meaning that MAVLink gives its parameters; nothing flies here."""

import math

import numpy as np
import pytest
from link_rig import Rig

from mufly.link import mavlink as m
from mufly.mission import REQUEST_ACCEPTED, SetPoint, deny_request

NAN = math.nan
DENIED, OK, LATER = m.MAV_RESULT_DENIED, m.MAV_RESULT_ACCEPTED, m.MAV_RESULT_TEMPORARILY_REJECTED
ORIGIN = (47.3769, 8.5417, 408.0)


class Asked:
    """A rig whose autopilot notes what it is asked for, and agrees, or not, without doing it."""

    def __init__(self, origin=None, answer=REQUEST_ACCEPTED):
        self.rig = Rig(origin=origin)
        self.gcs = self.rig.station()
        self.rig.run(0.02)
        self.calls = []
        names = "take_off go_to turn_to land pause return_home start_mission emergency_stop"
        names += " set_offboard set_sticks release_sticks"
        for name in (*names.split(), "send_set_point"):
            setattr(self.rig.link.autopilot, name, lambda *a, n=name, **k: self.calls.append((n, *a)) or answer)

    def by(self, do):
        """What is asked for by something that the station does, and the last answer to it."""
        self.calls.clear()
        do(self.gcs)
        self.rig.run(0.03)
        return self.calls, self.gcs.acks[-1][1] if self.gcs.acks else None


def long(number, *p):
    return lambda s: s.command(number, *p)


def integer(number, *p, **place):
    return lambda s: s.command_int(number, *p, **place)


UP = m.MAV_CMD_NAV_TAKEOFF


@pytest.mark.parametrize(
    ("order", "height", "alt_m"),
    [
        (long(UP, 0, 0, 0, 0, 0, 0, 1.5), 1.5, None),
        (long(UP, 0, 0, 0, 0, 0, 0, 0.0), None, None),  # what MIS_TAKEOFF_ALT says
        (long(UP, 0, 0, 0, NAN, NAN, NAN, NAN), None, None),
        (long(m.MAV_CMD_NAV_TAKEOFF_LOCAL, 0, 0, 0, 0, 0, 0, -1.2), 1.2, None),
        (long(m.MAV_CMD_NAV_TAKEOFF_LOCAL, 0, 0, 0, 0, 0, 0, 0.0), None, None),
        (long(m.MAV_CMD_NAV_TAKEOFF_LOCAL, 0, 0, 0, 0, 0, 0, NAN), None, None),
        (integer(UP, frame=1, z=-1.5), 1.5, None),
        (long(UP, 0, 0, 0, 0, 0, 0, 409.5), 409.5, None),  # above no sea: too high, and refused as that
        (long(UP, 0, 0, 0, 0, 0, 0, 409.5), 1.5, 408.0),
        (long(UP, 0, 0, 0, 0, 0, 0, 1.5), 1.5, 408.0),
        (long(UP, 0, 0, 0, 0, 0, 0, 1.5), 1.5, 1.0),  # by the sea it still is a height
        (integer(UP, frame=0, z=409.5), 1.5, 408.0),
        (integer(UP, frame=3, z=1.5), 1.5, 408.0),
    ],
)
def test_a_take_off_is_to_a_height_above_the_floor(order, height, alt_m):
    asked = Asked(None if alt_m is None else (*ORIGIN[:2], alt_m))
    calls, result = asked.by(order)
    (name, *told), given = calls[0], () if height is None else (pytest.approx(height, abs=1e-4),)
    assert (name, tuple(told or (None,)), result) == ("take_off", given or (None,), OK)


def test_a_place_to_go_to_in_metres_and_on_the_globe():
    asked = Asked(ORIGIN)
    lat, lon, alt = asked.rig.link.origin.to_global(3.0, -2.0, -1.5)
    x, y = round(lat * 1e7), round(lon * 1e7)
    go = m.MAV_CMD_DO_REPOSITION
    for order in (
        integer(go, -1, 1, 0, NAN, frame=1, x=30000, y=-20000, z=-1.5),
        integer(go, -1, 1, 0, NAN, frame=0, x=x, y=y, z=alt),
        integer(go, -1, 1, 0, NAN, frame=3, x=x, y=y, z=1.5),
        integer(go, -1, 1, 0, NAN, frame=6, x=x, y=y, z=1.5),  # the same numbers, but no repetition
    ):
        ((name, place, heading),), result = asked.by(order)
        assert (name, heading, result) == ("go_to", None, OK)
        assert place == pytest.approx((3.0, -2.0, -1.5), abs=0.01)
    ((_, _, heading),), _ = asked.by(integer(go, -1, 1, 0, 1.25, frame=1, x=0, y=0, z=-1.0))
    assert heading == pytest.approx(1.25)
    assert asked.by(long(go, -1, 1, 0, 0.5, NAN, NAN, NAN))[0] == [("turn_to", 0.5)]
    for frame, why in ((4, "use LOCAL_NED"), (10, "not supported")):
        assert asked.by(integer(go, -1, 1, 0, NAN, frame=frame, x=1, y=1, z=1.0)) == ([], DENIED)
        assert why in asked.gcs.words


def test_the_speed_of_a_place_stays_if_the_place_is_taken_and_only_then():
    for answer, kept in ((REQUEST_ACCEPTED, 0.2), (deny_request("too far"), None)):
        asked = Asked(answer=answer)
        before = asked.rig.flight.autopilot.parameters["LIM_SPEED"].value
        asked.by(integer(m.MAV_CMD_DO_REPOSITION, 0.2, 1, 0, NAN, z=-1.0))
        assert asked.rig.flight.autopilot.parameters["LIM_SPEED"].value == (kept or before)
    speed = m.MAV_CMD_DO_CHANGE_SPEED
    assert asked.by(long(speed, 1, 0.3, -1))[1] == OK
    assert asked.rig.flight.autopilot.parameters["LIM_SPEED"].value == 0.3
    for told, result in (
        (-1.0, OK),
        (-2.0, OK),
        (-3.0, DENIED),
        (NAN, DENIED),
    ):  # -1, -2: as it is, and its own
        assert asked.by(long(speed, 1, told, -1))[1] == result
    assert asked.by(long(speed, 2, 0.2, -1))[1] == DENIED  # a speed of climb
    assert asked.rig.flight.autopilot.parameters["LIM_SPEED"].value == 0.3


def test_a_turn_is_to_a_heading_or_by_an_angle_to_the_side_that_is_said():
    asked = Asked()
    now = float(asked.rig.flight.autopilot.software.reference[2][2])
    yaw = m.MAV_CMD_CONDITION_YAW
    for p, to in (
        ((90, 0, 0, 0), math.pi / 2),
        ((90, 0, -1, 0), math.pi / 2),  # absolute: there is no other way round
        ((30, 0, 1, 1), now + math.pi / 6),
        ((30, 0, -1, 1), now - math.pi / 6),
        ((30, 0, 0, 1), now + math.pi / 6),
    ):
        asked.rig.now_s += 20.0  # not the same again
        assert asked.by(long(yaw, *p)) == ([("turn_to", pytest.approx(to))], OK)


MODE = m.MAV_CMD_DO_SET_MODE


def test_modes_and_their_older_forms():
    asked = Asked()
    before = asked.rig.link.autopilot.parameters["LIM_SPEED"].value
    for p, calls, result in (
        ((1, 4, 6), [("land",)], OK),
        ((1, 4, 5), [("return_home",)], OK),
        ((1, 6, 0), [("set_offboard", True)], OK),
        ((1, 4, 3), [], OK),  # on the floor it holds anyway
        ((1, 4, 9), [], DENIED),
        ((1, 4 << 16 | 6 << 24, 0), [("land",)], OK),  # pymavlink packs both into one
        ((1, -1, 0), [], DENIED),
        ((0, 4, 6), [], DENIED),  # of no custom mode
        ((NAN, 4, 6), [], DENIED),
        ((1, NAN, 6), [], DENIED),
    ):
        asked.rig.now_s += 20.0
        assert asked.by(long(MODE, *p)) == (calls, result), p
    for p, calls in ((1, [("start_mission",)]), (0, [])):  # go on; stop, which on the floor it does anyway
        assert asked.by(long(m.MAV_CMD_DO_PAUSE_CONTINUE, p)) == (calls, OK)
    assert asked.by(lambda s: s.say(m.MAVLink_set_mode_message(1, 1, 4 << 16 | 6 << 24)))[0] == [("land",)]
    assert asked.by(lambda s: s.say(m.MAVLink_set_mode_message(1, 128, 4 << 16 | 6 << 24)))[0] == []
    assert asked.rig.link.autopilot.parameters["LIM_SPEED"].value == before


def test_what_says_stop_stops_and_what_says_anything_else_does_not():
    asked = Asked()
    for p, calls, result in (((1,), [("emergency_stop",)], OK), ((0,), [], OK)):
        assert asked.by(long(m.MAV_CMD_DO_FLIGHTTERMINATION, *p)) == (calls, result)
    arm = m.MAV_CMD_COMPONENT_ARM_DISARM
    assert asked.by(long(arm, 0.5)) == ([], DENIED)
    assert asked.by(long(arm, 1, 0))[1] == OK
    assert asked.by(long(arm, 2, 21196)) == ([], DENIED)
    assert asked.rig.status.armed
    assert asked.by(long(arm, 0, 21196)) == ([("emergency_stop",)], OK)
    assert asked.by(long(arm, 0))[1] == OK
    assert not asked.rig.status.armed
    asked.rig.flight.reset = lambda: asked.calls.append(("reset",))
    for p, calls, result in ((0, [], DENIED), (2, [], DENIED), (1, [("reset",)], OK)):
        assert asked.by(long(m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, p)) == (calls, result)


def test_the_same_command_again_is_a_repetition_for_four_fifths_of_a_second():
    """Two presses of a key are further apart; programs repeat sooner, or count their repetitions."""
    asked = Asked()
    turn = long(m.MAV_CMD_CONDITION_YAW, 30, 0, 1, 1)
    for pause_s, confirmation, acts in (
        (0.0, 0, 1),
        (0.6, 0, 0),
        (0.6, 0, 0),
        (0.9, 0, 1),
        (5.0, 1, 0),
        (12.0, 1, 1),
    ):
        asked.rig.now_s += pause_s
        told = len(asked.gcs.acks)
        calls, result = asked.by(
            lambda s, k=confirmation: s.command(m.MAV_CMD_CONDITION_YAW, 30, 0, 1, 1, confirmation=k)
        )
        assert (len(calls), result) == (acts, OK), pause_s
        assert len(asked.gcs.acks) == told + 1
    # Another angle is another command, and what was refused is judged anew.
    assert len(asked.by(long(m.MAV_CMD_CONDITION_YAW, 31, 0, 1, 1))[0]) == 1
    refuses = Asked(answer=deny_request("no"))
    assert [len(refuses.by(turn)[0]) for _ in range(2)] == [1, 1]
    assert refuses.gcs.acks[-1][1] == DENIED
    assert refuses.gcs.last("STATUSTEXT").severity == m.MAV_SEVERITY_WARNING


def test_a_repetition_does_not_undo_what_was_asked_after_it():
    """A landing whose answer is lost, then another command: the second copy of the first comes after it."""
    asked = Asked()

    def land(s, copy=0):
        s.command(m.MAV_CMD_NAV_LAND, confirmation=copy)

    turn = long(m.MAV_CMD_CONDITION_YAW, 30, 0, 1, 1)
    assert asked.by(land) == ([("land",)], OK)
    asked.rig.now_s += 0.4
    assert [name for name, *_ in asked.by(turn)[0]] == ["turn_to"]
    asked.rig.now_s += 0.4
    for copy in (1, 2):
        assert asked.by(lambda s, k=copy: land(s, k)) == ([], OK)
        asked.rig.now_s += 0.8
    # One that is new is obeyed at once, and so is one whose first copy was lost, seconds after the other.
    assert asked.by(land) == ([("land",)], OK)
    assert asked.by(turn)[0]
    asked.rig.now_s += 4.0
    assert asked.by(lambda s: land(s, 1)) == ([("land",)], OK)


def test_who_does_not_command_moves_nothing_and_takes_no_command_by_letting_go():
    asked = Asked()
    rig, gcs, other = asked.rig, asked.gcs, asked.rig.station("other", 254)
    let_go, hold = (
        m.MAVLink_rc_channels_override_message(1, 1, *us, 0, 0, 0, 0) for us in ([0] * 4, [1500, 1500, 1600, 1500])
    )
    point = m.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0xFF8, 0.2, 0, -0.6, *[0] * 8)
    nothing = m.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0xFFF, *[0] * 11)
    for message in (let_go, nothing):
        asked.by(lambda s, x=message: other.say(x))
        assert rig.link.authority.commander is None
    assert asked.by(lambda s: s.say(hold))[0][0][0] == "set_sticks"
    assert rig.link.authority.commander.system == 255
    for message in (hold, let_go, point):
        assert asked.by(lambda s, x=message: other.say(x))[0] == []
    assert "denied: system 255" in other.words
    assert asked.by(lambda s: s.say(let_go))[0] == [("release_sticks",)]
    assert asked.by(lambda s: s.say(point))[0] == [
        ("send_set_point", SetPoint((np.float32(0.2), 0.0, np.float32(-0.6))))
    ]
    assert asked.by(lambda s: s.say(nothing))[0] == []
    assert gcs.acks == []


def test_failures_are_injected_into_fitted_sensors_and_cleared() -> None:
    """INJECT_FAILURE as the specification numbers units and types; a flight on what is true has none."""
    rig = Rig(sensors="fitted")
    gcs = rig.station()
    rig.run(0.02)

    def answer(*p):
        gcs.command(m.MAV_CMD_INJECT_FAILURE, *p)
        rig.run(0.03)
        return gcs.acks[-1][1]

    assert answer(m.FAILURE_UNIT_SENSOR_VIO, m.FAILURE_TYPE_OFF) == OK
    assert answer(m.FAILURE_UNIT_SENSOR_ACCEL, m.FAILURE_TYPE_WRONG) == OK
    assert [(f.name, f.kind) for f in rig.flight.faults] == [
        ("accelerometer", "bias"),
        ("position", "dropout"),
    ]
    # How much and for how long are ours, where the specification leaves parameters open.
    assert answer(m.FAILURE_UNIT_SENSOR_DISTANCE_SENSOR, m.FAILURE_TYPE_WRONG, 0, 0, 0.25, 2.0) == OK
    (sonar,) = (f for f in rig.flight.faults if f.name == "sonar")
    assert sonar.amount == 0.25
    assert sonar.stop_s - sonar.start_s == pytest.approx(2.0)
    assert answer(m.FAILURE_UNIT_SENSOR_DISTANCE_SENSOR, m.FAILURE_TYPE_WRONG, 0, 0, 1e9, 2.0) not in (
        OK,
        LATER,
    )
    assert answer(m.FAILURE_UNIT_SENSOR_DISTANCE_SENSOR, m.FAILURE_TYPE_WRONG, 0, 0, 0.2, -1.0) not in (
        OK,
        LATER,
    )
    assert answer(m.FAILURE_UNIT_SENSOR_AIRSPEED, m.FAILURE_TYPE_OFF) not in (OK, LATER)
    assert answer(m.FAILURE_UNIT_SENSOR_VIO, m.FAILURE_TYPE_SLOW) not in (OK, LATER)
    assert answer(m.FAILURE_UNIT_SENSOR_VIO, m.FAILURE_TYPE_OK) == OK
    assert rig.flight.faults == ()
    plain = Rig()
    gcs = plain.station()
    plain.run(0.02)
    gcs.command(m.MAV_CMD_INJECT_FAILURE, m.FAILURE_UNIT_SENSOR_VIO, m.FAILURE_TYPE_OFF)
    plain.run(0.03)
    assert gcs.acks[-1][1] not in (OK, LATER)
