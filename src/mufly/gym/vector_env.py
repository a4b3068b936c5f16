"""Gymnasium environments: a vector of environments in compiled code, and a single environment.

Both take the same options::

    gymnasium.make("mufly/Hover-v0", vary=["parameters=10%"], wind_m_s=0.5, gust_m_s=0.3, delay_s=0.01)
    gymnasium.make_vec("mufly/Hover-v0", num_envs=256, autoreset_mode="SameStep")

Environment i of a vector with seed s moves bit for bit as a single environment with seed s + i. Options: see
:class:`MuflyVectorEnv`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from mufly.dynamics.lane_equations import group_vehicles
from mufly.errors import ArgumentError
from mufly.flight.policy.observation import ACTION_SIZE, observation_limits
from mufly.gym.episodes import (
    ESTIMATE_ERROR_COUNT,
    ESTIMATE_ERROR_HEADING_INDEX,
    ESTIMATE_ERROR_POSITION_INDEX,
    ESTIMATE_ERROR_TILT_INDEX,
    EpisodeArrays,
    EpisodeSettings,
    apply_actions_and_wind,
    compute_rewards_and_ends,
    integrate_episodes,
    make_episodes,
    observe_episodes,
    start_episodes,
)
from mufly.gym.fleet import common_integration_step, draw_random_fleet, draw_random_winds
from mufly.gym.pictures import draw_episode
from mufly.gym.tasks import OBSTACLE_WORLD, TASK_DURATIONS_S, TASK_NAMES
from mufly.sensors.rng import make_random_source
from mufly.vehicle import Vehicle, load_vehicle

_Array = NDArray[np.float64]
_Flags = NDArray[np.bool_]
Observation = NDArray[np.float32]

DEFAULT_FLEET_SIZE = 32


class MuflyVectorEnv(gymnasium.vector.VectorEnv):
    """Environments that step together.

    Parameters
    ----------
    num_envs : int
    task : {"hover", "waypoint", "obstacle", "land"}
        See :mod:`mufly.gym.tasks`.
    vehicle : str, Path or Vehicle
        Name of a built-in vehicle, path of a vehicle file, or a vehicle.
    vary : sequence of str
        Parameters of the vehicle that differ from episode to episode, as for ``mufly monte-carlo --vary``:
        ``"parameters=std"`` draws from the standard deviations of the vehicle file.
    fleet_size, fleet_seed : int
        Number of vehicles, and of winds, that episodes draw from; seed of both.
    wind_m_s, gust_m_s : float
        Greatest steady wind and standard deviation of gusts.
    delay_s : float
        Greatest delay of an action, at most a period.
    sensors : {"ideal", "noisy", "fitted"}
        Observe the true state; a state with the errors of an estimate (:mod:`mufly.gym.episodes`); or the estimate of
        the filter on the simulated sensors of the vehicle file (:mod:`mufly.gym.filter_units`), which needs a C
        compiler. On fitted sensors, inputs act a period of the flight software after the observation, and the drawn
        delay comes in such periods.
    period_s : float
        Time of a step.
    duration_s : float, optional
        Length of an episode; default: that of the task.
    threads : int
        Cores that move the vehicles.
    render_mode : {"rgb_array"}, optional
    autoreset_mode : AutoresetMode or its value
        When an environment starts its next episode: ``"NextStep"`` (the step after the end ignores its action and
        starts it), ``"SameStep"`` (the last observation is in ``info["final_obs"]``), or ``"Disabled"`` (call ``reset``
        with ``options={"reset_mask": ...}``).

    Raises
    ------
    ArgumentError
        If an option is out of range.
    InputError
        If vehicle or variation cannot be read.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        task: str = "hover",
        vehicle: str | Path | Vehicle = "mufly-1.1",
        vary: Sequence[str] = (),
        fleet_size: int = DEFAULT_FLEET_SIZE,
        fleet_seed: int = 0,
        wind_m_s: float = 0.0,
        gust_m_s: float = 0.0,
        delay_s: float = 0.0,
        sensors: Literal["ideal", "noisy", "fitted"] = "ideal",
        period_s: float = 0.02,
        duration_s: float | None = None,
        threads: int = 1,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        _check_options(num_envs, task, fleet_size, wind_m_s, gust_m_s, delay_s, sensors, period_s, duration_s, threads)
        self.num_envs, self.render_mode = num_envs, render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {
            "render_modes": ["rgb_array"], "render_fps": round(1.0 / period_s), "autoreset_mode": self.autoreset_mode,
        }  # fmt: skip
        nominal = vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)
        self.vehicle, self.task, self.period_s = nominal, task, period_s
        self.fleet = draw_random_fleet(nominal, vary, fleet_size, fleet_seed)
        self._winds = draw_random_winds(wind_m_s, gust_m_s, period_s, fleet_size, fleet_seed)
        self.units = None
        if sensors == "fitted":
            from mufly.gym.filter_units import (
                FilteredVehicles,
                prepare_hover_starts,
            )  # the filter takes a second to load

            starts, room = prepare_hover_starts(
                nominal, self.fleet, TASK_NAMES.index(task), self._winds, period_s, fleet_size, fleet_seed
            )
            self.fleet = starts.fleet
            self.units = FilteredVehicles(starts, room, num_envs, round(period_s / starts.period_s), threads)
        self._group, self._threads = group_vehicles(self.fleet.parameters), threads
        self._step_s, self._step_count = common_integration_step(self.fleet, period_s)
        kind = TASK_NAMES.index(task)
        low, high = observation_limits(task)
        length = TASK_DURATIONS_S[kind] if duration_s is None else duration_s
        errors = (
            _error_process_parameters(nominal, period_s)
            if sensors == "noisy"
            else (np.zeros(ESTIMATE_ERROR_COUNT),) * 2 + (np.zeros(4),)
        )
        delay_unit_s = self._step_s if self.units is None else starts.period_s
        self._settings = EpisodeSettings(
            kind, max(1, round(length / period_s)), round(delay_s / delay_unit_s), self.fleet.nominal_hover_inputs,
            self.fleet.nominal_voltage_V, float(nominal.rotors.radius), OBSTACLE_WORLD.packed_tables[2], low, high,
            sensors == "noisy", sensors == "fitted", *errors,
        )  # fmt: skip
        self.single_observation_space = gymnasium.spaces.Box(low.astype(np.float32), high.astype(np.float32))
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)
        batch = gymnasium.vector.utils.batch_space
        self.observation_space = batch(self.single_observation_space, num_envs)
        self.action_space = batch(self.single_action_space, num_envs)
        self.episodes: EpisodeArrays = make_episodes(num_envs)
        self._no_volts = np.full(num_envs, math.nan)
        self._all = np.ones(num_envs, dtype=np.bool_)
        self._ended = np.zeros(num_envs, dtype=np.bool_)
        self._is_seeded = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start episodes and return observations (n, m) and info.

        Parameters
        ----------
        seed : int or sequence of int, optional
            Seed of the first environment, the others count on; or one seed for each. Without it the random numbers
            continue.
        options : dict, optional
            ``{"reset_mask": (n,) array of bool}`` restarts some environments only.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        which = self._all
        if options and "reset_mask" in options:
            which = np.ascontiguousarray(options["reset_mask"], dtype=np.bool_)
            if which.shape != (self.num_envs,):
                raise ArgumentError("reset_mask", "", f"has shape {which.shape}", f"give ({self.num_envs},)")
        if seed is not None or not self._is_seeded:
            one: Any = [seed + k for k in range(self.num_envs)] if isinstance(seed, int) else seed
            seeds: Sequence[int | None] = [None] * self.num_envs if one is None else one
            places: list[int] = np.flatnonzero(which).tolist()
            if len(seeds) != self.num_envs:
                raise ArgumentError("seed", "", f"{len(seeds)} seeds", f"give {self.num_envs}")
            for k in places:
                if seeds[k] is not None or not self._is_seeded:
                    self.episodes.random_source[k] = make_random_source(seeding.np_random(seeds[k])[0])[0]
            self._is_seeded = True
        self._start(which)
        self._ended[which] = False
        observations = np.zeros((self.num_envs, self._settings.observation_low.size), dtype=np.float32)
        self._observe(self._all, observations)
        return observations, {}

    def step(self, actions: Any) -> tuple[Observation, _Array, _Flags, _Flags, dict[str, Any]]:
        """Apply one action to each environment, and advance all by one period.

        Parameters
        ----------
        actions : (n, 4) array
            See :mod:`mufly.flight.policy.observation`; clipped to -1..1.

        Returns
        -------
        observations : (n, m) array
        rewards : (n,) array
        terminated, truncated : (n,) arrays of bool
        info : dict
            ``"success"`` (n,): whether the step reached a target.
        """
        if not self._is_seeded:
            raise ArgumentError("step", "", "no episode has started", "call reset first")
        given = np.ascontiguousarray(actions, dtype=np.float32)
        if given.shape != (self.num_envs, ACTION_SIZE):
            raise ArgumentError("actions", "", f"have shape {given.shape}", f"give ({self.num_envs}, {ACTION_SIZE})")
        if not np.isfinite(given).all():
            raise ArgumentError("actions", "", "contain NaN or infinity", "give numbers from -1 to 1")
        n, e, s, fleet = self.num_envs, self.episodes, self._settings, self.fleet
        rewards, terminated, truncated, success = np.zeros(n), *(np.zeros(n, dtype=np.bool_) for _ in range(3))
        observations = np.zeros((self.num_envs, self._settings.observation_low.size), dtype=np.float32)
        next_step = self.autoreset_mode is AutoresetMode.NEXT_STEP
        which = self._all
        if self._ended.any():
            if self.autoreset_mode is AutoresetMode.DISABLED:
                raise ArgumentError("step", "", "an episode has ended", "reset it with options={'reset_mask': ...}")
            which = ~self._ended
        apply_actions_and_wind(e, s, given, which, self._winds)
        if self.units is None:
            integrate_episodes(e, fleet.parameters, self._group, self._step_s, self._step_count, self._threads)
        else:
            self.units.advance_units(e)
        compute_rewards_and_ends(e, s, which, fleet.parameters, rewards, terminated, truncated, success)
        if next_step and self._ended.any():
            self._start(self._ended)
        self._observe(self._all, observations)
        info: dict[str, Any] = {"success": success}
        ended = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            info["final_obs"], info["_final_obs"] = observations.copy(), ended
            self._start(ended)
            self._observe(ended, observations)
            ended = np.zeros(n, dtype=np.bool_)
        self._ended = ended
        return observations, rewards, terminated, truncated, info

    def _start(self, which: _Flags) -> None:
        fleet = self.fleet
        start_episodes(
            self.episodes, self._settings, which, fleet.hover_states, fleet.hover_inputs, fleet.wind_series_index,
            self._winds,
        )  # fmt: skip
        if self.units is not None:
            self.units.start_units(self.episodes, which)

    def _observe(self, which: _Flags, observations: Observation) -> None:
        seen, volts = (self.episodes.state, self._no_volts) if self.units is None else (
            self.units.estimate, self.units.volts
        )  # fmt: skip
        observe_episodes(
            self.episodes, self._settings, which, self.fleet.parameters, seen, volts, observations
        )  # fmt: skip

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture (height, width, 3) of each environment; None without a render mode."""
        if self.render_mode is None:
            return None
        return tuple(self.draw_environment_picture(k) for k in range(self.num_envs))

    def draw_environment_picture(self, index: int) -> NDArray[np.uint8]:
        """Return a picture (height, width, 3) of one environment."""
        return draw_episode(self.episodes, index, self.task, float(self.vehicle.rotors.radius), self.period_s)


class MuflyEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Single environment; options: those of :class:`MuflyVectorEnv` without ``num_envs`` and ``autoreset_mode``."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012  Gymnasium's own declaration

    def __init__(self, **options: Any) -> None:
        self.vector = MuflyVectorEnv(1, autoreset_mode=AutoresetMode.DISABLED, **options)
        self.render_mode = self.vector.render_mode
        self.metadata = {**self.metadata, "render_fps": self.vector.metadata["render_fps"]}
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode and return its first observation (m,) and info."""
        super().reset(seed=seed)
        observations, info = self.vector.reset(seed=seed)
        return observations[0], info

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Step with an action (4,); as :meth:`MuflyVectorEnv.step`."""
        given = np.asarray(action, dtype=np.float32)[None]
        self.vector._ended[:] = False  # a step after the end of an episode continues it, as in Gymnasium's own
        observations, rewards, terminated, truncated, info = self.vector.step(given)
        return (
            observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]),
            {"success": bool(info["success"][0])},
        )  # fmt: skip

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3); None without a render mode."""
        return None if self.render_mode is None else self.vector.draw_environment_picture(0)


def _check_options(
    num_envs: int, task: str, fleet_size: int, wind_m_s: float, gust_m_s: float, delay_s: float, sensors: str,
    period_s: float, duration_s: float | None, threads: int,
) -> None:  # fmt: skip
    def require_in_range(name: str, value: Any, is_right: bool, remedy: str) -> None:
        if not is_right:
            raise ArgumentError(name, "", f"{value!r} is out of range", remedy)

    require_in_range("num_envs", num_envs, num_envs >= 1, "give 1 or more")
    require_in_range("task", task, task in TASK_NAMES, f"give one of {', '.join(TASK_NAMES)}")
    require_in_range("threads", threads, 1 <= threads <= 256, "give 1 to 256")
    require_in_range("fleet_size", fleet_size, fleet_size >= 1, "give 1 or more")
    require_in_range("sensors", sensors, sensors in ("ideal", "noisy", "fitted"), "give 'ideal', 'noisy' or 'fitted'")
    require_in_range("period_s", period_s, 1e-3 <= period_s <= 0.1, "give 0.001 to 0.1 s")
    require_in_range("delay_s", delay_s, 0.0 <= delay_s <= period_s, f"give 0 to {period_s:g} s, a period")
    for name, value in (("wind_m_s", wind_m_s), ("gust_m_s", gust_m_s)):
        require_in_range(name, value, 0.0 <= value <= 20.0, "give 0 to 20 m/s")
    require_in_range("duration_s", duration_s, duration_s is None or 0.0 < duration_s <= 3600.0, "give up to 3600 s")


def _error_process_parameters(vehicle: Vehicle, period_s: float) -> tuple[_Array, _Array, _Array]:
    """Return decay (6,) and standard deviation (6,) of the estimate's correlated errors, and that of its white
    errors (4,).
    """
    fitted = vehicle.sensors
    fix, imu = (None, None) if fitted is None else (fitted.position_fix, fitted.imu)
    if fix is None or imu is None:
        raise ArgumentError(
            "sensors", "", f"{vehicle.name} has no tables sensors.position_fix and sensors.imu", "use 'ideal' sensors"
        )
    decay, sigma = np.ones(ESTIMATE_ERROR_COUNT), np.zeros(ESTIMATE_ERROR_COUNT)
    decay[ESTIMATE_ERROR_POSITION_INDEX:ESTIMATE_ERROR_TILT_INDEX] = math.exp(
        -period_s / float(fix.drift_correlation_time)
    )
    sigma[ESTIMATE_ERROR_POSITION_INDEX:ESTIMATE_ERROR_HEADING_INDEX] = float(fix.drift)
    sigma[ESTIMATE_ERROR_HEADING_INDEX] = float(fix.heading_drift)
    sigma[ESTIMATE_ERROR_TILT_INDEX:] = float(imu.standing_tilt_error)
    white = np.array([
        float(fix.noise), float(fix.noise) / float(fix.period), float(fix.heading_noise),
        float(imu.gyro_noise_density) / math.sqrt(2.0 * period_s),
    ])  # fmt: skip
    return decay, sigma, white
