"""Learn to hover with Stable-Baselines3, and save the policy for `mufly fly --policy`.

    pip install "mufly[gym]" stable-baselines3
    python learn_to_hover.py --out hover-policy.json
    mufly fly --headless --policy hover-policy.json

The vehicle, its wind, the delay of its actions and the errors of its estimate differ from episode to episode.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

import mufly.gym
from mufly.flight.policy import LearnedPolicy, PolicyLayer, save_policy

RANDOMISED = {
    "vary": ["parameters=10%"], "wind_m_s": 0.5, "gust_m_s": 0.3, "delay_s": 0.01, "sensors": "noisy",
}  # fmt: skip


class CompiledVecEnv(VecEnv):
    """Stable-Baselines3's interface of a compiled vector of environments."""

    def __init__(self, name: str, num_envs: int, **options: Any) -> None:
        self.env = gymnasium.make_vec(name, num_envs=num_envs, autoreset_mode="SameStep", **options)
        super().__init__(num_envs, self.env.single_observation_space, self.env.single_action_space)
        self._seed = 0

    def reset(self) -> np.ndarray:
        return self.env.reset(seed=self._seed)[0]

    def seed(self, seed: int | None = None) -> list[int | None]:
        self._seed = seed or 0
        return [self._seed + k for k in range(self.num_envs)]

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        seen, rewards, terminated, truncated, info = self.env.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for k in np.flatnonzero(terminated | truncated):
            infos[k] = {"terminal_observation": info["final_obs"][k], "TimeLimit.truncated": bool(truncated[k])}
        return seen, rewards.astype(np.float32), terminated | truncated, infos

    def close(self) -> None:
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [None if attr_name == "render_mode" else getattr(self.env, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        return [getattr(self.env, method_name)(*args, **kwargs)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def judge_policy(model: PPO, episodes: int = 200) -> tuple[float, float, float]:
    """Return falls (share), and median and 95 % quantile of the distance (m) after 5 s, over new episodes."""
    env = gymnasium.make_vec(
        "mufly/Hover-v0", num_envs=episodes, autoreset_mode="NextStep", fleet_seed=99, **RANDOMISED
    )
    seen, _ = env.reset(seed=10_000)
    fallen, distances = np.zeros(episodes, dtype=bool), []
    for k in range(500):
        seen, _, terminated, _, _ = env.step(model.predict(seen, deterministic=True)[0])
        fallen |= terminated
        if k >= 250:
            distances.append(env.unwrapped.episodes.distance[~fallen].copy())
    far = np.concatenate(distances)
    return float(fallen.mean()), float(np.median(far)), float(np.quantile(far, 0.95))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=10_000_000, help="steps of all environments together")
    parser.add_argument("--envs", type=int, default=256, help="environments")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("hover-policy.json"), help="file of the policy")
    args = parser.parse_args()
    begin = time.process_time()
    model = PPO(
        "MlpPolicy", CompiledVecEnv("mufly/Hover-v0", args.envs, **RANDOMISED), n_steps=64, batch_size=2048, n_epochs=5,
        gamma=0.99, gae_lambda=0.95, learning_rate=lambda left: 1e-3 * left, ent_coef=0.0, seed=args.seed,
        policy_kwargs={"net_arch": [32, 32], "log_std_init": -1.0}, verbose=0, device="cpu",
    )  # fmt: skip
    model.learn(args.steps)
    taken = time.process_time() - begin
    falls, median, most = judge_policy(model)
    print(f"learnt in {taken:.0f} s of processor time: falls {falls:.1%}, distance {median:.3f} m (95 %: {most:.3f} m)")
    save_policy(make_policy(model, {"steps": float(args.steps), "seed": float(args.seed)}), args.out)
    print(f"written to {args.out}")


def make_policy(model: PPO, training: dict[str, str | float]) -> LearnedPolicy:
    """Return the network of the mean action; observations are not normalised, and hidden layers are tanh."""
    env = model.get_env().env.unwrapped
    state = {name: value.numpy().astype(np.float64) for name, value in model.policy.state_dict().items()}
    names = {"mlp_extractor.policy_net.0": "tanh", "mlp_extractor.policy_net.2": "tanh", "action_net": "linear"}
    size = env.single_observation_space.shape[0]
    return LearnedPolicy(
        task=env.task, vehicle_name=env.vehicle.name, period_s=env.period_s, trim_inputs=env.fleet.nominal_hover_inputs,
        nominal_voltage_V=env.fleet.nominal_voltage_V, observation_mean=np.zeros(size),
        observation_scale=np.ones(size),
        observation_limit=float(env.single_observation_space.high.max()),
        layers=tuple(PolicyLayer(state[f"{n}.weight"], state[f"{n}.bias"], act) for n, act in names.items()),
        training=training,
    )  # fmt: skip


if __name__ == "__main__":
    assert mufly.gym.ENVIRONMENT_IDS
    main()
