"""What each message tells, read back in the units that MAVLink declares for its fields: a client's own reading."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mufly.dynamics import body_to_ned_matrix, quaternion_from_euler
from mufly.estimate import ERROR_STATES, AuxiliaryStates, Estimate, SensorStatus
from mufly.flight import Actuators, FlightState
from mufly.link import MESSAGE_STREAMS, MISSION_STATES, GlobalOrigin, px4_mode_from_state
from mufly.link import mavlink as m
from mufly.link.estimate_messages import UNKNOWN_COVARIANCE
from mufly.link.telemetry_streams import MissionProgress, TelemetryState
from mufly.sensors import Reading, Readings
from mufly.station.remote.vehicle_telemetry import VehicleTelemetry
from mufly.station.signal_history import SignalHistory

UNIT = {
    "": 1.0, "m": 1.0, "mm": 1e-3, "cm": 1e-2, "m/s": 1.0, "cm/s": 1e-2, "rad": 1.0, "rad/s": 1.0, "s": 1.0,
    "ms": 1e-3, "us": 1e-6, "mV": 1e-3, "cA": 1e-2, "%": 1e-2, "c%": 1e-4, "rpm": math.tau / 60,
    "deg": math.radians(1), "cdeg": math.radians(1e-2), "degE7": 1e-7,
}  # fmt: skip
"""To SI, and places on the globe to degrees (mavlink.io/en/messages/common.html)."""
ORIGIN = GlobalOrigin(47.3769, 8.5417, 408.0)
YAW = 7.0  # wound up past north once
RING = SimpleNamespace(count=8, first_angle=math.radians(22.5), min_range=0.04, max_range=1.5)
VEHICLE = SimpleNamespace(range_ring=RING, battery=SimpleNamespace(low_voltage=6.8))
FLYING = FlightState(
    time_s=12.345,
    armed=True,
    flying=True,
    state="waypoint",
    mission_running=True,
    home_position=(1.0, 2.0, -0.05),
    estimate=Estimate(
        12.345,
        np.array([3.0, -4.0, -1.5]),
        np.array([0.3, -0.4, 0.1]),
        np.array([0.05, -0.04, YAW]),
        np.array([0.1, 0.2, 0.3]),
        np.array([0.5, 1.5, 0.02, math.nan, 1.2, 1.5, 1.5, 0.9]),
        7.4,
    ),
    readings=Readings(
        0.0,
        {
            "position": Reading(np.array([3.1, -4.1, -1.4]), 0.0),
            "attitude": Reading(np.array([0.06, -0.05, YAW]), 0.0),
        },
    ),
    reference_position=np.array([3.2, -4.2, -1.6]),
    reference_velocity=np.array([0.4, -0.5, 0.2]),
    reference_attitude=np.array([0.07, -0.03, YAW]),
    actuators=Actuators(np.array([0.4, 0.6]), np.array([0.1, -0.2])),
    battery_current=3.21,
    battery_charge=0.64,
    battery_left_s=321.0,
    truth=SimpleNamespace(
        position=np.array([3.0, -4.0, -1.5]),
        velocity=np.array([0.31, -0.41, 0.11]),
        attitude=np.array([0.05, -0.04, YAW]),
        rates=np.array([0.1, 0.2, 0.3]),
        rotor_speed=np.array([250.0, 260.0]),
        wind=np.array([0.5, 0.6, 0.7]),
    ),
)


def instant(state=FLYING, **known):
    told = {
        "is_ready": True,
        "mission_progress": MissionProgress(2, 5, 3, 1),
        "origin": ORIGIN,
        "mode_on_arming": "",
        "commander_id": 0,
    }
    return TelemetryState(**{"vehicle": VEHICLE, "flight_state": state, "loss_ratio": 0.0, **told, **known})


def told(name, now=None):
    """What a stream says, off the wire."""
    (stream,) = (s for s in MESSAGE_STREAMS if s.message_name == name)
    link = m.MAVLink(None)
    out = [link.decode(bytearray(x.pack(link))) for x in stream.build_messages(instant() if now is None else now)]
    return out if len(out) != 1 else out[0]


def si(message, field):
    """A field in SI, and the value of its last digit."""
    unit = UNIT[message.fieldunits_by_name.get(field, "")]
    value = getattr(message, field)
    return value * unit, unit if isinstance(value, int) else 1e-6 * max(1.0, abs(value * unit))


WRAPPED = YAW - math.tau
PLACE, HOME = ORIGIN.to_global(3.0, -4.0, -1.5), ORIGIN.to_global(1.0, 2.0, -0.05)
TOLD = {
    "SYSTEM_TIME": {"time_boot_ms": 12.345},
    "SYS_STATUS": {"voltage_battery": 7.4, "current_battery": 3.21, "battery_remaining": 0.64,
                   "drop_rate_comm": 0.0123},
    "BATTERY_STATUS": {"current_battery": 3.21, "battery_remaining": 0.64, "time_remaining": 321.0},
    "MISSION_CURRENT": {"seq": 2, "total": 5, "mission_state": 3, "mission_mode": 1},
    "NAMED_VALUE_INT (mstate)": {"value": MISSION_STATES.index("waypoint")},
    "NAMED_VALUE_FLOAT (rtfactor)": {"value": 0.75},
    "NAMED_VALUE_INT (slips)": {"value": 4},
    "ATTITUDE": {"time_boot_ms": 12.345, "roll": 0.05, "pitch": -0.04, "yaw": WRAPPED, "rollspeed": 0.1,
                 "pitchspeed": 0.2, "yawspeed": 0.3},
    "ATTITUDE_QUATERNION": {"rollspeed": 0.1, "pitchspeed": 0.2, "yawspeed": 0.3},
    "LOCAL_POSITION_NED": {"x": 3.0, "y": -4.0, "z": -1.5, "vx": 0.3, "vy": -0.4, "vz": 0.1},
    "POSITION_TARGET_LOCAL_NED": {"x": 3.2, "y": -4.2, "z": -1.6, "vx": 0.4, "vy": -0.5, "vz": 0.2, "yaw": WRAPPED},
    "VISION_POSITION_ESTIMATE": {"usec": 12.345, "x": 3.1, "y": -4.1, "z": -1.4, "roll": 0.06, "pitch": -0.05,
                                 "yaw": WRAPPED},
    "VFR_HUD": {"groundspeed": 0.5, "airspeed": 0.5, "heading": WRAPPED, "throttle": 0.5, "alt": 409.5, "climb": -0.1},
    "ALTITUDE": {"altitude_monotonic": 1.5, "altitude_amsl": 409.5, "altitude_local": 1.5, "altitude_relative": 1.45,
                 "altitude_terrain": 408.0, "bottom_clearance": 1.5},
    "GLOBAL_POSITION_INT": {"lat": PLACE[0], "lon": PLACE[1], "alt": 409.5, "relative_alt": 1.45, "vx": 0.3, "vy": -0.4,
                            "vz": 0.1, "hdg": WRAPPED},
    "GPS_RAW_INT": {"time_usec": 12.345, "lat": PLACE[0], "lon": PLACE[1], "alt": 409.5, "vel": 0.5,
                    "cog": math.atan2(-0.4, 0.3) + math.tau},
    "HOME_POSITION": {"latitude": HOME[0], "longitude": HOME[1], "altitude": 408.05, "x": 1.0, "y": 2.0, "z": -0.05},
    "GPS_GLOBAL_ORIGIN": {"latitude": ORIGIN.lat_deg, "longitude": ORIGIN.lon_deg, "altitude": 408.0},
}  # fmt: skip


@pytest.mark.parametrize("name", TOLD)
def test_every_message_tells_the_state_in_mavlinks_units(name):
    message = told(name, instant(loss_ratio=0.0123, real_time_factor=0.75, slip_count=4))
    for field, expected in TOLD[name].items():
        value, digit = si(message, field)
        assert value == pytest.approx(expected, abs=0.51 * digit + 1e-6), field


def test_arrays_begin_with_what_is_known_and_the_rest_says_that_nothing_is():
    quaternion = pytest.approx(quaternion_from_euler(0.05, -0.04, YAW), abs=1e-6)
    q = told("ATTITUDE_QUATERNION")
    assert (q.q1, q.q2, q.q3, q.q4) == quaternion
    target = told("ATTITUDE_TARGET")
    assert target.q == pytest.approx(quaternion_from_euler(0.07, -0.03, YAW), abs=1e-6)
    assert target.type_mask & 128 == 0
    battery = told("BATTERY_STATUS")
    assert battery.voltages == [7400] + [65535] * 9
    outputs = told("ACTUATOR_OUTPUT_STATUS")
    assert outputs.active == 4
    assert outputs.actuator == pytest.approx([0.4, 0.6, 0.1, -0.2] + [0.0] * 28)
    assert [(r.index, r.frequency * UNIT["rpm"]) for r in told("RAW_RPM")] == [
        (0, pytest.approx(250.0)),
        (1, pytest.approx(260.0)),
    ]
    # Its first element unknown: a client takes none of the covariance for known.
    assert math.isnan(told("VISION_POSITION_ESTIMATE").covariance[0])
    true = told("DEBUG_FLOAT_ARRAY")
    values = [
        3.0,
        -4.0,
        -1.5,
        0.31,
        -0.41,
        0.11,
        0.05,
        -0.04,
        WRAPPED,
        0.1,
        0.2,
        0.3,
        250.0,
        260.0,
        0.5,
        0.6,
        0.7,
    ]
    assert true.data == pytest.approx([*values, *[0.0] * 41])
    assert told("HOME_POSITION").q == [1.0, 0.0, 0.0, 0.0]  # level


def test_a_ring_is_told_in_centimetres_and_each_beam_with_its_direction():
    ring = told("OBSTACLE_DISTANCE")
    # 0.5 m; nothing in sight; nearer than it can see, as it came; not known; ...
    assert ring.distances == [50, 151, 2, 65535, 120, 151, 151, 90] + [65535] * 64
    assert (ring.min_distance, ring.max_distance, ring.increment, ring.increment_f) == (4, 150, 45, 45.0)
    assert ring.angle_offset == pytest.approx(22.5)
    beams = told("DISTANCE_SENSOR")
    assert [b.current_distance for b in beams] == [50, 150, 2, 0, 120, 150, 150, 90]
    assert {(b.min_distance, b.max_distance) for b in beams} == {(4, 150)}
    turned = [2 * math.atan2(b.quaternion[3], b.quaternion[0]) % math.tau for b in beams]
    assert turned == pytest.approx([math.radians(22.5 + 45 * k) for k in range(8)])
    # Directions that MAVLink has a word for are named: no quaternion is needed then.
    ahead = SimpleNamespace(**{**vars(RING), "first_angle": math.radians(90.0)})
    beams = told("DISTANCE_SENSOR", instant(vehicle=SimpleNamespace(range_ring=ahead, battery=VEHICLE.battery)))
    yaws = [m.enums["MAV_SENSOR_ORIENTATION"][b.orientation].name.rpartition("_")[2] for b in beams]
    assert yaws == ["90", "135", "180", "225", "270", "315", "NONE", "45"]
    assert {tuple(b.quaternion) for b in beams} == {(0.0, 0.0, 0.0, 0.0)}
    askew = SimpleNamespace(**{**vars(RING), "first_angle": math.radians(10.0)})
    beams = told("DISTANCE_SENSOR", instant(vehicle=SimpleNamespace(range_ring=askew, battery=VEHICLE.battery)))
    assert {b.orientation for b in beams} == {m.MAV_SENSOR_ROTATION_CUSTOM}


def test_what_is_not_followed_is_masked_out():
    """Bits 0 to 2 leave out the place, 3 to 5 the velocity, 6 to 8 the acceleration, 10 the yaw, 11 its rate.

    By hand the sticks tilt it, so it keeps to no place, but height and climb are held for the pilot.
    """
    for state, armed, level, height, yaw in (
        ("waypoint", True, True, True, True),
        ("hover", True, True, True, True),
        ("rc", True, False, True, True),
        ("init", True, False, False, False),
        ("waypoint", False, False, False, False),
    ):
        now = instant(replace(FLYING, state=state, armed=armed))
        mask = told("POSITION_TARGET_LOCAL_NED", now).type_mask
        assert [not mask & 1 << k for k in range(6)] == [level, level, height] * 2, state
        assert mask >> 6 & 0b111 == 0b111
        assert (not mask & 1 << 10, not mask & 1 << 11) == (yaw, False)
        assert bool(told("ATTITUDE_TARGET", now).type_mask & 128) is not yaw


@pytest.mark.parametrize(
    ("change", "status", "armed", "well"),
    [
        ({}, m.MAV_STATE_ACTIVE, True, True),
        ({"armed": False, "flying": False}, m.MAV_STATE_STANDBY, False, True),
        ({"voltage": 6.7}, m.MAV_STATE_CRITICAL, True, False),
        ({"voltage": 6.7, "flying": False}, m.MAV_STATE_ACTIVE, True, False),
        ({"crash_cause": "the floor", "voltage": 6.7}, m.MAV_STATE_EMERGENCY, True, False),
    ],
)
def test_how_well_it_is(change, status, armed, well):
    change = dict(change)
    estimate = replace(FLYING.estimate, battery_voltage=change.pop("voltage", 7.4))
    now = instant(replace(FLYING, estimate=estimate, **change))
    beat = told("HEARTBEAT", now)
    assert beat.system_status == status
    assert bool(beat.base_mode & m.MAV_MODE_FLAG_SAFETY_ARMED) is armed
    health = told("SYS_STATUS", now).onboard_control_sensors_health
    assert bool(health & m.MAV_SYS_STATUS_SENSOR_BATTERY) is well
    # Told by the same voltage, until hardly anything is left.
    low = m.MAV_BATTERY_CHARGE_STATE_OK if well else m.MAV_BATTERY_CHARGE_STATE_LOW
    assert told("BATTERY_STATUS", now).charge_state == low
    empty = instant(replace(now.flight_state, battery_charge=0.01))
    assert told("BATTERY_STATUS", empty).charge_state == m.MAV_BATTERY_CHARGE_STATE_CRITICAL


def test_what_flies_it_is_in_the_base_mode():
    """Bits that programs without PX4's modes go by: AUTO and GUIDED, or MANUAL_INPUT for sticks."""
    for state, by_itself in (("waypoint", True), ("offboard", True), ("rc", False)):
        base = told("HEARTBEAT", instant(replace(FLYING, state=state))).base_mode
        assert bool(base & m.MAV_MODE_FLAG_AUTO_ENABLED) is by_itself
        assert bool(base & m.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED) is not by_itself
    for chosen, mode in (("take-off", px4_mode_from_state("take-off")), ("mission", px4_mode_from_state("waypoint"))):
        beat = told("HEARTBEAT", instant(replace(FLYING, armed=False, state="init"), mode_on_arming=chosen))
        assert beat.custom_mode == mode.main_mode << 16 | mode.sub_mode << 24


def test_whether_it_can_be_armed_is_told_until_it_is():
    floor = replace(FLYING, armed=False, flying=False, state="init")
    for ready, state, can in ((True, floor, True), (False, floor, False), (False, FLYING, True)):
        status = told("SYS_STATUS", instant(state, is_ready=ready))
        assert bool(status.onboard_control_sensors_health & m.MAV_SYS_STATUS_PREARM_CHECK) is can


def test_where_it_stands():
    states = [
        told("EXTENDED_SYS_STATE", instant(replace(FLYING, flying=flying, state=state))).landed_state
        for flying, state in ((False, "take-off"), (True, "take-off"), (True, "hover"), (True, "landing"))
    ]
    assert states == [
        m.MAV_LANDED_STATE_ON_GROUND,
        m.MAV_LANDED_STATE_TAKEOFF,
        m.MAV_LANDED_STATE_IN_AIR,
        m.MAV_LANDED_STATE_LANDING,
    ]
    # Before it has taken off, home is where it stands; without an origin nobody knows the sea.
    waits = replace(FLYING, home_position=None)
    assert told("ALTITUDE", instant(waits)).altitude_relative == 0.0
    assert told("HOME_POSITION", instant(waits)).x == 3.0
    assert told("GLOBAL_POSITION_INT", instant(waits)).relative_alt == 1500
    alone = instant(waits, origin=None)
    assert told("VFR_HUD", alone).alt == pytest.approx(1.5)
    assert math.isnan(told("ALTITUDE", alone).altitude_amsl)
    assert told("ALTITUDE", alone).altitude_terrain < -1000.0  # MAVLink: below it is not known
    assert told("GLOBAL_POSITION_INT", alone) == told("HOME_POSITION", alone) == []
    assert (
        told("MISSION_CURRENT", instant(mission_progress=MissionProgress(0, 0, 1, 2))).total == 65535
    )  # of no mission


def test_stamps_are_never_0_and_the_short_one_starts_over_after_49_days():
    assert told("ATTITUDE", instant(replace(FLYING, time_s=0.0))).time_boot_ms == 1
    assert told("GPS_RAW_INT", instant(replace(FLYING, time_s=0.0))).time_usec == 1
    late = instant(replace(FLYING, time_s=2**32 * 1e-3 + 5.0))
    assert told("ATTITUDE", late).time_boot_ms == 5000
    assert told("GPS_RAW_INT", late).time_usec == pytest.approx((2**32 + 5000) * 1000, abs=1)


def test_a_vehicle_whose_sensors_do_not_tell_says_nothing_of_them():
    blind = replace(FLYING, readings=None, truth=None)
    for name in ("VISION_POSITION_ESTIMATE", "DEBUG_FLOAT_ARRAY", "RAW_RPM"):
        assert told(name, instant(blind)) == []
    half = replace(FLYING, readings=Readings(0.0, {"position": FLYING.readings["position"]}))
    assert told("VISION_POSITION_ESTIMATE", instant(half)) == []
    assert told("NAMED_VALUE_FLOAT (rtfactor)") == told("NAMED_VALUE_INT (slips)") == []  # nobody measures it


def test_what_is_believed_and_how_far_goes_out_and_comes_back() -> None:
    """ODOMETRY in the specification's frames and order of its triangles; a station reads the deviations in N-E-D."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(12, 12)) * 0.1
    covariance = root @ root.T
    beliefs = AuxiliaryStates(
        np.zeros(3),
        np.zeros(3),
        0.0,
        np.zeros(4),
        np.array([0.4, -0.1]),
        1.0,
        np.full(len(ERROR_STATES), 0.2),
        (
            SensorStatus("acceleration", "rejected", 1.0, 0.1, 10.0, 0.3, "clips"),
            SensorStatus("pressure", "fused", 5.0, 2.0, 2.5),
        ),
    )
    state = replace(FLYING, estimate=replace(FLYING.estimate, covariance=covariance, auxiliary_states=beliefs))
    now = instant(state)
    o, status, checks = (told(name, now) for name in ("ODOMETRY", "ESTIMATOR_STATUS", "DEBUG_FLOAT_ARRAY (checks)"))
    assert (o.frame_id, o.child_frame_id) == (m.MAV_FRAME_LOCAL_NED, m.MAV_FRAME_BODY_FRD)
    assert (o.x, o.y, o.z) == pytest.approx((3.0, -4.0, -1.5))
    turn = body_to_ned_matrix(quaternion_from_euler(0.05, -0.04, YAW))
    np.testing.assert_allclose(turn @ [o.vx, o.vy, o.vz], [0.3, -0.4, 0.1], atol=1e-6)
    pose = [0, 1, 2, 6, 7, 8]
    rows = [covariance[pose[i], pose[k]] for i in range(6) for k in range(i, 6)]
    np.testing.assert_allclose(o.pose_covariance, rows, rtol=1e-6)
    own = turn.T @ covariance[3:6, 3:6] @ turn
    np.testing.assert_allclose(
        [o.velocity_covariance[k] for k in (0, 1, 2, 6, 7, 11)], own[np.triu_indices(3)], rtol=1e-5
    )
    assert status.flags & m.ESTIMATOR_ACCEL_ERROR
    assert status.pos_vert_ratio == pytest.approx(0.25)  # half the gate
    assert status.pos_horiz_accuracy == pytest.approx(math.hypot(*np.sqrt(np.diag(covariance))[:2]))

    station = VehicleTelemetry(SignalHistory(seconds=10.0))
    for k, message in enumerate((told("ATTITUDE", now), o, status, checks)):
        station.handle_message(1.0 + 0.001 * k, message)
    sigma = np.sqrt(np.diag(covariance))
    for name, part in (("position", sigma[:3]), ("velocity", sigma[3:6]), ("attitude", sigma[6:9])):
        np.testing.assert_allclose(station.present_value(f"estimated_{name}_sigma"), part, rtol=1e-5)
    assert station.present_value("status_acceleration") == 2
    assert station.present_value("innovation_pressure") == 2.5
    assert np.isnan(station.present_value("status_ranges"))
    np.testing.assert_allclose(station.present_value("estimated_wind"), [0.4, -0.1], rtol=1e-6)
    assert "accelerometer error" in station.estimator_status.fault_texts
    assert station.estimator_status.missing_estimates == (
        "attitude",
        "velocity",
        "position",
    )  # one sigma of 0.58 m, and more
    # A deviation is no angle that goes round: that of a heading which was not known at first comes down.
    for k, sure in enumerate((6.2, 0.1)):
        odd = replace(state.estimate, covariance=np.diag([*[0.01] * 8, sure**2, *[0.01] * 3]))
        station.handle_message(1.05 + 0.01 * k, told("ODOMETRY", instant(replace(state, estimate=odd))))
    assert station.present_value("estimated_attitude_sigma")[2] == pytest.approx(0.1, rel=1e-5)
    # Covariances that are not known, as PX4 tells them, and a velocity in the room's axes.
    unknown = m.MAVLink_odometry_message(
        0, 1, 1, *[0.0] * 3, [1.0, 0, 0, 0], *[0.0] * 6, UNKNOWN_COVARIANCE, [0.09] + [0.0] * 20
    )
    station.handle_message(1.1, unknown)
    assert np.isnan(station.present_value("estimated_position_sigma")).all()
    np.testing.assert_allclose(station.present_value("estimated_velocity_sigma"), [0.3, 0.0, 0.0])
    # Estimates without error, and such that are none.
    assert told("DEBUG_FLOAT_ARRAY (checks)") == []
    assert told("ODOMETRY").pose_covariance[0] == 0.0
    assert told("ESTIMATOR_STATUS").flags & m.ESTIMATOR_POS_HORIZ_REL
    lost = instant(replace(FLYING, estimate=Estimate()))
    assert math.isnan(told("ODOMETRY", lost).q[0])
    assert told("ESTIMATOR_STATUS", lost).flags == 0
