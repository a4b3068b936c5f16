"""Settings of a Monte Carlo campaign, and one flight of it: vehicle, wind, and success confirmed by the truth.

A :class:`Campaign` holds the settings shared by all flights. Flight ``k`` of seed ``s`` depends on ``k`` and ``s``
alone: its random numbers come from NumPy's seed sequence of ``(s, k)``. The worker and the order of flights do not
matter.

A flight succeeds if the state machine reports success *and* the truth confirms it: no collision, and every waypoint
passed within the tolerance. At the end the vehicle stands on the take-off floor, upright, at rest, with motors off, and
within the tolerance of the landing position.
"""

from __future__ import annotations

import functools
import math
import shlex
from collections.abc import Collection
from dataclasses import dataclass, field
from dataclasses import fields as fields_of
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from mufly.control import DesignSettings, FlightController, design_flight_controller
from mufly.control.synthesis.weighting_schemes import fill_missing_weights
from mufly.errors import ArgumentError, InputError, MuflyError
from mufly.estimate import Estimate
from mufly.estimate.filter.filter_records import ERROR_ATTITUDE, ERROR_GYRO_BIAS
from mufly.estimate.nees import compute_normalised_squared_errors
from mufly.files.answer_store import hash_inputs
from mufly.flight.fixes.camera_sensor import CameraConfig
from mufly.flight.flight_software import ControlImplementation
from mufly.flight.mission_flight import fly_mission
from mufly.flight.monte_carlo.flight_ending import (
    LANDED_HEIGHT_TOLERANCE_M,
    LANDED_MAX_SPEED_M_S,
    LANDED_MAX_TILT_DEG,
    FlightEnding,
    classify_ending,
    final_speed_m_s,
    final_tilt_deg,
    mismodelled_sensors,
)
from mufly.flight.monte_carlo.variation import ParameterVariation
from mufly.flight.record.flight_summary import FlightSummary, summarise_flight
from mufly.mission import Mission, check_mission_for_vehicle, format_mission_toml
from mufly.results import result, to_plain_data
from mufly.sensors import Truth, parse_fault
from mufly.vehicle import Vehicle, format_vehicle_toml, list_parameters, replace_parameters
from mufly.version import __version__

_Array = NDArray[np.float64]

MAX_VEHICLE_DRAWS = 200
"""Number of consecutive draws of impossible vehicles after which a campaign ends."""

UNKNOWN_TO_FILTER_PREFIX = "sensors.imu.mount_"
"""Prefix of the keys that no filter uses: the filter assumes an aligned inertial unit."""

NEES_SAMPLE_INTERVAL_PERIODS = 10  # periods between two samples of the estimation error


@dataclass(frozen=True)
class FlightCase:
    """The settings of one flight; all in SI units.

    Attributes
    ----------
    index : int
    seed : int
        Seed of gusts and sensors.
    parameter_values : dict
        Drawn parameters of the vehicle by key.
    wind : (3,) tuple or None
        Wind N, E, D (m/s); None: the mission's.
    refused_draws : int
        Number of impossible vehicles drawn before this one.
    """

    index: int
    seed: int
    parameter_values: dict[str, float]
    wind: tuple[float, float, float] | None
    refused_draws: int = 0


@result
class FlightResult:
    """Result of one flight, computed from its true motion.

    Attributes
    ----------
    index : int
        Index of the flight.
    seed : int
        Seed of gusts and sensors.
    success : bool
        Success reported by the state machine and confirmed by the truth.
    ending : str
        Class of :data:`mufly.flight.monte_carlo.flight_ending.ENDINGS`, from the true motion.
    reason : str
        Reason of a failure; empty for a success.
    reported_outcome : str
        Outcome reported by the state machine.
    refused : int
        Number of impossible vehicles drawn before this one.
    wind : (3,) tuple or None
        Wind N, E, D (m/s); None for the mission's.
    values : dict
        Drawn parameters by key (SI).
    duration_s : float or None
        Time from the first to the last instant.
    overshoot_m : float or None
        Worst overshoot beyond a waypoint.
    waypoint_error_m : float or None
        Largest distance from a waypoint when reported as reached.
    tracking_peak_m, tracking_rms_m : float or None
        Distance from the reference while airborne: largest, root mean square.
    touchdown_speed_m_s : float or None
        Rate of descent at touchdown.
    landing_error_m : float or None
        Distance from the landing position.
    tilt_peak_deg : float or None
        Largest tilt of the mast while airborne.
    railed_s : float or None
        Longest time that an input was at its limit.
    oscillation_s : float or None
        Longest oscillation of an actuator.
    clearance_m : float or None
        Least distance to an obstacle, from the centre of gravity.
    battery_left : float or None
        Charge at the end (0..1).
    nees : float or None
        Mean of NEES / n of the estimate (1 if its covariance is consistent).
    """

    index: int
    seed: int
    success: bool
    ending: FlightEnding
    reason: str
    reported_outcome: str
    refused: int
    wind: tuple[float, float, float] | None
    values: dict[str, float]
    duration_s: float | None = None
    overshoot_m: float | None = None
    waypoint_error_m: float | None = None
    tracking_peak_m: float | None = None
    tracking_rms_m: float | None = None
    touchdown_speed_m_s: float | None = None
    landing_error_m: float | None = None
    tilt_peak_deg: float | None = None
    railed_s: float | None = None
    oscillation_s: float | None = None
    clearance_m: float | None = None
    battery_left: float | None = None
    nees: float | None = None

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> FlightResult:
        """Return the result from its JSON types, as the inverse of :func:`mufly.results.to_plain_data`."""
        wind = content["wind"]
        return cls(**{**content, "wind": None if wind is None else tuple(wind)})


@dataclass(frozen=True)
class Campaign:
    """The settings shared by all flights of a campaign.

    Attributes
    ----------
    vehicle : Vehicle
        Nominal vehicle, for which controllers, autopilot and estimator are designed.
    mission : Mission
    variations : tuple of ParameterVariation
    wind : float, (3,) tuple or None
        Speed (m/s) of a horizontal wind in a drawn direction; wind N, E, D (m/s); None for the mission's.
    gust : float or None
        Standard deviation of the gusts (m/s); None for the mission's.
    sensors : "fitted" or "ideal"
    faults : tuple of str
        Faults of every flight, in the syntax of :func:`mufly.sensors.parse_fault`.
    camera : CameraConfig, optional
        See :class:`mufly.flight.Flight`'s ``eye``; its faults and stream are not part of the settings hash.
    seed : int
    tolerance_m : float
        Allowed distance from a waypoint and from the landing position (m).
    redesign : bool
        Whether controllers, autopilot and estimator are designed for each drawn vehicle. By default they are designed
        for ``vehicle``, so that only the truth varies.
    controllers : callable, optional
        See :class:`mufly.flight.Flight`.
    fast_controllers : callable, optional
        Faster flight software used if ``controllers`` is None, with identical flights
        (:class:`mufly.firmware.GenericFirmwareSoftware`); not part of the settings hash.
    controller_options : tuple of str
        Command line options that select ``controllers``.
    vehicle_name, mission_name, camera_name : str
        Names of vehicle, mission and camera on a command line.
    """

    vehicle: Vehicle
    mission: Mission
    variations: tuple[ParameterVariation, ...] = ()
    wind: float | tuple[float, float, float] | None = None
    gust: float | None = None
    sensors: Literal["fitted", "ideal"] = "fitted"
    faults: tuple[str, ...] = ()
    camera: CameraConfig | None = None
    seed: int = 0
    tolerance_m: float = 0.3
    redesign: bool = False
    controllers: ControlImplementation | None = None
    fast_controllers: ControlImplementation | None = None
    controller_options: tuple[str, ...] = ()
    vehicle_name: str = "mufly-1.1"
    mission_name: str = "demonstration"
    camera_name: str = "mufly-2.0"
    controller: FlightController | None = field(default=None, repr=False)

    @classmethod
    def create_checked(cls, vehicle: Vehicle, mission: Mission, **more: Any) -> Campaign:
        """Check that the mission can be flown as designed, design the controllers, and return the campaign.

        Raises
        ------
        InputError
            If vehicle and mission do not fit together, or a fault is invalid.
        """
        check_mission_for_vehicle(vehicle, mission)
        for text in more.get("faults", ()):
            parse_fault(text)
        if more.get("controller") is None and not more.get("redesign"):
            more["controller"] = design_flight_controller(vehicle)
        return cls(vehicle, mission, **more)

    @property
    def varied_keys(self) -> list[str]:
        """Return the keys of all parameters that vary, sorted."""
        return sorted({key for v in self.variations for key in v.keys})

    @property
    def keys_known_on_board(self) -> list[str]:
        """Return the varied keys whose drawn values the flight software uses (control, filter, fault detection)."""
        return [key for key in self.varied_keys if self.redesign and not key.startswith(UNKNOWN_TO_FILTER_PREFIX)]

    @property
    def keys_unknown_on_board(self) -> list[str]:
        """Return the varied keys of the simulated truth alone; the flight software keeps the nominal values."""
        return [key for key in self.varied_keys if not self.redesign or key.startswith(UNKNOWN_TO_FILTER_PREFIX)]

    def describe_onboard_knowledge(self) -> str:
        """Describe how many varied parameters the flight software knows (with drawn values), and how many not."""
        told, untold = len(self.keys_known_on_board), len(self.keys_unknown_on_board)
        parts = [
            f"{n} varied parameter{'s' if n > 1 else ''} {word}"
            for n, word in ((untold, "untold"), (told, "told"))
            if n
        ]
        return " and ".join(parts) or "only the noise varies"

    @cached_property
    def settings_hash(self) -> str:
        """Return the hash of all settings that affect flights."""
        content = {
            "version": __version__,
            "vehicle": format_vehicle_toml(self.vehicle),
            "mission": format_mission_toml(self.mission),
            "variations": [v.to_json() for v in self.variations],
            "air": [self.wind, self.gust],
            "sensors": [self.sensors, list(self.faults)],
            **self._collect_camera_settings(),
            "seed": self.seed,
            "tolerance_m": self.tolerance_m,
            "software": [
                self.redesign,
                "" if self.controllers is None else self.controllers.__name__,
                *self._describe_control_method(),
            ],
        }
        return hash_inputs(content)

    def _describe_control_method(self) -> list[str]:
        """Return method and gains of a controller that is not the default; empty for the default."""
        c = self.controller
        if c is None or c.settings == fill_missing_weights(DesignSettings(), self.vehicle):
            return []
        return [c.settings.method, *(g.tobytes().hex() for g in (c.heave_yaw_gains, c.roll_pitch_gains))]

    def _collect_camera_settings(self) -> dict[str, list[object]]:
        """Return the settings of the camera; empty without a camera."""
        eye = self.camera
        if eye is None:
            return {}
        true = [] if eye.true_camera is None else [eye.true_camera.model_dump_json()]
        return {
            "camera": [eye.camera.model_dump_json(), eye.floor_texture, eye.floor_width_m, eye.shadow_fraction, *true]
        }

    def draw_case(self, index: int) -> FlightCase:
        """Return the drawn settings of flight ``index``.

        Raises
        ------
        InputError
            If nearly all drawn vehicles are impossible.
        """
        rng = np.random.default_rng([self.seed, index])
        seed, towards = int(rng.integers(2**53)), rng.uniform(-1.0, 1.0)
        for refused in range(MAX_VEHICLE_DRAWS):
            case = self._make_case(
                index, seed, towards, [v.draw_normalised_variables(rng) for v in self.variations], refused
            )
            try:
                self.make_vehicle(case)
            except InputError as error:
                why = error
            else:
                return case
        raise ArgumentError(
            "vary", "", f"{MAX_VEHICLE_DRAWS} drawn vehicles in a row are impossible (the last: {why})", "vary less"
        ) from why

    @property
    def search_dimension(self) -> int:
        """Return the number of coordinates of :meth:`case_at_point`."""
        return sum(v.variable_count for v in self.variations) + isinstance(self.wind, float)

    def case_at_point(self, point: _Array, index: int) -> FlightCase:
        """Return the settings for ``point`` (``search_dimension``,), coordinates within -1..1 of the worst-case search.

        The seed is that of flight 0. A normal ``z`` is searched within two standard deviations.
        """
        seed = int(np.random.default_rng([self.seed, 0]).integers(2**53))
        towards, rest = (float(point[0]), point[1:]) if isinstance(self.wind, float) else (0.0, point)
        parts = np.split(rest, np.cumsum([v.variable_count for v in self.variations])[:-1]) if self.variations else []
        z = [(1.0 if v.distribution == "uniform" else 2.0) * p for v, p in zip(self.variations, parts, strict=True)]
        return self._make_case(index, seed, towards, z, 0)

    def _make_case(self, index: int, seed: int, towards: float, z: list[_Array], refused: int) -> FlightCase:
        values: dict[str, float] = {}
        for variation, numbers in zip(self.variations, z, strict=True):
            values |= variation.parameter_values(numbers)
        wind: tuple[float, float, float] | None
        if isinstance(self.wind, float):
            wind = (self.wind * math.cos(math.pi * towards), self.wind * math.sin(math.pi * towards), 0.0)
        else:
            wind = self.wind
        return FlightCase(index, seed, values, wind, refused)

    def make_vehicle(self, case: FlightCase) -> Vehicle:
        """Return the campaign's vehicle with the parameter values drawn for a flight.

        Raises
        ------
        InputError
            If the vehicle is impossible.
        """
        return replace_parameters(self.vehicle, dict(case.parameter_values)) if case.parameter_values else self.vehicle

    def make_flight_arguments(self, case: FlightCase) -> dict[str, Any]:
        """Return the arguments of :class:`mufly.flight.Flight` for a flight, vehicle and mission included.

        Raises
        ------
        InputError
            If the vehicle is impossible.
        """
        return {
            "vehicle": self.make_vehicle(case),
            "mission": self.mission,
            "controller": self.controller,
            "designed_for": None if self.redesign else self.vehicle,
            "wind": case.wind,
            "gust": self.gust,
            "seed": case.seed,
            "sensors": self.sensors,
            "faults": [parse_fault(text) for text in self.faults],
            "eye": self.camera,
            "controllers": self.controllers or self.fast_controllers,
        }

    @cached_property
    def _vehicle_file_values(self) -> dict[str, float]:
        return {p.key: p.value for p in list_parameters(self.vehicle) if isinstance(p.value, float)}

    def mismodelled_sensors(self, case: FlightCase) -> frozenset[str]:
        """Return the names (as in messages) of sensors whose true errors differ from those that the filter assumes."""
        untold = {key: case.parameter_values[key] for key in self.keys_unknown_on_board if key in case.parameter_values}
        return mismodelled_sensors(self.faults, untold, self._vehicle_file_values)

    def format_replay_command(self, case: FlightCase, folder: Path, vehicle_file: Path | None) -> str:
        """Return the command that repeats a flight; ``vehicle_file`` holds the drawn vehicle, if any."""
        words = ["mufly", "fly", self.mission_name, "--headless", "--sensors", self.sensors]
        words += ["--vehicle", self.vehicle_name if vehicle_file is None else str(vehicle_file)]
        if vehicle_file is not None and not self.redesign:
            words += ["--designed-for", self.vehicle_name]
        words += ["--seed", str(case.seed)]
        if case.wind is not None:
            words.append("--wind=" + ",".join(repr(v) for v in case.wind))  # a number may begin with a minus
        if self.gust is not None:
            words += ["--gust", repr(self.gust)]
        for text in self.faults:
            words += ["--fault", text]
        if self.camera is not None:
            words += [
                "--position",
                "camera",
                "--camera",
                self.camera_name,
                "--floor",
                self.camera.floor_name,
            ]
            if self.camera.floor_width_m is not None:
                words += ["--floor-width", repr(self.camera.floor_width_m)]
        return shlex.join([*words, *self.controller_options, "--out", str(folder)])


def fly_case(campaign: Campaign, case: FlightCase, path: Path | None = None) -> FlightResult:
    """Simulate one flight, with a full recording if a path (MCAP) is given, and return its result.

    An error during the flight counts as a failure.
    """
    heard = _NeesAccumulator()
    sensed = campaign.sensors == "fitted" and campaign.vehicle.sensors is not None

    same: dict[str, Any] = {
        "index": case.index,
        "seed": case.seed,
        "refused": case.refused_draws,
        "wind": case.wind,
        "values": case.parameter_values,
    }
    try:
        with _thread_pools().limit(limits=1):  # the last bits of a design must not depend on the number of cores
            data = fly_mission(
                **campaign.make_flight_arguments(case), path=path, brief=path is None,
                on_tick=heard if sensed else None,
                tick_every=NEES_SAMPLE_INTERVAL_PERIODS,
            )  # fmt: skip
    except MuflyError as error:
        return FlightResult(
            **same, success=False, ending="not started", reason=f"did not fly: {error}", reported_outcome=""
        )
    except Exception as error:  # a program error must not end the campaign
        why = f"raised {type(error).__name__}: {error}"
        return FlightResult(**same, success=False, ending="lost", reason=why, reported_outcome="")
    return compute_flight_result(
        data,
        campaign.mission,
        campaign.tolerance_m,
        nees=heard.mean_nees_per_dimension,
        wrong=campaign.mismodelled_sensors(case),
        **same,
    )


@functools.cache
def _thread_pools() -> Any:
    """Return the thread pools of the numerical libraries, cached because the search is slow."""
    return ThreadpoolController()


class _NeesAccumulator:
    """Accumulator of estimation errors during a flight."""

    def __init__(self) -> None:
        self._parts: list[tuple[_Array, _Array, _Array]] = []

    def __call__(self, truth: Truth, told: Estimate) -> None:
        true = np.concatenate([truth.position, truth.velocity, truth.attitude])
        estimated = np.concatenate([told.position, told.velocity, told.attitude])
        covariance = told.covariance[None, :ERROR_GYRO_BIAS, :ERROR_GYRO_BIAS]
        self.add_estimates(true[None], estimated[None], covariance, np.array([told.valid]))

    def add_estimates(self, true: _Array, told: _Array, covariances: _Array, valid: NDArray[np.bool_]) -> None:
        """Collect instants with a valid estimate for :meth:`mean_nees_per_dimension`.

        ``true`` and ``told`` are position, velocity and attitude (n, 9; m, m/s, rad), true and estimated.
        """
        self._parts.append((true[valid], told[valid], covariances[valid]))

    @property
    def mean_nees_per_dimension(self) -> float | None:
        """Return the mean of NEES / n; None if no estimate was valid."""
        if not any(len(true) for true, _, _ in self._parts):
            return None
        true, told, covariances = (np.concatenate(p) for p in zip(*self._parts, strict=True))
        error = told - true
        error[:, ERROR_ATTITUDE:] = np.angle(np.exp(1j * error[:, ERROR_ATTITUDE:]))
        return float(compute_normalised_squared_errors(error, covariances).mean()) / error.shape[1]


def compute_flight_result(
    data: xr.Dataset, mission: Mission, tolerance_m: float, *, nees: float | None = None,
    wrong: Collection[str] = (), **same: Any,
) -> FlightResult:  # fmt: skip
    """Return the result of a flight, computed from the true motion in its recording.

    ``wrong`` names the sensors that a failure's reason may blame; ``same`` are the other fields of
    :class:`FlightResult`.
    """
    # Recordings with sensors have a row each period; the evaluation at 100 Hz gives equal results for all recordings.
    step = round(0.01 / float(np.median(np.diff(data.time.values[:100]))))
    data = data.isel(time=slice(None, None, step)) if step > 1 else data
    s = summarise_flight(
        data,
        [w.position_m for w in mission.waypoint],
        take_off=(*mission.start_m, -mission.take_off.height_m),
        reach_m=mission.limits.reach_m,
        world=mission.world,
    )
    x, reference = data.truth_position.values, data.reference_position.values
    airborne = x[0, 2] - x[:, 2] > LANDED_HEIGHT_TOLERANCE_M
    away = np.linalg.norm(x - reference, axis=1)[airborne]
    reason = _failure_reason(s, data, tolerance_m)

    def worst_waypoint_value(name: str) -> float | None:
        return max((v for w in s.waypoints if (v := getattr(w, name)) is not None), default=None)

    return FlightResult(
        **same,
        success=not reason,
        ending=classify_ending(data, s, not reason, wrong),
        reason=reason,
        reported_outcome=f"{s.outcome}: {s.reason}" if s.reason else s.outcome,
        duration_s=s.duration_s,
        overshoot_m=worst_waypoint_value("overshoot_m"),
        waypoint_error_m=worst_waypoint_value("distance_at_reach_m"),
        tracking_peak_m=float(away.max()) if len(away) else None,
        tracking_rms_m=float(np.sqrt(np.mean(away**2))) if len(away) else None,
        touchdown_speed_m_s=s.touchdown_speed_m_s,
        landing_error_m=s.landing_distance_m,
        tilt_peak_deg=s.max_tilt_deg,
        railed_s=s.longest_railed_s,
        oscillation_s=s.longest_oscillation_s,
        clearance_m=s.least_clearance_m,
        battery_left=s.battery_end_charge,
        nees=nees,
    )


def _failure_reason(s: FlightSummary, data: xr.Dataset, tolerance_m: float) -> str:
    """Return the first reason of a failure; "" for a success."""
    if s.outcome != "succeeded":
        return s.reason or s.outcome
    for w in s.waypoints:
        name = "the take-off's end" if w.name == "take-off" else f"waypoint {w.name}"
        if w.reached_s is None:
            return f"{name} was not reached"
        if (w.distance_at_reach_m or 0.0) > tolerance_m:
            return f"{name} was reported as reached from {w.distance_at_reach_m:.2f} m away"
    down = data.truth_position.values[:, 2]
    up = float(down[0] - down[-1])
    if abs(up) > LANDED_HEIGHT_TOLERANCE_M:
        return f"final position {up:.2f} m above the take-off position"
    tilt = final_tilt_deg(data)
    if tilt > LANDED_MAX_TILT_DEG:
        return f"final tilt {tilt:.0f} degrees"
    speed = final_speed_m_s(data)
    if speed > LANDED_MAX_SPEED_M_S:
        return f"final speed {speed:.2f} m/s"
    if np.any(data.motor_input.values[-1] > 0.0):
        return "motors still running at the end"
    if (s.landing_distance_m or 0.0) > tolerance_m:
        return f"it landed {s.landing_distance_m:.2f} m from the landing position"
    return ""


def list_differing_result_fields(a: FlightResult, b: FlightResult) -> list[str]:
    """Return the names of the fields in which two flights differ."""
    return [
        f.name
        for f in fields_of(FlightResult)
        if to_plain_data(getattr(a, f.name)) != to_plain_data(getattr(b, f.name))
    ]
