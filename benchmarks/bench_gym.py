"""How fast are the environments for learning, beside crazyflow and the machine's limit? Do they leak or differ?

    python benchmarks/bench_gym.py [--envs 1024] [--peer-python PYTHON]     # steps a second (1 min)
    python benchmarks/bench_gym.py --profile                                # share of each part of a step
    python benchmarks/bench_gym.py --leak 1000000                           # memory; a seed twice; vector beside single

A step is 20 ms of mufly/Hover-v0 with drawn actions, on one core. One row has the simulated sensors and the filter.
Rates are those of the best of many short runs in processor time, which a shared machine disturbs least. The machine's
limit is the rate of multiply-adds in vector registers of one core, over the operations of 20 Runge-Kutta steps
(``bench_dynamics.py``).

The peer is crazyflow's DroneReachPos-v0 at 50 Hz on one core (identified attitude dynamics of a quadrotor without
rotors, 10 Euler steps). It runs in the environment of another Python, in which ``pip install crazyflow`` was called.
"""

from __future__ import annotations

import argparse
import cProfile
import hashlib
import json
import math
import os
import pstats
import resource
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
from bench_dynamics import machine_limit, operations_per_step

import mufly.gym
from mufly.dynamics import find_trim, model_parameters
from mufly.gym.vector_env import MuflyEnv, MuflyVectorEnv
from mufly.vehicle import load_vehicle

TARGET, FITTED_TARGET = 400_000, 30_000
FITTED = "sensors and filter, 32 units, wind"
RANDOMISED = {
    "vary": ["parameters=10%"], "fleet_size": 8, "wind_m_s": 0.5, "gust_m_s": 0.3, "delay_s": 0.01, "sensors": "noisy",
}  # fmt: skip

PEER = """
import os, sys, time
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import gymnasium, jax, numpy as np
import crazyflow, crazyflow.envs
n, runs = int(sys.argv[1]), int(sys.argv[2])
env = gymnasium.make_vec("DroneReachPos-v0", num_envs=n, freq=50, device="cpu")
env.reset(seed=0)
low, high = env.action_space.low, env.action_space.high
actions = np.random.default_rng(0).uniform(0.4 * low + 0.3 * (low + high), 0.4 * high + 0.3 * (low + high), low.shape)
actions = jax.numpy.asarray(actions, dtype="float32")
def run(k):
    begin = time.process_time()
    for _ in range(k):
        out = env.step(actions)
    jax.block_until_ready(out[:4])
    return k * n / (time.process_time() - begin)
run(20)
print(crazyflow.__version__ if hasattr(crazyflow, "__version__") else "?", max(run(10) for _ in range(runs)))
"""


def fastest(run: Callable[[], int], repeats: int) -> float:
    """Greatest of several rates, in units of ``run`` a second of processor time."""
    rate = 0.0
    for _ in range(repeats):
        begin = time.process_time()
        count = run()
        rate = max(rate, count / (time.process_time() - begin))
    return rate


def make_runner(count: int, steps: int, **options: object) -> Callable[[], int]:
    """Return a function that steps a vector of environments and returns the number of steps."""
    env = gymnasium.make_vec("mufly/Hover-v0", num_envs=count, autoreset_mode="SameStep", **options)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (16, count, 4)).astype(np.float32)

    def run() -> int:
        for k in range(steps):
            env.step(actions[k % 16])
        return steps * count

    run()
    return run


def measure_rates(count: int, peer_python: str, repeats: int) -> dict[str, float]:
    """Return environment steps a second of ours and of the peer, and the machine's limit."""
    found = {
        "ideal sensors": fastest(make_runner(count, 4), repeats),
        "ideal sensors, 32 drawn vehicles, wind": fastest(
            make_runner(count, 4, vary=["parameters=10%"], wind_m_s=0.5, gust_m_s=0.3), repeats
        ),
        "noisy estimate, 8 drawn vehicles, wind, delay": fastest(make_runner(count, 4, **RANDOMISED), repeats),
        FITTED: fastest(
            make_runner(min(count, 256), 4, sensors="fitted", vary=["parameters=10%"], wind_m_s=0.5, gust_m_s=0.3),
            repeats,
        ),
        "one environment": fastest(make_runner(1, 200), max(repeats // 4, 1)),
    }
    vehicle = load_vehicle("mufly-1.1")
    hover = find_trim(vehicle)
    operations = 20 * operations_per_step(model_parameters(vehicle), hover.state, hover.input)
    found["limit: multiply-adds in vectors"] = machine_limit(1)[1] / operations
    if peer_python and Path(peer_python).exists():
        done = subprocess.run(
            [peer_python, "-c", PEER, str(count), str(repeats)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            print(f"crazyflow: skipped, it does not run: {done.stderr.strip().splitlines()[-1]}")
        else:
            version, rate = done.stdout.split()[-2:]
            found[f"peer: crazyflow {version}".removesuffix(" ?")] = float(rate)
    else:
        print("crazyflow: skipped, no --peer-python with it")
    return found


def print_rates(found: dict[str, float]) -> None:
    limit = found["limit: multiply-adds in vectors"]
    peer = next((rate for name, rate in found.items() if name.startswith("peer")), math.nan)
    print(
        f"{'environment steps of 20 ms, one core':48s} {'1/s':>9s} {'of target':>9s} {'of peer':>8s} {'of limit':>8s}"
    )
    for name, rate in found.items():
        target = FITTED_TARGET if name == FITTED else TARGET
        print(f"{name:48s} {rate:9,.0f} {rate / target:9.2f} {rate / peer:8.2f} {rate / limit:8.1%}")


def profile_step(count: int) -> None:
    """Print the share of every part of a step."""
    run = make_runner(count, 200)
    profile = cProfile.Profile()
    profile.runcall(run)
    pstats.Stats(profile).sort_stats("tottime").print_stats(12)


def resident_MB() -> float:
    """Memory of this process that is resident (MB)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def check_memory(steps: int) -> None:
    """Print resident memory while environments of all tasks step and end, after a warm-up of a tenth."""
    envs = [MuflyVectorEnv(100, task=task, **RANDOMISED) for task in ("hover", "waypoint", "obstacle", "land")]
    envs.append(MuflyVectorEnv(100, **{**RANDOMISED, "sensors": "fitted"}))
    single = MuflyEnv(**RANDOMISED)
    rng, done, ends, begin = np.random.default_rng(0), 0, 0, math.nan
    for k, env in enumerate(envs):
        env.reset(seed=k)
    single.reset(seed=9)
    after = 0.0
    while done < 1.1 * steps:
        for env in envs:
            _, _, terminated, truncated, _ = env.step(rng.uniform(-1.0, 1.0, (100, 4)))
            ends += int((terminated | truncated).sum())
        _, _, over, late, _ = single.step(rng.uniform(-1.0, 1.0, 4))
        if over or late:
            single.reset()
        done += 501
        if math.isnan(begin) and done >= 0.1 * steps:
            begin, after, counted = resident_MB(), 0.0, ends
        after = resident_MB()
    print(f"{steps:,} steps, {ends - counted:,} episodes: {begin:.1f} MB before, {after:.1f} MB after")


def digest_run(count: int, seed: int, steps: int, task: str) -> str:
    """Return a hash of all that an environment answers."""
    env, rng, digest = MuflyVectorEnv(count, task=task, **RANDOMISED), np.random.default_rng(1), hashlib.sha256()
    digest.update(env.reset(seed=seed)[0].tobytes())
    for _ in range(steps):
        for answer in env.step(rng.uniform(-1.0, 1.0, (count, 4)))[:4]:
            digest.update(answer.tobytes())
    return digest.hexdigest()


def check_equality(steps: int) -> None:
    """Print whether two runs of a seed are equal, and a vector to single environments, to the last bit."""
    count = 10
    for task in ("hover", "waypoint", "obstacle", "land"):
        one, two = (digest_run(100, 3, steps // 400, task) for _ in range(2))
        other = digest_run(100, 4, steps // 400, task)
        together = MuflyVectorEnv(count, task=task, autoreset_mode="SameStep", **RANDOMISED)
        alone = [MuflyEnv(task=task, **RANDOMISED) for _ in range(count)]
        together.reset(seed=7)
        for k, env in enumerate(alone):
            env.reset(seed=7 + k)
        rng, equal, ends = np.random.default_rng(2), True, 0
        for _ in range(steps // 4000):
            actions = rng.uniform(-1.0, 1.0, (count, 4)).astype(np.float32)
            seen, rewards, *_ = together.step(actions)
            for k, env in enumerate(alone):
                row, reward, over, late, _ = env.step(actions[k])
                if over or late:
                    ends += 1
                    row = env.reset()[0]
                equal = equal and row.tobytes() == seen[k].tobytes() and reward == rewards[k]
        print(f"{task}: a seed twice {'equal' if one == two else 'DIFFERS'}, another seed "
              f"{'EQUAL' if one == other else 'differs'}; vector and single {'equal' if equal else 'DIFFER'} over "
              f"{count * (steps // 4000):,} steps and {ends} episodes")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--envs", type=int, default=1024, help="environments of a vector")
    parser.add_argument("--repeats", type=int, default=40, help="short runs of which the best counts")
    parser.add_argument("--peer-python", default="", help="Python that has crazyflow")
    parser.add_argument("--profile", action="store_true")
    parser.add_argument("--leak", type=int, default=0, metavar="STEPS")
    parser.add_argument("--json", action="store_true", help="print the rates as JSON")
    asked = parser.parse_args()
    assert mufly.gym.ENVIRONMENT_IDS
    if asked.profile:
        profile_step(asked.envs)
    elif asked.leak:
        check_memory(asked.leak)
        check_equality(asked.leak)
    else:
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        found = measure_rates(asked.envs, asked.peer_python, asked.repeats)
        print(json.dumps(found, indent=2)) if asked.json else print_rates(found)


if __name__ == "__main__":
    main()
