"""Whatever a link brings, a station takes it: every message with random and extreme fields, and bytes that are none."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from mock_vehicle import MockVehicle, World

from mufly.link import mavlink

_EXTREME = {
    "float": [0.0, -0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 3.4e38, 1e-45],
    "double": [0.0, math.nan, math.inf, 1e300],
}


def _value(rng, kind, length):
    if kind == "char":
        return bytes(rng.randrange(256) for _ in range(rng.randrange(length + 1) if length else 1))
    if kind in _EXTREME:
        return rng.choice([*_EXTREME[kind], rng.uniform(-1e3, 1e3)])
    bits = int("".join(c for c in kind.split("_")[0] if c.isdigit()))
    least, most = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return rng.choice([least, most, 0, min(1, most), rng.randint(least, most), rng.randint(0, min(most, 20))])


def _message(rng, kind, us):
    """A message with random fields; every other one is meant for us."""
    arguments = []
    by_name = {n: (t, length) for n, t, length in zip(kind.fieldnames, kind.fieldtypes, _lengths(kind), strict=True)}
    for name in kind.fieldnames:
        of, length = by_name[name]
        if name == "target_system" and rng.random() < 0.7:
            arguments.append(us[0])
        elif of == "char":
            arguments.append(_value(rng, of, length))
        elif length:
            arguments.append([_value(rng, of, 0) for _ in range(length)])
        else:
            arguments.append(_value(rng, of, 0))
    return kind(*arguments)


def _lengths(kind):
    order = {name: k for k, name in enumerate(kind.ordered_fieldnames)}
    return [kind.array_lengths[order[name]] for name in kind.fieldnames]


@pytest.mark.parametrize("seed", range(3))
def test_every_message_with_extreme_fields(seed):
    rng = random.Random(seed)
    mock = MockVehicle(ours=seed == 0)
    world = World(mock)
    world.run(2.0)
    vehicle = world.seen[0]
    for ask in (vehicle.download_mission, vehicle.request_operator_control, lambda: vehicle.take_off(1.0)):
        ask()
    vehicle.set_parameter("A", 2.0)
    kinds = list(mavlink.mavlink_map.values())
    for k in range(2500):
        kind = kinds[k % len(kinds)] if rng.random() < 0.6 else rng.choice(_HEARD)
        message = _message(rng, kind, (255, 190))
        mock.extra.append(message)
        if k % 4 == 0:
            world.station.process_bytes(
                world.t, world.peer(0), bytes(rng.randrange(256) for _ in range(rng.randrange(80)))
            )
            world.run(0.02)
        if k % 100 == 0:
            _looked_at(vehicle)
    faults = [m.text for v in world.seen for m in v.status_messages if "not processed" in m.text]
    assert faults == []
    assert len(world.seen) <= 32
    # It still works for the vehicle that was there all along.
    world.run(15.0)
    assert world.answer(vehicle.arm(), 60.0)[0] == "accepted"
    times, _ = vehicle.history.recent_rows(1e9)
    assert (np.diff(times) > 0).all()


_HEARD = [
    mavlink.mavlink_map[getattr(mavlink, f"MAVLINK_MSG_ID_{name}")]
    for name in [
        "HEARTBEAT",
        "SYS_STATUS",
        "BATTERY_STATUS",
        "ATTITUDE",
        "ATTITUDE_TARGET",
        "LOCAL_POSITION_NED",
        "POSITION_TARGET_LOCAL_NED",
        "OBSTACLE_DISTANCE",
        "DISTANCE_SENSOR",
        "STATUSTEXT",
        "PARAM_VALUE",
        "MISSION_COUNT",
        "MISSION_ITEM_INT",
        "MISSION_ITEM",
        "MISSION_ACK",
        "MISSION_REQUEST_INT",
        "MISSION_CURRENT",
        "MISSION_ITEM_REACHED",
        "COMMAND_ACK",
        "AUTOPILOT_VERSION",
        "NAMED_VALUE_INT",
        "GLOBAL_POSITION_INT",
        "HOME_POSITION",
        "DEBUG_FLOAT_ARRAY",
        "RC_CHANNELS",
        "SERVO_OUTPUT_RAW",
        "CHANGE_OPERATOR_CONTROL_ACK",
    ]
]


def _looked_at(vehicle):
    """What a page looks at."""
    with np.errstate(all="ignore"):
        assert vehicle.snapshot.estimate.position.shape == (3,)
        assert vehicle.display_name
        assert all(check.text is not None for check in vehicle.preflight_checks)
        assert isinstance(vehicle.mission_rows, list)
        assert isinstance(vehicle.parameters, dict)
