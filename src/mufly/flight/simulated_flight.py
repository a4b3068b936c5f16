"""A simulated flight: the true helicopter, its autopilot and the recorder, one period of the controllers at a time.

One period at time ``t_k``, in the stages of :mod:`mufly.flight.period_stages`::

    plant integrated from t_(k-1) to t_k under a_(k-2) and the wind
    truth(t_k) --> sensors --> readings --> estimator --> estimate --> autopilot.step --> actuators a_k
    a row of the recording, every second period (every one, on sensors)

The actuators a_k take effect at t_(k+1): the delay of one period is that of a processor that needs the period to
compute. Nothing here knows of the clock on the wall: :func:`mufly.flight.mission_flight.fly_mission` steps as fast as
it can, a link in real time.

It flies on the true state, or on what the vehicle's own sensors say of that and a filter makes of it: ``sensors`` is
``"ideal"`` or ``"fitted"``. In Python, ideal is the default, since most that is asked there is about vehicle,
controllers and missions; the commands, which stand for the vehicle, fly on its sensors.
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

from mufly.camera import CAMERA_FILE_NAME
from mufly.control import FlightController, design_flight_controller
from mufly.dynamics import DrydenWind, describe_model_excess, model_air_limits, standing_state
from mufly.dynamics.model_state import RS_CHARGE
from mufly.errors import InputError
from mufly.estimate import Estimate, Estimator, IdealEstimator, KalmanEstimator, fitted_estimator
from mufly.flight.autopilot import Autopilot
from mufly.flight.controllers import Actuators, Controllers
from mufly.flight.fixes.camera_sensor import (
    LANDED_HEIGHT_M,
    CameraConfig,
    CameraSensor,
    make_picture_stream,
    minimum_sonar_height,
    with_camera,
)
from mufly.flight.fixes.external_fixes import ExternalFixes
from mufly.flight.flight_software import ControlImplementation, FlightSoftware
from mufly.flight.flight_state import FlightState
from mufly.flight.period_stages import BEGIN_PERIOD, CHECK_CONTACT, CONTINUE, DONE, PeriodClock, make_stepper
from mufly.flight.record.recorder import FlightRecorder
from mufly.flight.record.sensor_recording import FIX_DRIFT_ATTRIBUTE, make_sensed_row_writer
from mufly.flight.simulated_plant import SimulatedPlant, make_row_writer
from mufly.logs.mcap import FlightEvent, flight_layout
from mufly.mission import Mission, State, dump_mission, load_mission
from mufly.sensors import (
    Fault,
    FittedSensors,
    Readings,
    SensorSet,
    Truth,
    draw_leaning_vehicle,
    fitted_sensors,
    ideal_sensors,
)
from mufly.vehicle import Vehicle, format_vehicle_toml, load_vehicle
from mufly.version import __version__

_Array = NDArray[np.float64]


RECORD_RATE_HZ = 100.0
RANGE_RING_RATE_HZ = 25.0
AFTER_CRASH_S = 0.5
"""How long after a crash the motors go on (s): what is recorded of it."""

GUST_LENGTH_M = 1.0
_CURRENT_FILTER_S = 5.0


class Flight:
    """The simulated helicopter on the floor, ready to be commanded.

    Parameters
    ----------
    vehicle : Vehicle, str or Path
        Or the name or file of one.
    mission : Mission, str or Path
        Or the name or file of one; it says where the helicopter stands, what stands around it and which limits it has.
    controller : FlightController, optional
        By default ``mufly.control.design_flight_controller(vehicle)``.
    wind : (3,) array_like, optional
        Steady wind N-E-D (m/s), instead of the mission's.
    gust : float, optional
        Standard deviation of the gusts (m/s), instead of the mission's.
    seed : int
        Seed of everything random: gusts, errors of sensors.
    path : str or Path, optional
        MCAP file to record to; without it nothing reaches the disk.
    keep : bool
        Keep every row in memory for :meth:`FlightRecorder.to_dataset`; without it, memory does not grow.
    sensors : "ideal", "fitted" or Sensors
        What it flies on: what is true (the ring of beams read at 25 Hz); what the vehicle's file has in ``[sensors]``
        (a vehicle without flies on the true state, and says so); or sensors of one's own.
    estimator : Estimator, optional
        By default the one that belongs to the sensors; the ideal one believes its readings.
    faults : sequence of Fault
        What goes wrong with fitted sensors; :meth:`inject_fault` adds to it in flight.
    controllers : callable, optional
        Makes what computes the control law, instead of :class:`mufly.flight.controllers.Controllers`; or a class of
        flight software instead of :class:`mufly.flight.flight_software.FlightSoftware`: the exported code, for instance
        (:mod:`mufly.firmware`).
    designed_for : Vehicle, optional
        The vehicle that controllers, autopilot and estimator take it for; by default they know the true one.
    brief : bool
        Record what a flight is judged by, at 100 Hz, and not what its sensors said.
    eye : Eye, optional
        Fly on pictures (:mod:`mufly.flight.fixes.camera_sensor`) instead of the statistical position fix; on fitted
        sensors only.
    outside_model_note : bool
        Fly on fixes that somebody gives to :attr:`outside_fixes`, by a link for instance; on fitted sensors only. With
        ``eye`` as well its pictures are sent to ``eye.stream``, for somebody who makes fixes of them.

    Raises
    ------
    MuflyError
        If the vehicle, the mission or the path is impossible.

    Notes
    -----
    Use as a context manager, or call :meth:`close`: it finishes the recording.
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
            raise InputError("eye", "stream", "its pictures have no receiver", "give an address to stream to")
        if eye is not None and not outside:
            if sensors != "fitted":
                raise InputError("eye", "", "ideal sensors use no pictures", "fly on fitted sensors")
            vehicle = with_camera(vehicle, eye.camera)
            designed_for = None if designed_for is None else with_camera(designed_for, eye.camera)
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
                self.autopilot.software.use_controllers(cast(Callable[[FlightController], Controllers], controllers))
        air = DrydenWind(steady, gust, step_s=self.period_s, length_m=GUST_LENGTH_M, seed=seed)
        self.outside_model_note = describe_model_excess(vehicle, steady, gust)
        unit = draw_leaning_vehicle(vehicle, seed=seed) if sensors == "fitted" else vehicle
        self._start = standing_state(unit, mission.start_m, math.radians(mission.start_heading_deg))
        self.plant = SimulatedPlant(unit, mission.world, air, controller.rate_Hz, self._start)
        self.look_periods = max(1, round(controller.rate_Hz / RANGE_RING_RATE_HZ))
        start = (*mission.start_m, math.radians(mission.start_heading_deg))
        self._least_m = minimum_sonar_height(vehicle)
        self.camera: CameraSensor | None = None
        self.outside_fixes: ExternalFixes | None = None
        if outside:
            stream = None if eye is None else make_picture_stream(eye, vehicle, mission.world, seed)
            self.outside_fixes = ExternalFixes(vehicle, stream)
        elif eye is not None:
            self.camera = CameraSensor(eye, vehicle, mission.world, start, seed)
        fixes = self.camera or self.outside_fixes
        self.sensors = _make_sensors(sensors, vehicle, mission, self.look_periods, seed, faults, fixes)
        sensed = self.uses_fitted_sensors = isinstance(self.sensors, FittedSensors)
        full = sensed and not brief
        if estimator is None:
            estimator = fitted_estimator(believed, mission.world, controller.rate_Hz) if sensed else IdealEstimator()
        self.estimator = estimator
        if self.camera is not None:
            self.camera.estimate_source = self._estimate_and_sonar
        if fixes is not None:
            self.autopilot.excused_sensors = self._blinded_sensors
        weighed: dict[str, float] = {}
        if fixes is not None and isinstance(estimator, KalmanEstimator):
            estimator.uses_fix_covariance = True
            estimator.fix_correlation_s = 0.0 if self.camera is None else self.camera.fix_drift_time_s
            weighed = {FIX_DRIFT_ATTRIBUTE: estimator.fix_correlation_s}
        self.missing_sensors_note = (
            f"{vehicle.name} has no table [sensors]: it flies on the true state"
            if sensors == "fitted" and not sensed
            else ""
        )
        self.recorder = FlightRecorder(
            path,
            {
                "vehicle": vehicle.name,
                "mission": mission.name,
                "at_end": mission.at_end,
                "seed": seed,
                "wind_m_s": steady.tolist(),
                "gust_m_s": gust,
                "model_air_m_s": model_air_limits(vehicle)[1:],
                **({"outside_model": self.outside_model_note} if self.outside_model_note else {}),
                "rate_Hz": controller.rate_Hz,
                **({} if designed_for is None else {"designed_for": designed_for.name}),
                **({"sensors": "fitted", "faults": [str(f) for f in faults]} if sensed else {}),
                **({"position": "link"} if outside else {}),
                **weighed,
                **({} if eye is None else {"camera": eye.camera.name, "camera_floor": eye.floor_texture}),
                "version": __version__,
            },
            layout=flight_layout(vehicle.range_ring.count, sensors=full),
            attachments={}
            if path is None
            else {"vehicle.toml": format_vehicle_toml(vehicle), "mission.toml": dump_mission(mission)},
            scene_view={
                "world": mission.world,
                "waypoints": [w.position_m for w in mission.waypoint],
                "rotor_radius": float(vehicle.rotors.radius),
            },
            keep=keep,
        )
        if self.camera is not None and path is not None:
            self.camera.record_pictures(Path(path).with_name(CAMERA_FILE_NAME), self.recorder.start_time_ns)
        self.records_measurements = not brief
        self._write = make_row_writer(self.recorder, measured=not brief)
        self._write_sensed = make_sensed_row_writer(self.recorder) if full else None
        self.record_periods = 1 if full else max(1, round(controller.rate_Hz / RECORD_RATE_HZ))
        self.acting_actuators = self.sent_actuators = Actuators.idle()
        self.clock = PeriodClock()
        self.listener: Callable[[Truth, Estimate], None] = lambda truth, estimate: None
        self.listener_periods = 0  # periods; 0: nobody listens
        self._many: Callable[..., bool] | None = None
        self._asked_many = False
        self._measure_start()
        self._crash_s = math.inf
        self.current_A = self.autopilot.hover_current_A
        self._finished = self._mission_flown = False
        self.refusal_reason = ""
        self.autopilot.listeners.append(self._record_event)

    def _measure_start(self) -> None:
        self.sensors.reset()
        self.estimator.reset()
        self.plant.check_collision()
        self._is_estimated = False
        self._measure()
        self._estimate = self.estimator.update(self.readings, np.zeros(4))
        self.autopilot.observe_estimate(self._estimate)
        self.is_first_period, self._rests = True, False
        # The next period begins with an instant that a filter has heard of, and it hears of every instant once.
        self._is_estimated = self.uses_fitted_sensors

    def _estimate_and_sonar(self) -> tuple[Estimate | None, float]:
        """What goes with a picture: the estimate of the period before, and what the sonar said last (m)."""
        if not hasattr(self, "readings"):
            return None, math.nan
        sonar = self.readings.latest.get("ground_distance")
        return self._estimate, math.nan if sonar is None else float(sonar.value)

    def _blinded_sensors(self) -> tuple[str, ...]:
        """What sees nothing now, as it should: a camera that looks down, from when legs touch the floor in a landing
        until the sonar sees it go up again. Pictures are told apart down to some 3 cm above the floor."""
        m, sonar = self._estimate_and_sonar()
        if sonar > self._least_m:
            self._rests = False
        elif m is not None and self.autopilot.software.state == State.LANDING:
            self._rests = self._rests or -float(m.position[2]) < LANDED_HEIGHT_M
        return ("position_fix",) if self._rests else ()

    @property
    def truth(self) -> Truth:
        """What is true at the instant of the last readings."""
        return self._truth

    @property
    def estimate(self) -> Estimate:
        """What is believed of it."""
        return self._estimate

    @property
    def time_s(self) -> float:
        """Time of the last readings (s)."""
        return self._truth.time_s

    def step_period(self) -> None:
        """Advance by one period of the controllers."""
        if self.is_first_period:
            self.finish_period(self.acting_actuators.input_array)
        else:
            self.clock.stage = BEGIN_PERIOD
            _run_stages(self)

    def finish_period(self, acted: NDArray[np.floating[Any]]) -> None:
        """Run the stages of a period after the plant was advanced; ``acted`` (4,) are its inputs over the period."""
        self._acted = acted
        self.clock.stage = CHECK_CONTACT
        _run_stages(self)

    def advance_until(self, until: int, **more: Any) -> None:
        """Advance by one period, or up to period ``until`` where nothing has to be decided before."""
        if not self._asked_many:
            self._many, self._asked_many = self.autopilot.software.make_batch_runner(self), True
        if self._many is None or not self._many(until, **more):
            self.step_period()

    def set_instant(self, truth: Truth, readings: Readings, estimate: Estimate) -> None:
        """Take truth, readings and estimate at the end of periods that the compiled loop ran."""
        self._truth, self.readings, self._estimate = truth, readings, estimate

    @property
    def records_truth(self) -> bool:
        """Whether a row of the recording holds nothing of sensors with errors."""
        return self._write_sensed is None

    @property
    def current_filter_share(self) -> float:
        """Share of a new current in that of late, every ``look_periods`` periods."""
        return self.look_periods * self.period_s / _CURRENT_FILTER_S

    # The stages of a period, in the order of mufly.flight.period_stages; the last one ends every call

    def _begin_period(self) -> int:
        return CONTINUE

    def _advance_plant(self) -> int:
        self._acted = self.acting_actuators.input_array
        self.plant.advance_period(self.acting_actuators)
        self.acting_actuators = self.sent_actuators
        return CONTINUE

    def _check_contact(self) -> int:
        plant, autopilot = self.plant, self.autopilot
        if plant.period_count % self.look_periods == 0:
            plant.check_collision()
            flying = autopilot.software.motors == "fly"
            self.current_A += self.current_filter_share * (
                (float(plant.current) if flying else autopilot.hover_current_A) - self.current_A
            )
        return CONTINUE

    def _measure(self) -> int:
        if not self._is_estimated:
            self._truth = self.plant.truth
            self.readings = self.sensors.read(self._truth)
        return CONTINUE

    def _update_estimate(self) -> int:
        if not self._is_estimated:
            self._estimate = self.estimator.update(self.readings, self._acted.astype(np.float64, copy=False))
        self.is_first_period = self._is_estimated = False
        if self.camera is not None and (news := self.camera.tracking_message()):
            self.log_event(news, "info" if news.endswith("again") else "warning")
        return CONTINUE

    def _control(self) -> int:
        self.sent_actuators = self.autopilot.step(self._estimate)
        return CONTINUE

    def _record(self) -> int:
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
        return CONTINUE

    def _end_period(self) -> int:
        if self.plant.crash_cause:
            self._handle_crash()
        return DONE

    def _handle_crash(self) -> None:
        if not self.autopilot.crash_cause:
            self.autopilot.crash_cause = self.plant.crash_cause
            self._crash_s = self.time_s
            self.log_event(self.plant.crash_cause, "error")
        elif self.time_s >= self._crash_s + AFTER_CRASH_S and self.autopilot.software.motors != "off":
            self.autopilot.emergency_stop()

    def inject_fault(self, fault: Fault) -> None:
        """Let something go wrong with a sensor, at the fault's time or, where that is past, now; an event tells.

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
        """Nothing is wrong with the sensors any more."""
        if isinstance(self.sensors, FittedSensors) and self.sensors.all_faults:
            self.sensors.clear_faults()
            self.log_event("all faults cleared")

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What is or will be wrong with the sensors."""
        there = self.sensors.all_faults if isinstance(self.sensors, FittedSensors) else ()
        return tuple(f for f in there if f.stop_s > self.time_s)

    def log_event(self, text: str, level: str = "info") -> None:
        """Put a line into the log of events and the recording: ``level`` "info", "warning" or "error"."""
        self.autopilot.log_event(text, level)

    def _record_event(self, event: FlightEvent) -> None:
        self._mission_flown |= self.autopilot.software.mission_state.mission_begun
        self.recorder.add_event(event.time_s, event.state, event.text, event.level)

    @property
    def status(self) -> FlightState:
        """How everything is now."""
        plant, truth = self.plant, self._truth
        return replace(
            self.autopilot.status,
            crash_cause=plant.crash_cause,
            readings=self.readings,
            actuators=self.acting_actuators,
            battery_current=float(truth.current),
            battery_charge=truth.battery_charge,
            battery_left_s=self._battery_left_s(),
            truth=truth,
            faults=self.faults,
        )

    def _battery_left_s(self) -> float:
        """From the charge that is left above the one at which the voltage under this current is too low."""
        p, current = self.plant.parameters, max(self.current_A, 1e-3)
        low = self.autopilot.software.plan.low_battery_V + float(p["battery_resistance"]) * current
        curve = np.asarray(p["battery_curve"], dtype=np.float64)
        empty = float(np.interp(low, curve, np.linspace(0.0, 1.0, len(curve))))
        left = max(0.0, float(self.plant.state[RS_CHARGE]) - empty)
        return left * float(self.vehicle.battery.capacity) / current

    def reset(self) -> None:
        """Back to the start with a full battery, motors off; the clock, the recording and the parameters go on."""
        self.plant.reset(self._start)
        self._many, self._asked_many = None, False
        self.autopilot.reset()
        self.acting_actuators = self.sent_actuators = Actuators.idle()
        self._crash_s = math.inf
        self._measure_start()
        self.log_event("back at the start")

    def close(self, outcome: str | None = None, reason: str = "", **attributes: Any) -> None:
        """Finish the recording; by default with the outcome that the autopilot or a crash gave the flight."""
        if self._finished:
            return
        self._finished = True
        self._close_position_sources()
        if outcome is None:
            outcome, reason = self.judge_outcome()
        self.recorder.set_outcome(outcome, reason, mission_flown=self._mission_flown, **attributes)
        self.recorder.close()

    def judge_outcome(self) -> tuple[str, str]:
        """Outcome and reason of the flight as it stands."""
        s = self.autopilot.software.mission_state
        if self.plant.crash_cause or self.refusal_reason:
            return "failed", self.plant.crash_cause or self.refusal_reason
        return (s.outcome, s.reason) if s.outcome else ("unfinished", f"in state '{s.state}' when it was ended")

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


_run_stages = make_stepper(
    Flight._begin_period,
    Flight._advance_plant,
    Flight._check_contact,
    Flight._measure,
    Flight._update_estimate,
    Flight._control,
    Flight._record,
    Flight._end_period,
)


def _make_sensors(
    wanted: SensorSet | str, vehicle: Vehicle, mission: Mission, look: int, seed: int, faults: Sequence[Fault],
    fixes: CameraSensor | ExternalFixes | None,
) -> SensorSet:  # fmt: skip
    """The sensors asked for; ideal ones where a vehicle has none."""
    if isinstance(wanted, SensorSet):
        return wanted
    if wanted not in ("ideal", "fitted"):
        raise InputError("sensors", wanted, "is neither ideal nor fitted", "use one of: ideal, fitted")
    if wanted == "fitted" and vehicle.sensors is not None:
        instead = {} if fixes is None else {"position_fix": fixes}
        return fitted_sensors(vehicle, mission.world, seed=seed, faults=faults, instead=instead)
    if faults:
        what = "has no table [sensors]" if wanted == "fitted" else "flies on the true state"
        raise InputError("fault", str(faults[0]), f"{vehicle.name} {what}", "fly on fitted sensors, or without faults")
    return ideal_sensors(vehicle, mission.world, look)
