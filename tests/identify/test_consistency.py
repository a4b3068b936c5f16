"""Records that disagree with themselves, or with the vehicle that they are said to be of, are refused by name."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mufly.dynamics import DrydenWind
from mufly.errors import InputError
from mufly.identify import FlightRecord, check_flight_records, require_consistent_record
from mufly.identify.flight.identification_demo import (
    DEMO_SAMPLE_S,
    DemoExcitation,
    fly_demo_flights,
    fly_demo_record,
)
from mufly.vehicle import load_vehicle

VEHICLE = load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def flights():
    """Yaw, heave, roll, pitch, mixed; begun in motion, in wind and gusts."""
    fitted, mixed = fly_demo_flights(VEHICLE, seed=2, seconds=8.0, moving=True, wind=0.5, gust=0.3)
    return {r.name[5:]: r for r in (*fitted, *mixed)}


def times(r, **factors):
    """The record with outputs multiplied; rate_r is the yaw rate."""
    by = np.array([factors.get("rate_r" if o == "r" else o, 1.0) for o in r.output_names])
    voltage = None if r.voltage is None else r.voltage * factors.get("voltage", 1.0)
    return replace(r, measured=r.measured * by, voltage=voltage)


def late(r, names, samples):
    measured = r.measured.copy()
    for n in names:
        k = r.output_names.index(n)
        measured[:, k] = np.roll(measured[:, k], samples)
    return replace(r, measured=measured).slice_samples(abs(samples), len(r.time_s) - abs(samples))


def driven(r, order, signs=(1, 1, 1, 1)):
    return replace(r, inputs=r.inputs[:, list(order)] * np.array(signs))


def exchanged(r, **pairs):
    names = pairs | {b: a for a, b in pairs.items()}
    return replace(r, measured=r.measured[:, [r.output_names.index(names.get(o, o)) for o in r.output_names]])


def forward_left_up(r, height=1.0):
    return times(r, pitch=-1, q=-1, yaw=-1, rate_r=-1, height=height)


@pytest.mark.parametrize(("gust", "moving"), [(0.0, False), (1.0, True)])
def test_good_records_pass_in_gusts_and_begun_in_motion(gust, moving):
    fitted, mixed = fly_demo_flights(VEHICLE, seed=5, seconds=8.0, moving=moving, wind=0.5 * bool(gust), gust=gust)
    assert check_flight_records([*fitted, *mixed], VEHICLE) == ()


def test_a_record_of_another_size_of_vehicle_passes(flights):
    """Before a fit the vehicle's numbers are right in size only."""
    off = load_vehicle("mufly-1.1").model_dump(exclude_none=True)
    for group, name, factor in (("body", "inertia_pitch", 1.5), ("body", "inertia_yaw", 0.6)):
        if name in off[group]:
            off[group][name]["value"] *= factor
    assert check_flight_records(list(flights.values()), type(VEHICLE).model_validate(off)) == ()


SPOILT = [
    ("pitch", lambda r: driven(r, (0, 1, 2, 3), (1, 1, -1, 1)), "servo_1: inverted .or pitch and q are"),
    ("roll", lambda r: driven(r, (0, 1, 2, 3), (1, 1, 1, -1)), "servo_2: inverted .or roll and p are"),
    ("roll", lambda r: driven(r, (0, 1, 3, 2)), "servo_1, servo_2: act on each other's axis .*are exchanged, or"),
    ("pitch", lambda r: driven(r, (0, 1, 3, 2), (1, 1, -1, -1)), "servo_1, servo_2: .*exchanged and turned round"),
    ("yaw", lambda r: driven(r, (1, 0, 2, 3)), "motor_upper, motor_lower: exchanged"),
    ("pitch", forward_left_up, "pitch, q, yaw, r: .*forward, left, up"),
    ("mixed", lambda r: forward_left_up(r, -1.0), "height: falls where thrust rises"),
    ("heave", lambda r: times(r, height=-1), r"height: falls where thrust rises .gain -(0\.[89]|1)"),
    ("pitch", lambda r: times(r, height=100), "height: .*centimetres"),
    ("heave", lambda r: times(r, voltage=1000), "voltage: reads 6.* 7.2 V: it seems to be in millivolts"),
    ("heave", lambda r: times(r, voltage=0.3), "voltage: .*another or a simulated battery; state .* with --voltage"),
    ("roll", lambda r: times(r, p=0.7), r"p: is 0.[67]\d times the change of roll .*scaled wrong"),
    ("yaw", lambda r: times(r, rate_r=1.5), r"r: is 1.[45]\d times the change of yaw"),
    ("pitch", lambda r: times(r, q=-1), "q: has the opposite sign of the change of pitch"),
    ("pitch", lambda r: exchanged(r, p="q"), "p: does not follow roll, it follows pitch: axes are exchanged"),
    ("roll", lambda r: late(r, ("roll", "pitch", "yaw"), 10), r"roll: comes (99|100|101) \+- \d ms later than p"),
    ("yaw", lambda r: late(r, ("roll", "pitch", "yaw"), -10), r"[pqr]: comes (9|10|11)\d \+- \d+ ms later than"),
    ("mixed", lambda r: replace(r, inputs=r.inputs * 100), "motor_upper: reaches .* per cent"),
    ("mixed", lambda r: replace(r, inputs=r.inputs * 0.3), "motor_upper, motor_lower: lift"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "spoil", "words"), SPOILT, ids=[w[:28] for _, _, w in SPOILT])
def test_spoilt_records_are_refused_by_name(flights, name, spoil, words):
    with pytest.raises(InputError, match=words):
        check_flight_records([spoil(flights[name])], VEHICLE)


def test_a_contradicting_voltage_is_left_out_when_the_fit_uses_another(flights):
    """A simulator's battery may have other cells than the vehicle's."""
    other = times(flights["heave"], voltage=2.2)
    (told,) = check_flight_records([other], VEHICLE, uses_voltage=False)
    assert "another or a simulated battery. The fit does not use it" in told
    assert check_flight_records([flights["heave"]], VEHICLE, uses_voltage=False) == ()


def test_what_one_record_tells_names_what_is_wrong_with_another(flights):
    """The yaw record alone cannot tell exchanged motors from axes that point left and up."""
    with pytest.raises(InputError, match=r"demo-yaw: motor_upper, motor_lower: exchanged .or yaw and r count anti"):
        check_flight_records([forward_left_up(flights["yaw"])], VEHICLE)
    with pytest.raises(InputError, match=r"demo-yaw: pitch, q, yaw, r: .*forward, left, up"):
        check_flight_records([forward_left_up(flights[n]) for n in ("yaw", "pitch")], VEHICLE)


def test_taken_as_it_is_a_record_is_not_refused_but_named(flights):
    said = check_flight_records(
        [times(flights["roll"], p=0.7), driven(flights["yaw"], (1, 0, 2, 3))], VEHICLE, as_is=True
    )
    assert len(said) == 2
    assert "times the change of roll" in said[0]
    assert "exchanged" in said[1]


def test_the_height_of_a_record_that_hardly_moves():
    """Answers to the sensor's own noise tell metres; noise or resolution centimetres; else it is said, not passed."""
    n = 800
    still = DemoExcitation(np.zeros((n, 4)), np.zeros((n, 2)))
    air = DrydenWind((0.5, 0.0, 0.0), 0.3, step_s=DEMO_SAMPLE_S)
    r = fly_demo_record(VEHICLE, still, np.random.default_rng(0), name="hover", air=air)
    assert check_flight_records([r], VEHICLE) == ()  # what the motors do against the sensor's noise is enough
    with pytest.raises(InputError, match=r"height: .*centimetres"):
        check_flight_records([times(r, height=100)], VEHICLE)
    k, slow = r.output_names.index("height"), 150 + 0.3 * np.sin(0.01 * np.arange(n))
    quiet, rounded = r.measured.copy(), r.measured.copy()
    quiet[:, k], rounded[:, k] = slow, np.round(slow)
    rounded[:40, k] = 151
    (said,) = check_flight_records([replace(r, measured=quiet)], VEHICLE)
    assert "height responds too little to thrust to distinguish metres from centimetres" in said
    with pytest.raises(InputError, match=r"height: is resolved to 1 m only: it seems to be in cent"):
        check_flight_records([replace(r, measured=rounded)], VEHICLE)


@pytest.fixture(scope="module")
def steep():
    """Tilted by 40 deg and turning by up to 4 rad/s: rates integrated on the rotation group, without Euler's angles."""
    n, dt = 1500, 0.01
    t = dt * np.arange(n)
    rates = np.column_stack([2.2 * np.cos(3.1 * t), 2.0 * np.sin(2.3 * t + 1), 2.5 + 1.5 * np.sin(0.7 * t)])
    turn, attitude = Rotation.from_euler("ZYX", [0.0, 0.2, -0.5]), np.empty((n, 3))
    for k in range(n):
        attitude[k] = turn.as_euler("ZYX")[::-1]
        turn = turn * Rotation.from_rotvec(0.5 * dt * (rates[k] + rates[min(k + 1, n - 1)]))
    attitude[:, 2] = np.unwrap(attitude[:, 2])
    noise = np.random.default_rng(0).standard_normal((n, 6)) * [0.01, 0.01, 0.01, 0.03, 0.03, 0.03]
    inputs = np.column_stack([0.7 + 0.1 * np.sin(t), 0.7 + 0 * t, np.cos(t), np.sin(t)])
    outputs = ("roll", "pitch", "yaw", "p", "q", "r")
    return FlightRecord("steep", t, inputs, outputs, np.column_stack([attitude, rates]) + noise)


def test_large_angles_and_fast_yaw_raise_no_alarm(steep):
    tilt = np.degrees(np.abs(steep.measured[:, :2]).max(axis=0))
    assert tilt.max() > 40
    assert [w for w in require_consistent_record(steep) if "constant" not in w] == []
    # For small angles p would be the change of roll: it is not.
    small = np.corrcoef(np.diff(steep.measured[:, 0]), steep.measured[1:, 3])[0, 1]
    assert small < 0.9
    with pytest.raises(InputError, match=r"q: is 0.7\d times"):
        require_consistent_record(times(steep, q=0.7))
    with pytest.raises(InputError, match=r"[pq]: comes 1[01]\d \+- \d+ ms later than (roll|pitch)"):
        require_consistent_record(late(steep, ("p", "q", "r"), 11))
    without_yaw = steep.select_outputs(["roll", "pitch", "p", "q", "r"])
    assert [w for w in require_consistent_record(without_yaw) if "constant" not in w] == []
    (said, *_) = require_consistent_record(steep.select_outputs(["roll", "p"]))
    assert "the tilt is too large for the check" in said


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (3.6, "v_north: is 3.60 times the rate at which north changes: it seems to be in kilometres an hour"),
        (0.01, r"north: changes (9\d|10\d) times as fast as v_north says: it seems to be in centimetres"),
        (1.3, r"v_north: is 1.3\d times the change of north"),
        (-1, "v_north: has the opposite sign"),
    ],
)
def test_places_against_velocities(factor, words):
    t = 0.02 * np.arange(1000)
    north, east = np.sin(0.9 * t), np.cos(2.3 * t)
    v_north, v_east = 0.9 * np.cos(0.9 * t), -2.3 * np.sin(2.3 * t)
    inputs = np.column_stack([0.7 + 0.1 * np.sin(t)] * 4)
    names = ("north", "east", "v_north", "v_east")
    noise = 0.003 * np.random.default_rng(0).standard_normal((1000, 4))

    def made(*columns):
        return FlightRecord("places", t, inputs, names, np.column_stack(columns) + noise)

    assert require_consistent_record(made(north, east, v_north, v_east)) == ()
    with pytest.raises(InputError, match=words):
        require_consistent_record(made(north, east, factor * v_north, v_east))
    with pytest.raises(InputError, match="v_north: does not follow north, it follows east: axes are exchanged"):
        require_consistent_record(made(north, east, v_east, v_north))
