"""Emergency stops, changes of command and a lost commander at the moments at which they hurt most."""

import math
import random

import numpy as np
import pytest
from link_rig import Rig, waypoint

from mufly.link import mavlink as m

ARM = m.MAV_CMD_COMPONENT_ARM_DISARM
KILL = (ARM, 0, 21196)
LEGS = {"waypoint": [{"position_m": [2.0, 0.0, -1.0]}, {"position_m": [2.0, 2.0, -1.0]}]}


def two(rig):
    stations = rig.station("a", 255), rig.station("b", 254)
    rig.run(0.1)
    return stations


@pytest.mark.parametrize("confirmation", [0, 1])
def test_an_emergency_stop_is_never_taken_for_a_repetition(confirmation):
    """One station stops it, another arms and takes off, the first stops it again."""
    rig = Rig()
    a, b = two(rig)
    a.command(*KILL)
    rig.run(0.05)
    b.command(ARM, 1)
    b.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.0)
    rig.run(0.2)
    assert rig.status.motors == "spin_up"
    a.command(*KILL, confirmation=confirmation)
    rig.run(0.05)
    assert (rig.status.motors, rig.status.armed) == ("off", False)
    assert a.acks == [(ARM, 0), (ARM, 0)]


def test_a_stop_and_an_order_between_two_ticks():
    rig = Rig()
    a, b = two(rig)
    rig.airborne(a, 0.3)
    b.command(*KILL)
    a.command(m.MAV_CMD_NAV_LAND)
    rig.run(0.05)
    assert (rig.status.motors, rig.status.armed, rig.status.state) == ("off", False, "init")
    assert a.acks[-1] == (m.MAV_CMD_NAV_LAND, m.MAV_RESULT_TEMPORARILY_REJECTED)


def test_what_waited_for_the_sticks_does_not_outlive_an_emergency_stop():
    rig = Rig()
    a, b = two(rig)
    rig.airborne(a)
    a.every = [m.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0)]
    rig.run(0.2)
    a.mode(2, 0)
    assert rig.run(1.0, lambda: rig.status.state == "rc")
    a.command(ARM, 1)  # has to wait until the sticks are let go of
    b.command(*KILL)
    rig.run(1.0)
    assert not rig.status.armed


def test_a_commander_lost_before_lift_off_is_missed_all_the_same():
    rig = Rig(tables=LEGS)
    gcs = rig.station()
    watcher = rig.station("watcher", 9)
    rig.run(0.1)
    gcs.say(m.MAVLink_param_set_message(1, 1, b"COM_DL_LOSS_T", 1.0, 9))
    gcs.say(m.MAVLink_param_set_message(1, 1, b"COM_DL_LAND_T", 4.0, 9))
    gcs.command(ARM, 1)
    rig.run(0.05)
    gcs.command(m.MAV_CMD_MISSION_START)
    rig.run(0.05)
    gcs.alive = False
    assert rig.run(8.0, lambda: rig.status.state == "hover")
    assert "stop and hover, land in 4 s" in watcher.words
    assert abs(rig.position[0]) < 0.05  # it has not set out
    assert rig.run(10.0, lambda: rig.status.state == "landing")
    assert rig.run(10.0, lambda: not rig.status.armed)


def test_an_upload_ends_with_the_command_of_whoever_began_it():
    rig = Rig()
    a, b = two(rig)
    a.upload([waypoint(0.1 * k, 0, -1) for k in range(1, 6)])
    rig.run(0.02)
    assert a.last("MISSION_REQUEST_INT") is not None
    interrupted, a.giver, a.alive = a.giver, None, False
    rig.run(5.2)
    b.upload([waypoint(0.1 * k, 1, -1) for k in range(1, 4)])
    a.giver, a.alive = interrupted, True  # heard again, it goes on where it was
    assert rig.run(4.0, lambda: b.giver.result is not None)
    rig.run(2.0)
    assert b.giver.result == 0
    assert [w.position_m[1] for w in rig.status.mission.waypoint] == [1.0] * 3
    assert interrupted.result == 15


def test_sticks_that_somebody_else_moves_do_not_fly_it():
    rig = Rig()
    a, b = two(rig)
    rig.airborne(a)
    a.say(m.MAVLink_change_operator_control_message(1, 1, 0, b""))
    b.say(m.MAVLink_manual_control_message(1, 0, 0, 1000, 0, 0))
    a.mode(2, 0)
    rig.run(0.1)
    assert a.acks[-1] == (m.MAV_CMD_DO_SET_MODE, m.MAV_RESULT_TEMPORARILY_REJECTED)
    assert not rig.status.sticks_active


def test_a_place_that_is_refused_leaves_the_speed():
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs)
    before = rig.flight.autopilot.parameters["LIM_SPEED"].value
    gcs.command_int(m.MAV_CMD_DO_REPOSITION, 0.2, 0, 0, math.nan, z=5.0)
    rig.run(0.1)
    assert gcs.acks[-1] == (m.MAV_CMD_DO_REPOSITION, m.MAV_RESULT_DENIED)
    assert rig.flight.autopilot.parameters["LIM_SPEED"].value == before


def test_everybody_hears_of_a_parameter_that_a_command_or_another_one_changes():
    rig = Rig()
    a, b = two(rig)
    rig.airborne(a)
    rig.run(1.0)
    b.heard.clear()
    a.command(m.MAV_CMD_DO_CHANGE_SPEED, 1, 0.3, -1)
    rig.run(1.0)
    a.say(m.MAVLink_param_set_message(1, 1, b"CTL_HEAVE_SPD", 0.25, 9))
    rig.run(1.5)
    told = {x.param_id: x.param_value for x in b.all("PARAM_VALUE")}
    assert told["LIM_SPEED"] == pytest.approx(0.3)
    assert told["CTL_HEAVE_SPD"] == pytest.approx(0.25)
    assert told["LIM_CLIMB"] == pytest.approx(0.2)  # 80 % of it
    assert len(b.all("PARAM_VALUE")) == len(told)  # each once


def test_a_mode_chosen_before_an_emergency_stop_does_not_begin_after_it():
    rig = Rig()
    a, b = two(rig)
    a.mode(4, 2)
    rig.run(0.1)
    b.command(*KILL)
    rig.run(0.1)
    a.command(ARM, 1)
    rig.run(0.5)
    assert rig.status.armed
    assert rig.status.motors == "off"


def set_point():
    return m.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0xFF8, 0.2, 0, -0.6, *[0] * 8)


def stick(throttle):
    return m.MAVLink_manual_control_message(1, 0, 0, throttle, 0, 0)


def channels(throttle):
    return m.MAVLink_rc_channels_override_message(1, 1, 1500, 1500, throttle, 1500, 0, 0, 0, 0)


ORDERS = [
    lambda s: s.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0.5),
    lambda s: s.command(m.MAV_CMD_MISSION_START),
    lambda s: s.command(m.MAV_CMD_NAV_LAND),
    lambda s: s.command(m.MAV_CMD_DO_PAUSE_CONTINUE, 0),
    lambda s: s.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    lambda s: s.mode(4, 4),
    lambda s: s.mode(4, 2),
    lambda s: s.mode(6, 0),
    lambda s: s.mode(2, 0),
    lambda s: s.say(set_point()),
    lambda s: s.say(stick(0)),
    lambda s: s.say(stick(700)),
    lambda s: s.say(channels(1700)),
    lambda s: s.say(m.MAVLink_rc_channels_override_message(1, 1, *[0] * 8)),
]


@pytest.mark.parametrize("seed", range(12))
def test_an_emergency_stop_in_any_state_and_any_traffic(seed):
    """The commander says whatever it likes before, together with and after it; all but arming leaves the motors off."""
    rng = random.Random(seed)
    rig = Rig(tables=LEGS)
    a, b = two(rig)
    for _ in range(rng.randrange(100, 1800)):
        if rng.random() < 0.06:
            rng.choice([*ORDERS, lambda s: s.command(ARM, 1)])(a)
        rig.tick()
    for order in rng.sample([*ORDERS, lambda s: s.command(ARM, 1)], 4):
        order(a)
    b.command(*KILL)
    for order in rng.sample(ORDERS, 4):
        order(a)
    a.every = [set_point(), stick(700)]
    for _ in range(200):
        rig.tick()
        assert (rig.flight.sent_actuators.input_array == 0.0).all()
        assert not rig.status.armed
    assert np.isfinite(rig.position).all()
