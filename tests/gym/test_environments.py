"""Gymnasium environments: contract, repeatability, tasks, and what episodes draw."""

import math
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed")

import mufly.gym  # noqa: E402
from mufly.dynamics import find_trim, initial_state  # noqa: E402
from mufly.errors import ArgumentError, MuflyError  # noqa: E402
from mufly.flight.policy.observation import (  # noqa: E402
    OBS_DOWN_DIRECTION,
    OBS_HEADING,
    OBS_HEIGHT,
    OBS_POSITION_ERROR,
    OBS_RATES,
    OBS_TASK_INPUTS,
    OBS_VELOCITY,
    map_action_to_inputs,
)
from mufly.gym.vector_env import MuflyEnv, MuflyVectorEnv  # noqa: E402

RANDOMISED = {
    "vary": ["parameters=10%"], "fleet_size": 3, "wind_m_s": 1.0, "gust_m_s": 0.5, "delay_s": 0.02, "sensors": "noisy",
}  # fmt: skip


@pytest.mark.parametrize("name", mufly.gym.ENVIRONMENT_IDS)
def test_gymnasium_accepts_every_environment(name: str) -> None:
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(name, render_mode="rgb_array").unwrapped)


def test_gymnasium_finds_the_environments_by_the_entry_point() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    module, _, function = project["entry-points"]["gymnasium.envs"]["__root__"].partition(":")
    assert getattr(__import__(module, fromlist=[function]), function) is mufly.gym.register_environments
    assert isinstance(gymnasium.make_vec("mufly/Land-v0", num_envs=2).unwrapped, MuflyVectorEnv)


@pytest.mark.parametrize("task", ["hover", "waypoint", "obstacle", "land"])
def test_vector_moves_as_single_environments_to_the_last_bit(task: str) -> None:
    options = {**RANDOMISED, "task": task, "duration_s": 0.4}
    together = MuflyVectorEnv(3, autoreset_mode="SameStep", **options)
    alone = [MuflyEnv(**options) for _ in range(3)]
    seen, _ = together.reset(seed=5)
    first = np.array([env.reset(seed=5 + k)[0] for k, env in enumerate(alone)])
    assert seen.tobytes() == first.tobytes()
    rng, ends = np.random.default_rng(0), 0
    for _ in range(45):
        actions = rng.uniform(-1, 1, (3, 4)).astype(np.float32)
        seen, rewards, terminated, truncated, info = together.step(actions)
        for k, env in enumerate(alone):
            one, reward, over, late, _ = env.step(actions[k])
            assert (reward, over, late) == (rewards[k], terminated[k], truncated[k])
            last = info["final_obs"] if over or late else seen
            assert one.tobytes() == last[k].tobytes()
            if over or late:
                ends += 1
                assert env.reset()[0].tobytes() == seen[k].tobytes()
    assert ends >= 6


def run(mode: str, seed: int = 3) -> list[bytes]:
    env = MuflyVectorEnv(4, autoreset_mode=mode, duration_s=0.2, **RANDOMISED)
    rng, out = np.random.default_rng(1), [env.reset(seed=seed)[0].tobytes()]
    for _ in range(25):
        seen, rewards, terminated, truncated, _ = env.step(rng.uniform(-1, 1, (4, 4)))
        out += [seen.tobytes(), rewards.tobytes()]
        if mode == "Disabled" and (ended := terminated | truncated).any():
            env.reset(options={"reset_mask": ended})
    return out


def test_a_seed_repeats_to_the_last_bit_and_another_does_not() -> None:
    assert run("SameStep") == run("SameStep")
    assert run("SameStep")[0] != run("SameStep", seed=4)[0]


def test_next_step_mode_ignores_the_action_after_an_end() -> None:
    env = MuflyVectorEnv(2, duration_s=0.06)
    env.reset(seed=0)
    for _ in range(3):
        _, _, _, truncated, _ = env.step(np.zeros((2, 4)))
    assert truncated.all()
    start, rewards, terminated, truncated, _ = env.step(np.ones((2, 4)))
    assert not (rewards.any())
    assert not (terminated.any())
    assert not truncated.any()
    assert (start[:, 15:19] == 0.0).all()
    assert (env.episodes.step_count == 0).all()


def test_disabled_mode_demands_a_reset() -> None:
    env = MuflyVectorEnv(2, autoreset_mode="Disabled", duration_s=0.02)
    env.reset(seed=0)
    env.step(np.zeros((2, 4)))
    with pytest.raises(ArgumentError, match="an episode has ended"):
        env.step(np.zeros((2, 4)))
    env.reset(options={"reset_mask": np.array([True, True])})
    env.step(np.zeros((2, 4)))


def placed(task: str, **state: object) -> tuple[MuflyEnv, np.ndarray]:
    """Return an environment in a given state, in hover by default, and the trim's action of zero."""
    env = MuflyEnv(task=task)
    env.reset(seed=0)
    hover = find_trim(env.vector.vehicle, charge=0.8)
    x = initial_state(**{"rotor_speed": hover.state[18:20], "charge": 0.8, **state})
    env.vector.episodes.state[0] = x
    if task == "hover":
        env.vector.episodes.target[0] = 0.0, 0.0, -1.0
    env.vector.episodes.distance[0] = np.linalg.norm(env.vector.episodes.target[0] - x[:3])
    env.vector.episodes.heading[0] = 1.0, 0.0
    env.vector.episodes.speed[0] = np.linalg.norm(x[3:6])
    return env, np.zeros(4, dtype=np.float32)


def test_hover_at_the_target_earns_one_a_step_and_far_away_less() -> None:
    env, zero = placed("hover", position=(0, 0, -1))
    assert env.step(zero)[1] == pytest.approx(1.0, abs=0.02)
    env, zero = placed("hover", position=(1, 0, -1))
    assert env.step(zero)[1] == pytest.approx(0.3 / 5 + 0.3 / 101 + 0.4, abs=0.02)


def test_action_of_zero_holds_the_nominal_vehicle_and_observation_has_the_true_state() -> None:
    env, zero = placed("hover", position=(0.2, -0.1, -1.3), attitude=(0, 0, 0.5))
    seen = env.step(zero)[0]
    c, s = math.cos(0.5), math.sin(0.5)
    assert seen[OBS_POSITION_ERROR : OBS_POSITION_ERROR + 3] == pytest.approx(
        [-0.2 * c + 0.1 * s, 0.1 * c + 0.2 * s, 0.3], abs=2e-3
    )
    assert seen[OBS_VELOCITY : OBS_VELOCITY + 3] == pytest.approx(np.zeros(3), abs=0.03)
    assert seen[OBS_DOWN_DIRECTION : OBS_DOWN_DIRECTION + 3] == pytest.approx([0, 0, 1], abs=1e-2)
    assert seen[OBS_RATES : OBS_RATES + 3] == pytest.approx(np.zeros(3), abs=0.1)
    assert seen[OBS_HEADING : OBS_HEADING + 2] == pytest.approx([-s, c], abs=2e-3)
    assert seen[OBS_HEIGHT] == pytest.approx(1.3, abs=2e-3)


@pytest.mark.parametrize(
    ("action", "place", "sign"),
    [
        ([1, 0, 0, 0], OBS_VELOCITY + 2, -1),  # collective: climbs
        ([0, 1, 0, 0], OBS_RATES + 2, 1),  # turns to the right
        ([0, 0, 1, 0], OBS_VELOCITY, 1),  # forward
        ([0, 0, 0, 1], OBS_VELOCITY + 1, 1),  # right
    ],
)
def test_actions_move_the_vehicle_as_named(action: list[float], place: int, sign: int) -> None:
    env, _ = placed("hover", position=(0, 0, -1))
    for _ in range(15):
        seen = env.step(np.array(action, dtype=np.float32))[0]
    assert sign * seen[place] > 0.05


def test_episodes_end_as_the_tasks_say() -> None:
    env, zero = placed("hover", position=(0, 0, -0.05))
    assert env.step(zero)[1:3] == (0.0, True)
    env, zero = placed("hover", position=(0, 0, -1), attitude=(1.2, 0, 0))
    assert env.step(zero)[2]
    env, zero = placed("hover", position=(3.2, 0, -1))
    assert env.step(zero)[2]
    down = {"velocity": (0, 0, 0.3)}
    env, zero = placed("land", position=(0.1, 0, -0.062), **down)
    _, reward, terminated, _, info = env.step(zero)
    assert terminated
    assert info["success"]
    assert reward == pytest.approx(9.5, abs=0.2)
    env, zero = placed("land", position=(0.1, 0, -0.07), velocity=(0, 0, 1.0))
    _, reward, terminated, _, info = env.step(zero)
    assert terminated
    assert not info["success"]
    assert reward == -5.0


def test_a_waypoint_is_followed_by_the_observed_next_one() -> None:
    env, zero = placed("waypoint")
    e = env.vector.episodes
    e.state[0, :3] = e.target[0] + [0.1, 0.0, 0.0]
    after = e.next_target[0].copy()
    seen, reward, terminated, _, info = env.step(zero)
    assert info["success"]
    assert not terminated
    assert reward > 4.0
    assert (e.target[0] == after).all()
    assert np.linalg.norm(seen[OBS_TASK_INPUTS:]) == pytest.approx(
        np.linalg.norm(e.next_target[0] - e.state[0, :3]), abs=1e-5
    )


def test_obstacle_measures_columns_and_ends_at_one() -> None:
    env, zero = placed("obstacle", position=(-2, 0, -1))
    e = env.vector.episodes
    e.pillars[0] = 0.0
    e.pillars[0, :] = [-1.0, 0.0, 0.2, -2.5, 0.0]
    ranges = env.step(zero)[0][OBS_TASK_INPUTS:]
    assert ranges[[0, 2, 4, 6]] == pytest.approx([0.8, 2.0, 1.0, 2.0], abs=0.02)
    e.state[0, 0] = -1.25
    _, reward, terminated, _, info = env.step(zero)
    assert terminated
    assert reward == -5.0
    assert not info["success"]


def test_fleet_wind_delay_and_errors_differ_between_episodes() -> None:
    env = MuflyVectorEnv(200, **RANDOMISED)
    seen, _ = env.reset(seed=0)
    e = env.episodes
    assert set(e.vehicle_index) == {0, 1, 2}
    assert set(e.delay_steps) == set(range(21))
    assert len({float(m) for m in env.fleet.parameters["mass"]}) == 3
    assert np.hypot(*e.wind_velocity[:, :2].T).max() > 0.3
    true = e.target[:, 2] - e.state[:, 2]
    error = seen[:, OBS_POSITION_ERROR + 2] - true
    fix = env.vehicle.sensors.position_fix
    assert np.std(error) == pytest.approx(math.hypot(float(fix.noise), float(fix.drift)), rel=0.2)


def test_a_delayed_action_acts_later_in_the_step() -> None:
    full = np.array([1, 0, 0, 0], dtype=np.float32)
    late, _ = placed("hover", position=(0, 0, -1))
    prompt, _ = placed("hover", position=(0, 0, -1))
    late.vector.episodes.delay_steps[0] = 10
    late.step(full)
    prompt.step(full)
    x, y = late.vector.episodes.state[0, 18], prompt.vector.episodes.state[0, 18]
    trim = find_trim(late.vector.vehicle, charge=0.8).state[18]
    assert 0.4 < (x - trim) / (y - trim) < 0.6


def test_wrong_options_and_actions_are_refused_with_a_remedy() -> None:
    with pytest.raises(ArgumentError, match=r"delay_s: 0.5 is out of range; give 0 to 0.02 s, a period"):
        MuflyVectorEnv(2, delay_s=0.5)
    with pytest.raises(ArgumentError, match="task"):
        MuflyVectorEnv(2, task="loop")
    with pytest.raises(MuflyError, match="can hover"):
        MuflyVectorEnv(2, vary=["body.mass=300:400%"], fleet_size=2)
    env = MuflyVectorEnv(2)
    with pytest.raises(ArgumentError, match="call reset first"):
        env.step(np.zeros((2, 4)))
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="NaN"):
        env.step(np.full((2, 4), np.nan))
    with pytest.raises(ArgumentError, match=r"give \(2, 4\)"):
        env.step(np.zeros(4))


def test_actions_saturate_at_the_inputs() -> None:
    inputs = np.empty(4)
    map_action_to_inputs(np.array([1.0, 1.0, -1.0, 0.5]), np.array([0.7, 0.6, 0.0, 0.0]), inputs)
    assert inputs == pytest.approx([1.0, 0.75, -1.0, 0.5])


def test_picture_shows_vehicle_and_columns() -> None:
    env = gymnasium.make("mufly/Obstacle-v0", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (360, 720, 3)
    assert {(31, 119, 180), (140, 86, 75), (214, 39, 40)} <= {tuple(c) for c in picture.reshape(-1, 3).tolist()}
