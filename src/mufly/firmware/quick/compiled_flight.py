"""Simulate many periods of a flight in one compiled call: plant, inertial unit, filter and flight software.

Numba compiles the loop (:mod:`mufly.firmware.quick.compiled_loop`), which runs the stages of
:mod:`mufly.flight.period_stages` over the arrays of plant, sensors, filter and flight software. The loop calls the same
functions as a flight that is simulated period by period: plant (:mod:`mufly.flight.simulated_plant`), inertial unit
(:mod:`mufly.sensors.imu`) and other sensors (:mod:`mufly.sensors.sampling`). It calls filter and flight software in C
by their addresses. Both ways therefore give equal flights, bit for bit (``tests/firmware/test_many.py``).

The loop returns to Python for the following events, and continues in the middle of the period:

- a sensor with a fault is due (:data:`STOP_TO_SAMPLE_SENSORS`),
- the filter changes a sensor's status (:data:`STOP_TO_UPDATE_STATUS`),
- a listener of the true state is due (:data:`STOP_TO_CALL_LISTENER`).

A call ends when the log or the motor mode changes (:data:`STOP_LOG_OR_MODE_CHANGED`), and when the vehicle touches an
obstacle (:data:`STOP_ON_CONTACT`); the flight in Python then finishes the period. Listeners of estimates are called at
the end of a call. Commands, faults of the inertial unit and crashes are simulated period by period
(:meth:`Flight.step_period`).

Three stages have a body in each language. Control: Python processes commands, arming and events. Measurement: a fault,
a camera or a link gives objects, which a compiled sensor does not. Recording: readings are recorded from those objects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.model_state import (
    BODY_RATE_SLICE,
    MODEL_ATTITUDE,
    MOTOR_INPUT_SLICE,
    NED_POSITION_SLICE,
    NED_VELOCITY_SLICE,
    SERVO_INPUT_SLICE,
)
from mufly.estimate import Estimate, IdealEstimator
from mufly.estimate.filter.filter_records import ERROR_GYRO_BIAS, NOMINAL_ATTITUDE, READING_RANGE_RING, SENSOR_COUNT
from mufly.estimate.filter.output_predictor import COVARIANCE_INTERVAL_TICKS
from mufly.estimate.kalman_estimator import PUBLISHED_FIELDS, KalmanEstimator
from mufly.firmware.quick.compiled_loop import (
    LISTENER_ANGLES_START,
    LISTENER_ATTITUDE_START,
    LISTENER_FILTER_STATE_START,
    LISTENER_RATES_START,
    LISTENER_ROW_SIZE,
    LISTENER_SPECIFIC_FORCE_START,
    LISTENER_STATE_START,
    LISTENER_STATUS_ROW_COLUMN,
    LISTENER_SUPPLY_START,
    LISTENER_TICK_COLUMN,
    LISTENER_VALID_COLUMN,
    LISTENER_VOLTAGE_COLUMN,
    LISTENER_WIND_START,
    LOG_ATTITUDE_START,
    LOG_MISSION_STATE_COLUMN,
    LOG_MOTOR_INPUTS_START,
    LOG_REF_ATTITUDE_START,
    LOG_REF_POSITION_START,
    LOG_REF_VELOCITY_START,
    LOG_ROW_SIZE,
    LOG_SERVO_INPUTS_START,
    LOG_STATE_START,
    LOG_SUPPLY_START,
    LOG_TIME_COLUMN,
    LOG_WIND_START,
    LOOP_CLOCK_DTYPE,
    MAX_PERIODS_PER_CALL,
    RECORD_OFFSETS_DTYPE,
    SENSOR_STATUS_SIZE,
    SENSOR_STATUS_START,
    STATUS_FAULT_COMPONENT_COLUMN,
    STATUS_ROW_SIZE,
    STATUS_SIGMA_START,
    STATUS_TICK_COLUMN,
    STOP_NOT_FINITE,
    STOP_ON_CONTACT,
    STOP_TO_CALL_LISTENER,
    STOP_TO_SAMPLE_SENSORS,
    STOP_TO_UPDATE_STATUS,
    FilterArrays,
    IdealLoopArguments,
    PlantArrays,
    SensedLoopArguments,
    SensorArrays,
    SoftwareArrays,
    run_ideal_periods,
    run_sensed_periods,
)
from mufly.flight.controllers import Actuators
from mufly.flight.period_stages import STAGE_BEGIN_PERIOD
from mufly.flight.simulated_flight import Flight
from mufly.flight.simulated_plant import append_rows
from mufly.mission import State
from mufly.sensors import FittedSensors, Imu, Readings, SensorSet, Truth
from mufly.sensors.faults import FaultySensor
from mufly.sensors.periodic import PeriodicSensor
from mufly.sensors.readings import IdealRangeRing
from mufly.sensors.sampling import SAMPLED_SENSORS, collect_sampling_arguments

_Array = NDArray[np.float64]


def _unpack_status_row(row: _Array) -> dict[str, Any]:
    """Return covariance, deviations and sensor statuses in a row of the compiled loop, by their names in the filter."""
    of = row[SENSOR_STATUS_START:STATUS_FAULT_COMPONENT_COLUMN].reshape(SENSOR_COUNT, SENSOR_STATUS_SIZE)
    parts = (
        row[:STATUS_SIGMA_START].reshape(ERROR_GYRO_BIAS, ERROR_GYRO_BIAS),
        row[STATUS_SIGMA_START:SENSOR_STATUS_START],
        *of.T,
        row[STATUS_FAULT_COMPONENT_COLUMN],
        row[STATUS_TICK_COLUMN],
    )
    return dict(zip(PUBLISHED_FIELDS, parts, strict=True))


class CompiledFlight:
    """Compiled loop that simulates one flight with the exported flight software, many periods in one call.

    Parameters
    ----------
    flight : Flight
        Flight with a :class:`mufly.firmware.FirmwareSoftware`.
    """

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        software: Any = flight.autopilot.software
        self._software, self._board = software, software.software_instance
        self._filter: KalmanEstimator | None = None
        self._ring: IdealRangeRing | None = None
        self._faulty: tuple[FaultySensor, ...] = ()
        self._sensors_by_index: dict[int, FaultySensor] = {}
        self._faulty_imu: Any = None
        self._imu: Any = None
        self.is_supported = flight.records_only_truth and self._adopt_sensors_if_supported(flight, flight.sensors)
        if not self.is_supported:
            return
        plant, beams = flight.plant, flight.vehicle.range_ring.count
        self._software_arrays = _make_software_arrays(software)
        clock = self._clock = np.zeros(1, LOOP_CLOCK_DTYPE).view(np.recarray)[0]
        legs, clock.rotor_radius, obstacles, *tables = plant.collision_shape
        self._contact_tables: tuple[Any, ...] = (legs, obstacles, *tables)
        clock.contact_interval, clock.record_interval = flight.look_periods, flight.record_periods
        clock.steps_per_period, clock.rate_Hz, clock.step_s = plant.step_count, plant.rate_Hz, plant.step_s
        clock.beam_count = min(beams, self._board.beam_count)
        clock.hover_current_A, clock.current_filter_weight = (
            flight.autopilot.energy_check.hover_current_A,
            flight.current_filter_weight,
        )
        self._log_rows = np.empty((MAX_PERIODS_PER_CALL, LOG_ROW_SIZE + beams))
        self._acting = np.zeros((3, 4))
        self._status_rows = np.zeros((2 + MAX_PERIODS_PER_CALL // COVARIANCE_INTERVAL_TICKS + 1, STATUS_ROW_SIZE))
        self._listener_rows = np.zeros((MAX_PERIODS_PER_CALL + 1, LISTENER_ROW_SIZE + beams))
        if self._filter is not None:
            self._filter_arrays: FilterArrays = make_filter_arrays(self._filter, self._board.list_reason_text_numbers())
            self._sampling_table: tuple[Any, ...] = collect_sampling_arguments(
                {k: one.sensor for k, one in self._sensors_by_index.items()}
            )
        elif self._ring is not None:
            clock.ring_interval = self._ring.read_interval
        self._reported_periods = 0
        self._last_statuses: Any = None
        self._next_sample_times = [math.inf] * len(self._faulty)

    def _adopt_sensors_if_supported(self, flight: Flight, sensors: SensorSet) -> bool:
        """Store sensors and estimator of a flight; return whether the compiled loop supports them."""
        if isinstance(flight.estimator, KalmanEstimator) and isinstance(sensors, FittedSensors):
            self._filter = flight.estimator
            all_of_them = [s for s in sensors.sensors if isinstance(s, FaultySensor)]
            self._faulty = tuple(s for s in all_of_them if isinstance(s.sensor, PeriodicSensor))
            self._sensors_by_index = {
                k: s for k, kind in enumerate(SAMPLED_SENSORS) for s in self._faulty if type(s.sensor) is kind
            }
            rest = [s for s in all_of_them if not isinstance(s.sensor, PeriodicSensor)]
            if len(rest) == 1 and isinstance(rest[0].sensor, Imu):
                self._faulty_imu, self._imu = rest[0], rest[0].sensor
            return self._imu is not None and self._filter.backend.name == "C"
        self._ring = next((s for s in sensors.sensors if isinstance(s, IdealRangeRing)), None)
        return type(flight.estimator) is IdealEstimator and len(sensors.sensors) == 3 and self._ring is not None

    def run_periods(self, until: int, *, until_valid: bool = False) -> bool:
        """Advance to period ``until``, but stop at an event or, with ``until_valid``, at the first valid estimate.

        Return True after an advance; return False without one if Python must run the next period, for example because
        of a request or a fault.
        """
        flight, plant, auto = self._flight, self._flight.plant, self._flight.autopilot
        if not self.is_supported:
            return False
        until = min(until, plant.period_count + MAX_PERIODS_PER_CALL)
        if self._filter is not None:  # Python handles faults
            ahead = [f.start_s for one in (self._faulty_imu, *self._faulty) for f in one.faults]
            until = min([
                until,
                *(math.floor(min(s, 1e9) * plant.rate_Hz) - 1 for s in ahead if s > plant.time_s),
            ])  # fmt: skip
        if until - plant.period_count < 2 or not self._has_no_request_or_fault():
            return False
        board, c = self._board, self._clock
        board.prepare_compiled_periods(self._software.law)
        wind = plant.upcoming_wind(until - plant.period_count)
        c.stage, c.tick, c.start_tick, c.stop_tick = STAGE_BEGIN_PERIOD, plant.period_count, plant.period_count, until
        c.is_armed, c.stop_when_valid, c.listener_interval = auto.armed, until_valid, flight.listener_periods
        c.wind_samples = c.periods_run = c.log_rows = c.status_rows = c.listener_rows = 0
        c.last_mission_tick, c.current_A, c.next_python_sample_s = -1, flight.current_A, math.inf
        self._acting[1], self._acting[2] = flight.acting_actuators.input_array, flight.sent_actuators.input_array
        self._mission_state, ran = str(self._software.state), self._software.motors != "off"
        p, run = self._assemble_loop(wind)
        self._reported_periods = 0
        while True:
            why = run(p)
            if why == STOP_TO_SAMPLE_SENSORS:
                self._sample_python_sensors()
            elif why == STOP_TO_UPDATE_STATUS:
                assert self._filter is not None
                self._report_status(int(c.periods_run))
                told = int(c.filter_periods_run) - self._filter.period_count
                self._call_listener()
                board.write_estimate(
                    self._filter.read_estimate(int(c.tick) / plant.rate_Hz, bool(c.is_estimate_valid), told)
                )
                self._published_row = int(c.status_rows)
                c.has_no_sensor_fault = auto.has_no_sensor_events(self._filter.sensor_statuses)
            elif why == STOP_TO_CALL_LISTENER:
                truth = replace(self._current_truth(), wind=wind[int(c.wind_samples) - 1].copy())
                flight.listener(truth, self._read_sensors_and_estimate(truth)[1])
            else:
                break
        self._synchronise_simulation(why, wind, ran)
        return True

    def _assemble_loop(self, wind: _Array) -> tuple[Any, Any]:
        """Return the arguments and the function of the compiled loop.

        The function is :func:`run_sensed_periods` for a flight with sensors, else :func:`run_ideal_periods`.
        """
        plant = self._flight.plant
        on_plant = PlantArrays(
            plant.state, plant.packed_parameters, plant.attitude, plant.battery_output, wind, self._acting,
            *self._contact_tables,
        )  # fmt: skip
        if self._filter is not None:
            self._clock.filter_periods_run = self._filter.period_count
            sensors = SensorArrays(
                self._imu.sampling_arguments(self._flight.period_s), *self._assign_sensors_by_fault()
            )
            return SensedLoopArguments(
                self._clock, on_plant, self._software_arrays, self._filter.ranges, self._log_rows, sensors,
                self._filter_arrays, self._status_rows, self._listener_rows,
            ), run_sensed_periods  # fmt: skip
        assert self._ring is not None
        return IdealLoopArguments(
            self._clock, on_plant, self._software_arrays, self._ring.ranges, self._log_rows,
            self._ring.range_arguments, self._ring.clock,
        ), run_ideal_periods  # fmt: skip

    def _has_no_request_or_fault(self) -> bool:
        """Return whether no request is pending and no fault is active."""
        flight, auto = self._flight, self._flight.autopilot
        motors, now = self._software.motors, flight.plant.time_s
        return (
            not flight.plant.crash_cause
            and not flight.is_first_period
            and self._software.law.are_gains_settled
            and not auto.has_pending_input
            and (motors != "off" or not auto.armed)
            and (self._faulty_imu is None or not any(t.start_s <= now < t.stop_s for t in self._faulty_imu.faults))
        )

    def _current_truth(self) -> Truth:
        plant = self._flight.plant
        tick = int(self._clock.tick)
        return Truth(
            tick / plant.rate_Hz, tick, plant.state.copy(), plant.attitude.copy(), plant.wind,
            float(plant.battery_output[0]), float(plant.battery_output[1]),
        )  # fmt: skip

    def _sample_python_sensors(self) -> None:
        """Sample the due sensors that Python handles."""
        truth, filtered = self._current_truth(), self._filter
        assert filtered is not None
        t, scanned_s = truth.time_s, filtered.reading_times[READING_RANGE_RING]
        for k, sensor in enumerate(self._faulty):
            if self._next_sample_times[k] <= t:
                filtered.write_input_readings(sensor.read(truth), t)
                self._next_sample_times[k] = _next_sample_time(sensor, t)
        self._clock.next_python_sample_s = min(self._next_sample_times, default=math.inf)
        if filtered.reading_times[READING_RANGE_RING] != scanned_s:
            self._board.write_ranges(filtered.ranges)

    def _assign_sensors_by_fault(self) -> Any:
        """Let the compiled loop sample the sensors without an active fault, and Python the others.

        Return the arguments with which the loop samples (:func:`mufly.sensors.sampling.collect_sampling_arguments`).
        """
        flight, filtered = self._flight, self._filter
        assert filtered is not None
        now, quiet = flight.plant.time_s, self._sampling_table[0]
        self._faulty_imu.is_altered = False
        asked = []
        for k, one in self._sensors_by_index.items():
            lent = not any(t.start_s <= now < t.stop_s for t in one.faults)
            assert isinstance(one.sensor, PeriodicSensor)
            quiet[k] = one.sensor.next_sample_s if lent else math.inf
            if lent:
                one.is_altered = False
                asked.append(one)
        self._next_sample_times = [math.inf if one in asked else _next_sample_time(one, now) for one in self._faulty]
        self._clock.next_python_sample_s = min(self._next_sample_times, default=math.inf)
        self._clock.next_sample_s = -math.inf
        # After single periods, the previous row is not the last published status.
        if self._last_statuses is not filtered.sensor_statuses:
            self._status_rows[0] = math.nan
        self._published_row = 0
        self._clock.has_no_sensor_fault = flight.autopilot.has_no_sensor_events(filtered.sensor_statuses)
        return self._sampling_table

    def _call_listener(self) -> None:
        """Pass truth and estimate of the instants stored by the compiled loop to the flight's listener.

        The filter's statuses are published up to the last of these instants.

        A listener with a method ``add_estimates`` gets all instants in one call: true and estimated position, velocity
        and attitude (n, 9), covariances (n, 9, 9), and validity (n,).
        """
        flight, filtered, c = self._flight, self._filter, self._clock
        assert filtered is not None
        rows, rate = self._listener_rows[: c.listener_rows], flight.plant.rate_Hz
        c.listener_rows = 0
        together: Any = getattr(flight.listener, "add_estimates", None)
        if together is not None and len(rows):
            told, nine = rows[:, LISTENER_STATUS_ROW_COLUMN].astype(int), ERROR_GYRO_BIAS
            covariances = self._status_rows[told, :STATUS_SIGMA_START].reshape(-1, nine, nine)
            covariances[told == 0] = filtered.covariance[:nine, :nine]
            moving = rows[:, LISTENER_STATE_START : LISTENER_STATE_START + MODEL_ATTITUDE]
            true = np.hstack([moving, rows[:, LISTENER_ATTITUDE_START:LISTENER_FILTER_STATE_START]])
            moving = rows[:, LISTENER_FILTER_STATE_START : LISTENER_FILTER_STATE_START + NOMINAL_ATTITUDE]
            estimated = np.hstack([moving, rows[:, LISTENER_ANGLES_START:LISTENER_ROW_SIZE]])
            together(true, estimated, covariances, rows[:, LISTENER_VALID_COLUMN] != 0.0)
            return
        for row in rows:
            self._publish_status_of_row(int(row[LISTENER_STATUS_ROW_COLUMN]))
            tick = int(row[LISTENER_TICK_COLUMN])
            truth = Truth(
                tick / rate,
                tick,
                row[LISTENER_STATE_START:LISTENER_ATTITUDE_START].copy(),
                row[LISTENER_ATTITUDE_START:LISTENER_FILTER_STATE_START].copy(),
                row[LISTENER_WIND_START:LISTENER_SUPPLY_START].copy(),
                *row[LISTENER_SUPPLY_START:LISTENER_SPECIFIC_FORCE_START].tolist(),
            )
            flight.listener(
                truth,
                filtered.make_estimate(
                    truth.time_s,
                    bool(row[LISTENER_VALID_COLUMN]),
                    row[LISTENER_FILTER_STATE_START:LISTENER_RATES_START].copy(),
                    row[LISTENER_RATES_START:LISTENER_ANGLES_START],
                    row[LISTENER_ANGLES_START:LISTENER_ROW_SIZE],
                    float(row[LISTENER_VOLTAGE_COLUMN]),
                    row[LISTENER_ROW_SIZE:].copy(),
                    row[LISTENER_SPECIFIC_FORCE_START:LISTENER_STATE_START],
                ),
            )

    def _publish_status_of_row(self, rows: int) -> None:
        """Publish covariance and sensor statuses in row ``rows`` of the stored statuses, unless already published."""
        if rows > self._published_row:
            assert self._filter is not None
            self._filter.publish_covariance_and_statuses(_unpack_status_row(self._status_rows[rows].copy()))
            self._published_row = rows

    def _report_status(self, periods: int, last: str = "") -> None:
        """Report the sensor statuses of past periods to the autopilot; ``last``: mission state of the last period."""
        auto, filtered = self._flight.autopilot, self._filter
        if filtered is not None and not auto.has_no_sensor_events(filtered.sensor_statuses):
            for k in range(self._reported_periods, periods):
                state = last if last and k == periods - 1 else self._mission_state
                auto.report_sensor_checks(
                    filtered.sensor_statuses, int(self._clock.start_tick + 1 + k) / self._flight.plant.rate_Hz, state
                )
        self._reported_periods = periods

    def _read_sensors_and_estimate(self, truth: Truth) -> tuple[Readings | None, Estimate]:
        """Return the present readings and estimate; with a filter the readings are None, because the flight reads
        them on demand.
        """
        flight, filtered, c = self._flight, self._filter, self._clock
        if filtered is None:
            readings = flight.sensors.read(truth)
            return readings, flight.estimator.update(readings)
        estimate = filtered.read_estimate(
            truth.time_s, bool(c.is_estimate_valid), int(c.filter_periods_run) - filtered.period_count
        )  # fmt: skip
        return None, estimate

    def _synchronise_simulation(self, why: int, wind: _Array, ran: bool) -> None:
        """Copy state, log and sensor statuses from the compiled loop to the Python simulation."""
        flight, plant, auto = self._flight, self._flight.plant, self._flight.autopilot
        software, c, filtered = self._software, self._clock, self._filter
        periods, rows, due, winds = (
            int(n) for n in (c.periods_run, c.log_rows, c.last_mission_tick, c.wind_samples)
        )  # fmt: skip
        plant.advance_wind(wind[winds - 1], winds)
        truth = self._current_truth()
        flight.current_A = float(c.current_A)
        self._board.read_log()
        software.clear_cached_records()
        whole = why not in (STOP_ON_CONTACT, STOP_NOT_FINITE)
        last = int(whole and truth.tick % flight.record_periods == 0)
        if filtered is not None:
            self._call_listener()
            self._report_status(periods, str(software.state))
            self._publish_status_of_row(int(c.status_rows))
        self._record_rows(0, rows - last)
        if filtered is not None or whole:
            readings, estimate = self._read_sensors_and_estimate(truth)
        if filtered is not None:
            self._status_rows[0], self._last_statuses = self._status_rows[c.status_rows], filtered.sensor_statuses
        flight.acting_actuators = Actuators(
            self._acting[1, MOTOR_INPUT_SLICE].copy(), self._acting[1, SERVO_INPUT_SLICE].copy()
        )
        flight.sent_actuators = Actuators(
            self._acting[2, MOTOR_INPUT_SLICE].copy(), self._acting[2, SERVO_INPUT_SLICE].copy()
        )
        is_due = whole and due == truth.tick
        # Motors change in the last period only: that ends a call.
        was_due = due >= 0 and (not is_due or periods > software.mission_step_periods)
        if whole:
            flight.store_loop_results(truth, readings, estimate)
        auto.update_after_compiled_periods(
            estimate if whole else None, flight.sent_actuators, ran=ran if was_due else None, due=is_due
        )
        self._record_rows(rows - last, rows)
        plant.advance_clock(winds)
        if not whole:
            flight.finish_period(self._acting[0].copy())

    def _record_rows(self, first: int, stop: int) -> None:
        """Append rows ``first`` to ``stop`` (excluded) of the compiled loop's log to the recording."""
        if stop <= first:
            return
        flight, row = self._flight, self._log_rows[first:stop]
        state, attitude = row[:, LOG_STATE_START:LOG_ATTITUDE_START], row[:, LOG_ATTITUDE_START:LOG_WIND_START]
        measured: dict[str, _Array] = {}
        if flight.records_measurements:
            measured = {
                "measured_position": state[:, NED_POSITION_SLICE], "measured_velocity": state[:, NED_VELOCITY_SLICE],
                "measured_attitude": attitude, "measured_rates": state[:, BODY_RATE_SLICE],
                "range": row[:, LOG_ROW_SIZE:],
            }  # fmt: skip
        truth = Truth(
            row[:, LOG_TIME_COLUMN], 0, state, attitude,  # type: ignore[arg-type]
            row[:, LOG_WIND_START:LOG_SUPPLY_START], *row[:, LOG_SUPPLY_START:LOG_MOTOR_INPUTS_START].T,
        )  # fmt: skip
        states = [_STATE_NAMES[k] for k in row[:, LOG_MISSION_STATE_COLUMN].astype(int).tolist()]
        append_rows(
            flight.recorder,
            truth,
            measured,
            Actuators(
                row[:, LOG_MOTOR_INPUTS_START:LOG_SERVO_INPUTS_START],
                row[:, LOG_SERVO_INPUTS_START:LOG_REF_POSITION_START],
            ),
            (
                row[:, LOG_REF_POSITION_START:LOG_REF_VELOCITY_START],
                row[:, LOG_REF_VELOCITY_START:LOG_REF_ATTITUDE_START],
                row[:, LOG_REF_ATTITUDE_START:LOG_MISSION_STATE_COLUMN],
            ),
            states,
        )


_STATE_NAMES = tuple(str(s) for s in State)


def _next_sample_time(sensor: FaultySensor, time_s: float) -> float:
    """Return the next time at which a sensor, just sampled at ``time_s``, can give a new reading."""
    wakes = sensor.sensor.next_sample_s if isinstance(sensor.sensor, PeriodicSensor) else -math.inf
    for fault in sensor.faults:
        if fault.start_s > time_s:
            wakes = min(wakes, fault.start_s)
        elif time_s < fault.stop_s:
            return -math.inf
    return wakes


def _make_software_arrays(software: Any) -> SoftwareArrays:
    """Return the records of the exported flight software as arrays."""
    ffi, lib, board = software.firmware.ffi, software.firmware.lib, software.software_instance
    raw, raw_estimate = (
        np.frombuffer(ffi.buffer(p), dtype=np.uint8) for p in (board.software_record, board.estimate_record)
    )

    def record_offset(unit: int, *path: str) -> int:
        return int(ffi.offsetof(*path)) // unit

    s, b = "software_t", "estimate_t"
    offsets = np.zeros(1, RECORD_OFFSETS_DTYPE).view(np.recarray)[0]
    offsets.time, offsets.motion, offsets.valid = (
        record_offset(8, b, "time_s"),
        record_offset(8, b, "motion"),
        record_offset(1, b, "valid"),
    )
    offsets.motors, offsets.late_s = record_offset(4, s, "motors"), record_offset(8, s, "since_mission_step_s")
    offsets.log_count, offsets.finished = (
        record_offset(4, s, "mission", "logged_event_count"),
        record_offset(1, s, "mission", "finished"),
    )
    offsets.state = record_offset(4, s, "mission", "state")
    offsets.reference_position, offsets.reference_velocity = (
        record_offset(8, s, "reference", "path", n) for n in ("position", "velocity")
    )
    offsets.reference_heading, offsets.reference_heading_rate = (
        record_offset(8, s, "reference", n) for n in ("heading", "heading_rate")
    )
    offsets.reference_tilt, offsets.ranges = record_offset(8, s, "tilt"), record_offset(8, b, "ranges")
    offsets.position_variance, offsets.attitude_variance = (
        record_offset(8, b, n) for n in ("position_variance", "attitude_variance")
    )
    offsets.specific_force = record_offset(8, b, "specific_force")
    offsets.checks, offsets.check_size = record_offset(4, b, "checks"), ffi.sizeof("sensor_status_t") // 4
    offsets.check_status, offsets.check_reason = (record_offset(4, "sensor_status_t", n) for n in ("status", "why"))
    records = (
        board.setup_record, board.software_record, board.estimate_record, board.command_record, board.actuators_record,
    )  # fmt: skip
    addresses = tuple(int(ffi.cast("uintptr_t", p)) for p in (ffi.addressof(lib, "software_step"), *records))
    return SoftwareArrays(
        raw.view(np.float64), raw.view(np.int32), raw, raw_estimate.view(np.float64), raw_estimate.view(np.int32),
        raw_estimate, np.frombuffer(ffi.buffer(board.actuators_record), dtype=np.float64), offsets, addresses,
    )  # fmt: skip


def make_filter_arrays(
    filtered: KalmanEstimator, texts: NDArray[np.int64], own: Sequence[NDArray[Any]] | None = None
) -> FilterArrays:
    """Return the arrays of a filter in C for the compiled loop.

    ``texts`` holds, for each reason code of the sensor checks, the number of its text in the exported software.

    ``own`` replaces the state that a filter keeps between periods, so that many units share one filter's settings. The
    state consists of memory (1,), the three arrays of the input row, reading times, and scans of the ring.
    """
    mine: Sequence[Any] = (filtered.memory_array, *filtered.input_row, filtered.reading_times, filtered.ring_scans)
    memory, values, is_new, age, times, scans = mine if own is None else own
    m = memory[0]
    step, *held = filtered.backend.function_addresses
    is_fitted = np.zeros(SENSOR_COUNT, np.uint8)
    is_fitted[list(filtered.reading_indices.values())] = 1
    # The last two are numbers, not arrays: a field of an array of one is a view.
    status = (*(m[name] for name in PUBLISHED_FIELDS[:-2]), *(memory[name] for name in PUBLISHED_FIELDS[-2:]))
    return FilterArrays(
        m["x_output"], m["rates_output"], m["angles_output"], values, is_new, age, is_fitted, times, scans,
        filtered.max_range_m, filtered.fused_beam_indices.astype(np.int64), status, texts,
        (step, memory.ctypes.data, *held, *(a.ctypes.data for a in (values, is_new, age))),
    )  # fmt: skip
