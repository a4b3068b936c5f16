"""Simulated flight: true helicopter, autopilot and recorder, one period of the controllers at a time.

One period at time ``t_k``, in the stages of :mod:`mufly.flight.period_stages`::

    plant integrated from t_(k-1) to t_k under a_(k-2) and the wind
    truth(t_k) --> sensors --> readings --> estimator --> estimate --> autopilot.step --> actuators a_k
    a row of the recording, every second period (every one, on sensors)

The inputs a_k take effect at t_(k+1): one period is the computing time of the onboard processor. This module does not
use the wall clock: :func:`mufly.flight.mission_flight.fly_mission` steps as fast as possible, a link in real time.

The vehicle flies on the true state (``sensors="ideal"``), or on the vehicle's sensors and a filter
(``sensors="fitted"``). Ideal sensors are the default in Python, for studies of vehicle, controllers and missions; the
commands fly on fitted sensors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.camera import PICTURE_RECORDING_FILE_NAME
from mufly.control import FlightController, design_flight_controller
from mufly.dynamics import (
    DrydenWind,
    describe_excess_wind,
    describe_max_level_speed,
    find_model_airspeed_limits,
    standing_state,
)
from mufly.dynamics.model_state import MODEL_CHARGE
from mufly.errors import InputError
from mufly.estimate import Estimate, Estimator, IdealEstimator, KalmanEstimator
from mufly.flight.autopilot import POSITION_SOURCE_REFUSED_TEXT, Autopilot
from mufly.flight.controllers import Actuators, Controllers
from mufly.flight.fixes.camera_sensor import (
    LANDED_HEIGHT_M,
    CameraConfig,
    CameraSensor,
    compute_standing_sonar_limit,
    default_to_mission_floor,
    make_picture_stream,
    replace_fix_by_camera,
)
from mufly.flight.fixes.external_fixes import ExternalFixes
from mufly.flight.flight_software import ControlImplementation, FlightSoftware
from mufly.flight.flight_state import FlightState
from mufly.flight.period_stages import (
    CONTINUE_LOOP,
    LOOP_DONE,
    STAGE_BEGIN_PERIOD,
    STAGE_CHECK_CONTACT,
    LoopPosition,
    make_stage_loop,
)
from mufly.flight.record.recorder import open_flight_recorder
from mufly.flight.record.sensor_recording import FIX_CORRELATION_TIME_ATTRIBUTE, make_sensed_row_writer
from mufly.flight.simulated_plant import SimulatedPlant, make_row_writer
from mufly.logs.mcap import FlightEvent
from mufly.mission import Mission, State, load_mission
from mufly.sensors import (
    Fault,
    FittedSensors,
    Readings,
    SensorSet,
    Truth,
    make_fitted_sensors,
    make_ideal_sensors,
    randomise_leg_lengths,
)
from mufly.vehicle import Vehicle, load_vehicle
from mufly.version import __version__

_Array = NDArray[np.float64]


RECORD_RATE_HZ = 100.0
RANGE_RING_RATE_HZ = 25.0
MOTORS_OFF_AFTER_CRASH_S = 0.5
"""Time after a crash until the motors stop (s), for the recording."""

GUST_LENGTH_M = 1.0
_CURRENT_FILTER_S = 5.0


class Flight:
    """The simulated helicopter on the floor, ready for commands.

    Parameters
    ----------
    vehicle : Vehicle, str or Path
        Vehicle, or its name or file.
    mission : Mission, str or Path
        Mission, or its name or file; it supplies start position, obstacles and limits.
    controller : FlightController, optional
        Control design; default ``mufly.control.design_flight_controller(vehicle)``.
    wind : (3,) array_like, optional
        Steady wind N-E-D (m/s); default the mission's.
    gust : float, optional
        Standard deviation of the gusts (m/s); default the mission's.
    seed : int
        Seed of gusts and sensor errors.
    path : str or Path, optional
        MCAP file to record to; default no file.
    keep : bool
        Whether all rows stay in memory for :meth:`to_dataset`; otherwise memory does not grow.
    sensors : "ideal", "fitted" or SensorSet
        True values (range ring at 25 Hz), the sensors in the vehicle file's ``[sensors]``, or other sensors. A vehicle
        without ``[sensors]`` flies on true values, with a warning.
    estimator : Estimator, optional
        Default: the estimator for the sensors; the one for ideal sensors returns their readings.
    faults : sequence of Fault
        Faults of fitted sensors; :meth:`inject_fault` adds faults in flight.
    controllers : callable, optional
        Factory of another implementation of :class:`mufly.flight.controllers.Controllers`, or another class of flight
        software in place of :class:`mufly.flight.flight_software.FlightSoftware`, for example exported code
        (:mod:`mufly.firmware`).
    designed_for : Vehicle, optional
        Vehicle for which controllers, autopilot and estimator are designed; default ``vehicle``.
    brief : bool
        Record the data of a flight's summary at 100 Hz, without sensor readings.
    eye : CameraConfig, optional
        Use a camera's fixes (:mod:`mufly.flight.fixes.camera_sensor`) in place of the statistical position fix; with
        fitted sensors only.
    outside : bool
        Use fixes submitted to :attr:`outside_fixes`, for example by a link; with fitted sensors only. With ``eye`` the
        pictures are streamed to ``eye.stream_address``, for a program that computes the fixes.

    Raises
    ------
    MuflyError
        If the vehicle, the mission or the path is invalid.

    Notes
    -----
    Use as a context manager, or call :meth:`close`, to finish the recording.
    """

    def __init__(
        self,
        vehicle: Vehicle | str | Path,
        mission: Mission | str | Path,
        *,
        controller: FlightController | None = None,
        wind: ArrayLike | None = None,
        gust: float | None = None,
        seed: int = 0,
        path: str | Path | None = None,
        keep: bool = True,
        sensors: SensorSet | Literal["ideal", "fitted"] = "ideal",
        estimator: Estimator | None = None,
        faults: Sequence[Fault] = (),
        controllers: ControlImplementation | None = None,
        designed_for: Vehicle | None = None,
        brief: bool = False,
        eye: CameraConfig | None = None,
        outside: bool = False,
    ) -> None:
        vehicle = vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)
        mission = mission if isinstance(mission, Mission) else load_mission(mission)
        if outside and sensors != "fitted":
            raise InputError("outside", "", "ideal sensors use no position fixes", "fly on fitted sensors")
        if outside and eye is not None and eye.stream_address is None:
            raise InputError("eye", "stream", "pictures have no receiver", "give an address to stream to")
        eye = None if eye is None else default_to_mission_floor(eye, mission)
        if eye is not None and not outside:
            if sensors != "fitted":
                raise InputError("eye", "", "ideal sensors use no pictures", "fly on fitted sensors")
            vehicle = replace_fix_by_camera(vehicle, eye.camera)
            designed_for = None if designed_for is None else replace_fix_by_camera(designed_for, eye.camera)
        believed = vehicle if designed_for is None else designed_for
        controller = design_flight_controller(believed) if controller is None else controller
        steady = np.asarray(mission.wind.steady_m_s if wind is None else wind, dtype=np.float64)
        gust = mission.wind.gust_m_s if gust is None else gust
        self.vehicle = vehicle
        self.period_s = 1.0 / controller.rate_Hz
        if isinstance(controllers, type) and issubclass(controllers, FlightSoftware):
            self.autopilot = Autopilot(believed, controller, mission, controllers)
        else:
            self.autopilot = Autopilot(believed, controller, mission)
            if controllers is not None:
                self.autopilot.software.replace_controllers(
                    cast(Callable[[FlightController], Controllers], controllers)
                )
        air = DrydenWind(steady, gust, step_s=self.period_s, length_m=GUST_LENGTH_M, seed=seed)
        self.outside_model_note = describe_excess_wind(vehicle, steady, gust)
        unit = randomise_leg_lengths(vehicle, seed=seed) if sensors == "fitted" else vehicle
        self._start = standing_state(unit, mission.start_m, math.radians(mission.start_heading_deg))
        self.plant = SimulatedPlant(unit, mission.world, air, controller.rate_Hz, self._start)
        self.look_periods = max(1, round(controller.rate_Hz / RANGE_RING_RATE_HZ))
        start = (*mission.start_m, math.radians(mission.start_heading_deg))
        self._least_m = compute_standing_sonar_limit(vehicle)
        self.camera: CameraSensor | None = None
        self.outside_fixes: ExternalFixes | None = None
        if outside:
            stream = None if eye is None else make_picture_stream(eye, vehicle, mission.world, seed)
            source = self.outside_fixes = ExternalFixes(vehicle, stream)
            self.autopilot.source_fault = lambda: source.source_fault
        elif eye is not None:
            self.camera = CameraSensor(eye, vehicle, mission.world, start, seed)
        fixes = self.camera or self.outside_fixes
        self.sensors = _make_sensors(sensors, vehicle, mission, self.look_periods, seed, faults, fixes)
        sensed = self.uses_fitted_sensors = isinstance(self.sensors, FittedSensors)
        full = sensed and not brief
        if estimator is None:
            estimator = KalmanEstimator(believed, mission.world, controller.rate_Hz) if sensed else IdealEstimator()
        self.estimator = estimator
        if self.camera is not None:
            self.camera.estimate_source = self._estimate_and_sonar
        if fixes is not None:
            self.autopilot.excused_sensors = self._excused_sensors
        weighed: dict[str, float] = {}
        if fixes is not None and isinstance(estimator, KalmanEstimator):
            estimator.uses_fix_covariance = True
            estimator.fix_correlation_s = 0.0 if self.camera is None else self.camera.fix_drift_time_s
            weighed = {FIX_CORRELATION_TIME_ATTRIBUTE: estimator.fix_correlation_s}
        self.missing_sensors_note = (
            f"{vehicle.name} has no table [sensors]: the vehicle flies on the true state, without filter"
            if sensors == "fitted" and not sensed
            else ""
        )
        self.recorder = open_flight_recorder(
            path,
            {
                "vehicle": vehicle.name,
                "mission": mission.name,
                "at_end": mission.at_end,
                "seed": seed,
                "wind_m_s": steady.tolist(),
                "gust_m_s": gust,
                "model_air_m_s": find_model_airspeed_limits(vehicle)[1:],
                "level_speed": describe_max_level_speed(vehicle),
                **({"outside_model": self.outside_model_note} if self.outside_model_note else {}),
                "rate_Hz": controller.rate_Hz,
                **({} if designed_for is None else {"designed_for": designed_for.name}),
                **({"sensors": "fitted", "faults": [str(f) for f in faults]} if sensed else {}),
                **({"position": "link"} if outside else {}),
                **weighed,
                **({} if eye is None else {"camera": eye.camera.name, "camera_floor": eye.floor_texture}),
                "version": __version__,
            },
            vehicle,
            mission,
            sensors=full,
            keep=keep,
        )
        if self.camera is not None and path is not None:
            self.camera.open_picture_recording(
                Path(path).with_name(PICTURE_RECORDING_FILE_NAME), self.recorder.start_time_ns
            )
        self.records_measurements = not brief
        self._write = make_row_writer(self.recorder, measured=not brief)
        self._write_sensed = make_sensed_row_writer(self.recorder) if full else None
        self.record_periods = 1 if full else max(1, round(controller.rate_Hz / RECORD_RATE_HZ))
        self.acting_actuators = self.sent_actuators = Actuators.make_zero_inputs()
        self.clock = LoopPosition()
        self.listener: Callable[[Truth, Estimate], None] = lambda truth, estimate: None
        self.listener_periods = 0  # periods; 0: nobody listens
        self._many: Callable[..., bool] | None = None
        self._asked_many = False
        self._reset_sensors_and_estimate()
        self._crash_s = math.inf
        self.current_A = self.autopilot.energy_check.hover_current_A
        self._finished = self._mission_flown = False
        self.refusal_reason = ""
        self.autopilot.listeners.append(self._record_event)

    def _reset_sensors_and_estimate(self) -> None:
        self.sensors.reset()
        self.estimator.reset()
        self.plant.detect_collision()
        self._is_estimated = False
        self._measure_sensors()
        self._estimate = self.estimator.update(self.readings, np.zeros(4))
        self.autopilot.store_estimate(self._estimate)
        self.is_first_period, self._rests = True, False
        # A filter must process each instant once, and it has processed the first instant of the next period.
        self._is_estimated = self.uses_fitted_sensors

    def _estimate_and_sonar(self) -> tuple[Estimate | None, float]:
        """Return the estimate of the previous period and the latest sonar reading (m), as data for the camera."""
        if not hasattr(self, "_readings"):
            return None, math.nan
        sonar = self.readings.latest.get("ground_distance")
        return self._estimate, math.nan if sonar is None else float(sonar.value)

    def _excused_sensors(self) -> tuple[str, ...]:
        """Return the sensors that cannot measure at present, which the filter must not report as faulty.

        On the floor the camera sees nothing, so it is listed from touchdown until the sonar shows the next lift-off.
        Tracking works down to about 3 cm above the floor.
        """
        m, sonar = self._estimate_and_sonar()
        if sonar > self._least_m:
            self._rests = False
        elif m is not None and self.autopilot.software.state == State.LANDING:
            self._rests = self._rests or -float(m.position[2]) < LANDED_HEIGHT_M
        return ("position_fix",) if self._rests else ()

    @property
    def truth(self) -> Truth:
        """Truth at the time of the last readings."""
        return self._truth

    @property
    def estimate(self) -> Estimate:
        """Estimate at the time of the last readings."""
        return self._estimate

    @property
    def time_s(self) -> float:
        """Simulated time of the latest readings (s)."""
        return self._truth.time_s

    def step_period(self) -> None:
        """Advance by one period of the controllers."""
        if self.is_first_period:
            self.finish_period(self.acting_actuators.input_array)
        else:
            self.clock.stage = STAGE_BEGIN_PERIOD
            _run_stages(self)

    def finish_period(self, acted: NDArray[np.floating[Any]]) -> None:
        """Run the stages of a period after the plant's step; ``acted`` (4,) are the plant's inputs in the period."""
        self._acted = acted
        self.clock.stage = STAGE_CHECK_CONTACT
        _run_stages(self)

    def advance_until(self, until: int, **more: Any) -> None:
        """Advance at least one period, at most to period ``until``.

        Compiled code runs many periods, up to the first event that Python must handle; without it, one period is run.
        """
        if not self._asked_many:
            self._many, self._asked_many = self.autopilot.software.make_batch_runner(self), True
        if self._many is None or not self._many(until, **more):
            self.step_period()

    def store_loop_results(self, truth: Truth, readings: Readings | None, estimate: Estimate) -> None:
        """Set truth, readings and estimate after periods of the compiled loop.

        Readings of None are gathered from the sensors when they are asked for.
        """
        self._truth, self._readings, self._estimate = truth, readings, estimate

    @property
    def readings(self) -> Readings:
        """Latest readings of the sensors."""
        if self._readings is None:
            self._readings = self.sensors.gather_latest_readings(self._truth.time_s)
        return self._readings

    @property
    def records_only_truth(self) -> bool:
        """Whether the rows of the recording hold the truth alone, without readings of fitted sensors."""
        return self._write_sensed is None

    @property
    def current_filter_weight(self) -> float:
        """Weight of a new sample in the low-pass of the battery current, sampled every ``look_periods`` periods."""
        return self.look_periods * self.period_s / _CURRENT_FILTER_S

    # The stages of a period, in the order of mufly.flight.period_stages; the last one ends every call

    def _begin_period(self) -> int:
        return CONTINUE_LOOP

    def _advance_plant(self) -> int:
        self._acted = self.acting_actuators.input_array
        self.plant.advance_period(self.acting_actuators)
        self.acting_actuators = self.sent_actuators
        return CONTINUE_LOOP

    def _check_contact(self) -> int:
        plant, autopilot = self.plant, self.autopilot
        if plant.period_count % self.look_periods == 0:
            plant.detect_collision()
            flying = autopilot.software.motors == "fly"
            self.current_A += self.current_filter_weight * (
                (float(plant.current) if flying else autopilot.energy_check.hover_current_A) - self.current_A
            )
        return CONTINUE_LOOP

    def _measure_sensors(self) -> int:
        if not self._is_estimated:
            self._truth = self.plant.truth
            self._readings = self.sensors.read(self._truth)
        return CONTINUE_LOOP

    def _update_estimate(self) -> int:
        if not self._is_estimated:
            self._estimate = self.estimator.update(self.readings, self._acted.astype(np.float64, copy=False))
        self.is_first_period = self._is_estimated = False
        if (fixes := self.camera or self.outside_fixes) is not None:
            fixes.update_fix_monitor(self.readings, self._estimate, self.autopilot.software.motors == "off")
        if self.camera is not None and (news := self.camera.take_tracking_report()):
            self.log_event(news, "info" if news.endswith("again") else "warning")
        return CONTINUE_LOOP

    def _step_control(self) -> int:
        self.sent_actuators = self.autopilot.step(self._estimate)
        return CONTINUE_LOOP

    def _record_row(self) -> int:
        if self.plant.period_count % self.record_periods == 0:
            software = self.autopilot.software
            state = str(software.state)
            if self._write_sensed is None:
                self._write(self._truth, self.readings, self.acting_actuators, software.reference, state)
            else:
                self._write_sensed(
                    self._truth,
                    self.readings,
                    self._estimate,
                    self.acting_actuators,
                    software.reference,
                    state,
                )
        return CONTINUE_LOOP

    def _end_period(self) -> int:
        if self.plant.crash_cause:
            self._handle_crash()
        return LOOP_DONE

    def _handle_crash(self) -> None:
        if not self.autopilot.crash_cause:
            self.autopilot.crash_cause = self.plant.crash_cause
            self._crash_s = self.time_s
            self.log_event(self.plant.crash_cause, "error")
        elif self.time_s >= self._crash_s + MOTORS_OFF_AFTER_CRASH_S and self.autopilot.software.motors != "off":
            self.autopilot.emergency_stop()

    def inject_fault(self, fault: Fault) -> None:
        """Inject a sensor fault at its start time (at once if that time is past), and log an event.

        Raises
        ------
        InputError
            If the vehicle has no such sensor, or flies on the true state.
        """
        if not isinstance(self.sensors, FittedSensors):
            raise InputError("fault", str(fault), "the true state has no sensor faults", "fly on fitted sensors")
        fault = self.sensors.inject_fault(fault, self.time_s)
        self.log_event(f"fault injected: {fault}", "warning")

    def clear_faults(self) -> None:
        """Clear all sensor faults and log an event."""
        if isinstance(self.sensors, FittedSensors) and self.sensors.all_faults:
            self.sensors.clear_faults()
            self.log_event("all faults cleared")

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Present and future faults of the sensors."""
        there = self.sensors.all_faults if isinstance(self.sensors, FittedSensors) else ()
        return tuple(f for f in there if f.stop_s > self.time_s)

    def log_event(self, text: str, level: str = "info") -> None:
        """Append an event to log and recording; ``level`` is "info", "warning" or "error"."""
        self.autopilot.log_event(text, level)

    def _record_event(self, event: FlightEvent) -> None:
        self._mission_flown |= self.autopilot.software.mission_state.mission_begun
        self.recorder.add_event(event.time_s, event.state, event.text, event.level)

    @property
    def status(self) -> FlightState:
        """Present state of the flight, with the truth."""
        plant, truth = self.plant, self._truth
        return replace(
            self.autopilot.status,
            crash_cause=plant.crash_cause,
            readings=self.readings,
            actuators=self.acting_actuators,
            battery_current=float(truth.battery_current_A),
            battery_charge=truth.battery_charge,
            battery_left_s=self._battery_left_s(),
            truth=truth,
            faults=self.faults,
        )

    def _battery_left_s(self) -> float:
        """Return the time (s) until the voltage at the filtered current falls to the landing voltage."""
        p, current = self.plant.parameters, max(self.current_A, 1e-3)
        low = self.autopilot.software.plan.low_battery_V + float(p["battery_resistance"]) * current
        curve = np.asarray(p["battery_curve"], dtype=np.float64)
        empty = float(np.interp(low, curve, np.linspace(0.0, 1.0, len(curve))))
        left = max(0.0, float(self.plant.state[MODEL_CHARGE]) - empty)
        return left * float(self.vehicle.battery.capacity) / current

    def reset(self) -> None:
        """Return to the start with a full battery and motors off; clock, recording and parameters continue."""
        self.plant.reset(self._start)
        self._many, self._asked_many = None, False
        self.autopilot.reset()
        self.acting_actuators = self.sent_actuators = Actuators.make_zero_inputs()
        self._crash_s = math.inf
        self._reset_sensors_and_estimate()
        self.log_event("back at the start")

    def close(self, outcome: str | None = None, reason: str = "", **attributes: Any) -> None:
        """Finish the recording; the default outcome is that of :meth:`judge_outcome`."""
        if self._finished:
            return
        self._finished = True
        self._close_position_sources()
        if outcome is None:
            outcome, reason = self.judge_outcome()
        if isinstance(self.estimator, KalmanEstimator):
            attributes["estimated_noise"] = self.estimator.describe_noise()
        self.recorder.set_outcome(outcome, reason, mission_flown=self._mission_flown, **attributes)
        self.recorder.close()

    def judge_outcome(self) -> tuple[str, str]:
        """Return outcome and reason of the flight at present."""
        s = self.autopilot.software.mission_state
        if self.plant.crash_cause or self.refusal_reason:
            return "failed", self.plant.crash_cause or self.refusal_reason
        if s.outcome == "failed" and (fault := self.autopilot.refused_source):
            return "failed", f"{POSITION_SOURCE_REFUSED_TEXT}{fault}"
        return (s.outcome, s.reason) if s.outcome else ("unfinished", f"ended in state '{s.state}'")

    def __enter__(self) -> Flight:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self._finished = True
            self._close_position_sources()
            self.recorder.__exit__(kind, error, trace)

    def _close_position_sources(self) -> None:
        for one in (self.camera, self.outside_fixes):
            if one is not None:
                one.close()


_run_stages = make_stage_loop(
    Flight._begin_period,
    Flight._advance_plant,
    Flight._check_contact,
    Flight._measure_sensors,
    Flight._update_estimate,
    Flight._step_control,
    Flight._record_row,
    Flight._end_period,
)


def _make_sensors(
    wanted: SensorSet | str, vehicle: Vehicle, mission: Mission, look: int, seed: int, faults: Sequence[Fault],
    fixes: CameraSensor | ExternalFixes | None,
) -> SensorSet:  # fmt: skip
    """Return the sensors that a flight uses; ideal ones if the vehicle has none."""
    if isinstance(wanted, SensorSet):
        return wanted
    if wanted not in ("ideal", "fitted"):
        raise InputError("sensors", wanted, "is neither ideal nor fitted", "use one of: ideal, fitted")
    if wanted == "fitted" and vehicle.sensors is not None:
        instead = {} if fixes is None else {"position_fix": fixes}
        return make_fitted_sensors(vehicle, mission.world, seed=seed, faults=faults, instead=instead)
    if faults:
        what = "has no table [sensors]" if wanted == "fitted" else "flies on the true state, without sensors and filter"
        raise InputError("fault", str(faults[0]), f"{vehicle.name} {what}", "fly on fitted sensors, or without faults")
    return make_ideal_sensors(vehicle, mission.world, look)
