"""Environments on simulated sensors and filter: equal to a flight to the last bit; starts, errors and refusals."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed")

from mufly.control import design_flight_controller  # noqa: E402
from mufly.dynamics.model_state import (  # noqa: E402
    ATTITUDE_SLICE,
    BODY_RATE_SLICE,
    MODEL_CHARGE,
    NED_POSITION_SLICE,
    NED_VELOCITY_SLICE,
)
from mufly.errors import ArgumentError, MuflyError  # noqa: E402
from mufly.firmware import find_compiler  # noqa: E402
from mufly.flight.controllers import Actuators  # noqa: E402
from mufly.gym import filter_units  # noqa: E402
from mufly.gym.vector_env import MuflyEnv, MuflyVectorEnv  # noqa: E402
from mufly.vehicle import load_vehicle  # noqa: E402

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
OPTIONS = {"sensors": "fitted", "fleet_size": 2, "wind_m_s": 0.5, "gust_m_s": 0.3}


@pytest.fixture(scope="module", autouse=True)
def filter_in_c() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MUFLY_ESTIMATOR", "c")
        yield


def test_a_unit_equals_a_flight_to_the_last_bit() -> None:
    vehicle = filter_units.remove_range_ring(load_vehicle("mufly-1.1"))
    mission = filter_units.make_hover_mission(0, 1.0, 30.0)
    flight = filter_units.fly_to_hover(
        vehicle, vehicle, design_flight_controller(vehicle), mission, np.array([0.3, -0.2, 0.0]), 0.8, 5
    )
    assert flight is not None
    unit, memory = filter_units.extract_unit_arrays(flight, 4)
    room = filter_units.UnitMemoryLayout(unit, memory, flight.estimator)
    row = np.zeros((1, room.size), np.uint8)
    room.write_row(unit, memory, row[0])
    starts = filter_units.HoverStarts(row, unit, None, 0.005, (flight,))
    units = filter_units.FilteredVehicles(starts, room, 1, 4, 1)
    before, state = np.zeros((1, 4)), np.zeros((1, 21))
    rng = np.random.default_rng(0)
    for _ in range(30):
        inputs = flight.sent_actuators.input_array + rng.uniform(-0.02, 0.02, (1, 4))
        wind = rng.uniform(-0.5, 0.5, (1, 3))
        units.advance_units(
            SimpleNamespace(
                previous_inputs=before, inputs=inputs, delay_steps=np.array([1]), wind_velocity=wind, state=state
            )
        )
        # The same in objects: one period of computing time and one of delay before the inputs act.
        sent = [before[0], inputs[0], inputs[0], inputs[0], inputs[0]]
        flight.sent_actuators = Actuators(sent[0][:2].copy(), sent[0][2:].copy())
        for j in range(4):
            plant = flight.plant
            acted = flight.acting_actuators
            plant.upcoming_wind(1)[:] = wind
            plant.advance_period(acted)
            flight.acting_actuators = flight.sent_actuators
            estimate = flight.estimator.update(flight.sensors.read(plant.truth), acted.input_array)
            flight.sent_actuators = Actuators(sent[j + 1][:2].copy(), sent[j + 1][2:].copy())
        before = inputs
        assert state[0].tobytes() == plant.state.tobytes()
        assert units.estimate[0, NED_POSITION_SLICE].tobytes() == estimate.position.tobytes()
        assert units.estimate[0, NED_VELOCITY_SLICE].tobytes() == estimate.velocity.tobytes()
        assert units.estimate[0, BODY_RATE_SLICE].tobytes() == estimate.rates.tobytes()
        assert units.volts[0] == estimate.battery_voltage


def test_vector_moves_as_single_environments_and_a_seed_repeats() -> None:
    options = {**OPTIONS, "task": "waypoint", "duration_s": 0.2, "delay_s": 0.01}
    together = MuflyVectorEnv(2, autoreset_mode="SameStep", threads=2, **options)
    alone = [MuflyEnv(**options) for _ in range(2)]
    seen, _ = together.reset(seed=5)
    first = np.array([env.reset(seed=5 + k)[0] for k, env in enumerate(alone)])
    assert seen.tobytes() == first.tobytes()
    rng, ends = np.random.default_rng(0), 0
    for _ in range(25):
        actions = rng.uniform(-1, 1, (2, 4)).astype(np.float32)
        seen, rewards, terminated, truncated, info = together.step(actions)
        for k, env in enumerate(alone):
            one, reward, over, late, _ = env.step(actions[k])
            assert (reward, over, late) == (rewards[k], terminated[k], truncated[k])
            assert one.tobytes() == (info["final_obs"] if over or late else seen)[k].tobytes()
            if over or late:
                ends += 1
                assert env.reset()[0].tobytes() == seen[k].tobytes()
    assert ends >= 4
    assert together.reset(seed=5)[0].tobytes() == first.tobytes()
    assert together.reset(seed=6)[0].tobytes() != first.tobytes()


def test_observation_is_the_estimate_and_starts_are_hovers_of_flights() -> None:
    env = MuflyVectorEnv(12, autoreset_mode="Disabled", **OPTIONS)
    env.reset(seed=1)
    state = env.episodes.state
    assert np.linalg.norm(state[:, NED_VELOCITY_SLICE], axis=1).max() < 0.3
    assert len({float(c) for c in state[:, MODEL_CHARGE]}) in range(5, 9)  # of two flights at four instants each
    assert ((env.episodes.target[:, 2] <= -0.2) & (env.episodes.target[:, 2] >= -2.0)).all()
    assert (np.abs(env.episodes.target - state[:, NED_POSITION_SLICE])[:, :2] <= 0.5 + 1e-9).all()
    for _ in range(25):
        env.step(np.zeros((12, 4)))
    errors = env.units.estimate[:, NED_POSITION_SLICE] - state[:, NED_POSITION_SLICE]
    assert 1e-4 < np.abs(errors).max() < 0.4  # wanders of the fix of 6 cm, not a copy of the truth
    turned = np.abs(np.sum(env.units.estimate[:, ATTITUDE_SLICE] * state[:, ATTITUDE_SLICE], axis=1))
    assert 2.0 * np.arccos(np.minimum(turned, 1.0)).max() < math.radians(12.0)
    # Units of one stored start differ: their random numbers are new.
    same = [np.flatnonzero(env.episodes.vehicle_index == v) for v in range(8)]
    pairs = [s[:2] for s in same if len(s) > 1]
    assert pairs
    assert all(env.units.volts[a] != env.units.volts[b] or (errors[a] != errors[b]).any() for a, b in pairs)


def test_refusals_name_the_remedy() -> None:
    with pytest.raises(ArgumentError, match="multiple of 5 ms"):
        MuflyEnv(sensors="fitted", period_s=0.012, fleet_size=1)
    with pytest.raises(ArgumentError, match=r"no sensors\.imu"):
        MuflyEnv(sensors="fitted", vehicle=load_vehicle("mufly-1.1").model_copy(update={"sensors": None}))


def test_without_the_filter_in_c_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUFLY_ESTIMATOR", "numba")
    with pytest.raises(MuflyError, match="needs the filter in C"):
        MuflyEnv(sensors="fitted", fleet_size=1)
