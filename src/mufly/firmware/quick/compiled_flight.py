"""Simulate many periods of a flight in one compiled call: plant, inertial unit, filter and flight software.

Numba compiles the loop (:mod:`mufly.firmware.quick.compiled_loop`). The loop calls the same functions as a flight that
is simulated period by period: plant (:mod:`mufly.flight.simulated_plant`), inertial unit (:mod:`mufly.sensors.imu`) and
other sensors (:mod:`mufly.sensors.sampling`). It calls filter and flight software in C by their addresses. Both ways
therefore give equal flights, bit for bit (``tests/firmware/test_many.py``).

The loop returns to Python for the following events, and continues in the middle of the period:

- a sensor with a fault is due (:data:`EXIT_SAMPLE_SENSORS`),
- the filter changes a sensor's status (:data:`EXIT_UPDATE_STATUS`),
- the log or the motor mode changes (:data:`EXIT_LOG_OR_MODE_CHANGED`),
- the vehicle touches an obstacle (:data:`EXIT_CONTACT`),
- a listener of the true state is due (:data:`EXIT_CALL_LISTENER`).

Listeners of estimates are called at the end of a call. Commands, faults of the inertial unit and crashes are simulated
period by period (:meth:`Flight.tick`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.model_state import MOTORS, POSITION, RATES, RS_ATT, SERVOS, VELOCITY
from mufly.estimate import Estimate, IdealEstimator
from mufly.estimate.filter_records import EX_GYRO_BIAS, SENSOR_COUNT, SX_ATT
from mufly.estimate.kalman_estimator import PUBLISHED_FIELDS, KalmanEstimator
from mufly.estimate.output_predictor import COVARIANCE_INTERVAL_TICKS
from mufly.firmware.quick.compiled_loop import (
    C_BEAM_COUNT,
    C_CONTACT_INTERVAL,
    C_FILTER_PERIODS,
    C_IMU_SAMPLED,
    C_IS_ARMED,
    C_IS_UNTROUBLED,
    C_IS_VALID,
    C_LAST_DUE_TICK,
    C_LAST_LISTEN_TICK,
    C_LAST_RING_TICK,
    C_LISTEN_INTERVAL,
    C_LISTENER_ROWS,
    C_LOG_ROWS,
    C_LOOP_PHASE,
    C_PERIODS_RUN,
    C_PLANT_STEPS,
    C_RECORD_INTERVAL,
    C_RING_INTERVAL,
    C_SIZE,
    C_STATUS_ROWS,
    C_STOP_TICK,
    C_STOP_WHEN_VALID,
    C_TICK,
    C_WIND_SAMPLES,
    EXIT_CALL_LISTENER,
    EXIT_CONTACT,
    EXIT_NOT_FINITE,
    EXIT_SAMPLE_SENSORS,
    EXIT_UPDATE_STATUS,
    F_CONTACT_RADIUS,
    F_CURRENT_A,
    F_CURRENT_BLEND,
    F_HOVER_CURRENT_A,
    F_LAST_IMU_S,
    F_NEXT_PYTHON_SAMPLE_S,
    F_NEXT_SAMPLE_S,
    F_RATE_HZ,
    F_SIZE,
    F_STEP_S,
    FAULT_COMPONENT_INDEX,
    HEARD_ANGLES,
    HEARD_ATT,
    HEARD_FORCE,
    HEARD_OUT,
    HEARD_RATES,
    HEARD_STATE,
    HEARD_SUPPLY,
    HEARD_TICK,
    HEARD_TOLD,
    HEARD_VALID,
    HEARD_VOLTS,
    HEARD_WIND,
    LISTENER_ROW_SIZE,
    LOG_ROW_SIZE,
    MAX_PERIODS_PER_CALL,
    PHASE_ADVANCE_PLANT,
    ROW_ATT,
    ROW_MISSION,
    ROW_MOTORS,
    ROW_REF_ATT,
    ROW_REF_POS,
    ROW_REF_VEL,
    ROW_SERVOS,
    ROW_STATE,
    ROW_SUPPLY,
    ROW_TIME,
    ROW_WIND,
    SENSOR_STATUS_START,
    SENSOR_WIDE,
    SIGMA_START,
    STATUS_ROW_SIZE,
    TICK_INDEX,
    run_until_event,
)
from mufly.flight.controllers import Actuators
from mufly.flight.simulated_flight import Flight
from mufly.flight.simulated_plant import append_rows
from mufly.mission import State
from mufly.sensors import FittedSensors, Imu, Readings, SensorSet, Truth
from mufly.sensors.faults import FaultySensor
from mufly.sensors.periodic import PUBLISHED_COUNT as TIMES_SAID
from mufly.sensors.periodic import PeriodicSensor
from mufly.sensors.readings import IdealRing
from mufly.sensors.sampling import SAMPLED_SENSORS, sampling_table

_Array = NDArray[np.float64]


def _unpack_status_row(row: _Array) -> dict[str, Any]:
    """Return the fields of a status row by the names of the filter's memory."""
    of = row[SENSOR_STATUS_START:FAULT_COMPONENT_INDEX].reshape(SENSOR_COUNT, SENSOR_WIDE)
    parts = (
        row[:SIGMA_START].reshape(EX_GYRO_BIAS, EX_GYRO_BIAS),
        row[SIGMA_START:SENSOR_STATUS_START],
        *of.T,
        row[FAULT_COMPONENT_INDEX],
        row[TICK_INDEX],
    )
    return dict(zip(PUBLISHED_FIELDS, parts, strict=True))


class CompiledFlight:
    """The compiled loop of one flight with the exported flight software.

    Parameters
    ----------
    flight : Flight
        Flight with a :class:`mufly.firmware.FirmwareSoftware`.
    """

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        software: Any = flight.autopilot.software
        self._software, self._board = software, software.software_instance
        plant, sensors = flight.plant, flight.sensors
        self._filter: KalmanEstimator | None = None
        self._ring: IdealRing | None = None
        self._faulty: tuple[FaultySensor, ...] = ()
        self._sensors_by_index: dict[int, FaultySensor] = {}
        self._sample_times = self._pictures = np.zeros(0)
        self._sampling_arguments: Any = None
        self._faulty_imu: Any = None
        self._imu: Any = None
        self.is_supported = flight.records_truth and self._supports_sensors(flight, sensors)
        if not self.is_supported:
            return
        ffi, lib, board = software.firmware.ffi, software.firmware.lib, self._board
        kept = [np.frombuffer(ffi.buffer(p), dtype=np.uint8) for p in (board.software_record, board.estimate_record)]
        self._record_views = tuple((raw.view(np.float64), raw.view(np.int32), raw) for raw in kept)
        self._out = np.frombuffer(ffi.buffer(board.actuators_record), dtype=np.float64)
        offset = ffi.offsetof
        c, b = "software_t", "estimate_t"
        self._record_offsets = np.array([
            offset(b, "time_s") // 8, offset(b, "motion") // 8, offset(b, "valid"), offset(c, "motors") // 4,
            offset(c, "since_mission_step_s") // 8, offset(c, "mission", "logged_count") // 4,
            offset(c, "mission", "finished"),
            offset(c, "mission", "state") // 4, offset(c, "reference", "path", "position") // 8,
            offset(c, "reference", "path", "velocity") // 8, offset(c, "reference", "heading") // 8,
            offset(c, "reference", "heading_rate") // 8, offset(c, "tilt") // 8, offset(b, "ranges") // 8,
            offset(b, "position_variance") // 8, offset(b, "attitude_variance") // 8,
            offset(b, "specific_force") // 8,
            offset(b, "checks") // 4, ffi.sizeof("sensor_status_t") // 4, offset("sensor_status_t", "status") // 4,
            offset("sensor_status_t", "why") // 4,
        ])  # fmt: skip
        place = [
            int(ffi.cast("uintptr_t", p))
            for p in (
                board.setup_record,
                board.software_record,
                board.estimate_record,
                board.command_record,
                board.actuators_record,
            )
        ]
        call = int(ffi.cast("uintptr_t", ffi.addressof(lib, "software_step")))
        addresses = [call, *place]
        self._filter_arguments: Any = None
        if self._filter is not None:
            m, row = self._filter.memory, self._filter.input_row
            beams = flight.vehicle.range_ring.count
            fitted = np.zeros(SENSOR_COUNT, np.uint8)
            fitted[list(self._filter.reading_indices.values())] = 1
            self._sample_times, self._pictures = np.zeros(SENSOR_COUNT), np.zeros((3, beams))
            of_memory = tuple(m[name] for name in PUBLISHED_FIELDS[:-2])
            self._filter_arguments = (
                m["x_output"],
                m["rates_output"],
                m["angles_output"],
                *row,
                fitted,
                self._sample_times,
                self._pictures,
                self._filter.beam_indices.astype(np.int64),
                (*of_memory, *(self._filter.memory_array[name] for name in PUBLISHED_FIELDS[-2:])),
                board.reason_text_numbers(),
            )
            self._sampling_arguments = sampling_table({k: one.sensor for k, one in self._sensors_by_index.items()})
            step, *held = self._filter.backend.call_addresses
            addresses += [step, self._filter.memory_array.ctypes.data, *held, *(a.ctypes.data for a in row)]
        self._call_addresses = np.array(addresses, dtype=np.int64)
        legs, radius, obstacles, *tables = plant.collision_shape
        self._contact_tables = (legs, obstacles, *tables)
        self._beams = np.zeros(flight.vehicle.range_ring.count)
        self._log_rows = np.empty((MAX_PERIODS_PER_CALL, LOG_ROW_SIZE + self._beams.size))
        self._acting = np.zeros((3, 4))
        self._previous_state, self._imu_reading = np.zeros(plant.state.size), np.zeros((2, 6))
        self._status_rows = np.zeros((2 + MAX_PERIODS_PER_CALL // COVARIANCE_INTERVAL_TICKS + 1, STATUS_ROW_SIZE))
        self._listener_rows = np.zeros((MAX_PERIODS_PER_CALL + 1, LISTENER_ROW_SIZE + self._beams.size))
        self._counters, self._numbers = np.zeros(C_SIZE, np.int64), np.zeros(F_SIZE)
        self._counters[[C_RING_INTERVAL, C_CONTACT_INTERVAL, C_RECORD_INTERVAL, C_PLANT_STEPS, C_BEAM_COUNT]] = (
            0 if self._ring is None else self._ring.read_interval, flight.look_periods, flight.record_periods,
            plant.step_count,
            min(self._beams.size, board.beam_count),
        )  # fmt: skip
        self._numbers[[F_RATE_HZ, F_STEP_S, F_CONTACT_RADIUS, F_HOVER_CURRENT_A, F_CURRENT_BLEND]] = (
            plant.rate_Hz, plant.step_s, radius, flight.autopilot.hover_current_A, flight.current_filter_share,
        )  # fmt: skip
        self._reported_periods, self._start_tick = 0, 0
        self._last_statuses: Any = None
        self._next_sample_times = [math.inf] * len(self._faulty)
        self._last_readings: list[Any] = [None] * len(self._faulty)
        self._last_ranges: Any = None

    def _supports_sensors(self, flight: Flight, sensors: SensorSet) -> bool:
        """Return whether the loop supports sensors and estimator, and store them."""
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
        self._ring = next((s for s in sensors.sensors if isinstance(s, IdealRing)), None)
        return type(flight.estimator) is IdealEstimator and len(sensors.sensors) == 3 and self._ring is not None

    def run_periods(self, until: int, *, until_valid: bool = False) -> bool:
        """Advance to period ``until``, or to the next event; return False if single periods are required."""
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
        if until - plant.period_count < 2 or not self._is_undisturbed():
            return False
        board, c, f = self._board, self._counters, self._numbers
        board.prepare_compiled_periods(self._software.law)
        wind = plant.upcoming_wind(until - plant.period_count)
        c[
            [
                C_LOOP_PHASE,
                C_TICK,
                C_STOP_TICK,
                C_WIND_SAMPLES,
                C_IS_ARMED,
                C_STOP_WHEN_VALID,
                C_PERIODS_RUN,
                C_LOG_ROWS,
                C_LAST_DUE_TICK,
                C_IMU_SAMPLED,
            ]
        ] = (
            PHASE_ADVANCE_PLANT,
            plant.period_count,
            until,
            0,
            auto.armed,
            until_valid,
            0,
            0,
            -1,
            0,
        )
        c[C_LISTEN_INTERVAL], c[C_LAST_LISTEN_TICK], c[C_LAST_RING_TICK] = (
            flight.listener_periods,
            plant.period_count,
            -1,
        )
        c[[C_STATUS_ROWS, C_LISTENER_ROWS]] = 0
        f[F_CURRENT_A] = flight.current_A
        self._acting[1], self._acting[2] = (
            flight.acting_actuators.input_array,
            flight.sent_actuators.input_array,
        )
        imu: Any = None
        self._start_tick = plant.period_count
        self._mission_state, ran = str(self._software.state), self._software.motors != "off"
        f[F_NEXT_PYTHON_SAMPLE_S] = math.inf
        self._latest = dict(flight.readings.latest)
        imu = asked = ring = None
        if self._filter is not None:
            c[C_FILTER_PERIODS], f[F_LAST_IMU_S] = self._filter.period_count, plant.time_s
            normal = np.empty(6 + 6 * self._imu.sample_count(flight.period_s))
            imu = (
                self._previous_state,
                self._imu.source,
                normal,
                self._imu_reading[0],
                self._imu_reading[1],
                self._imu.period_arguments,
            )
            asked = self._assign_sensors()
        elif self._ring is not None:
            ring = self._ring.range_arguments
            self._beams[:] = self._latest["ranges"].value
        self._reported_periods = 0
        while True:
            why = run_until_event(
                c,
                f,
                plant.state,
                plant.packed_parameters,
                wind,
                plant.battery_output,
                plant.attitude,
                self._contact_tables,
                self._acting,
                *self._record_views,
                self._out,
                self._record_offsets,
                self._call_addresses,
                self._log_rows,
                self._beams,
                ring,
                self._filter_arguments,
                imu,
                asked,
                self._status_rows,
                self._listener_rows,
            )
            if why == EXIT_SAMPLE_SENSORS:
                self._sample_python_sensors()
            elif why == EXIT_UPDATE_STATUS:
                assert self._filter is not None
                self._report_status(int(c[C_PERIODS_RUN]))
                told = int(c[C_FILTER_PERIODS]) - self._filter.period_count
                self._call_listener()
                self._collect_samples()
                board.write_estimate(
                    self._filter.read_estimate(int(c[C_TICK]) / plant.rate_Hz, bool(c[C_IS_VALID]), told)
                )
                self._published_row = int(c[C_STATUS_ROWS])
                c[C_IS_UNTROUBLED] = auto.has_no_sensor_events(self._filter.sensor_statuses)
            elif why == EXIT_CALL_LISTENER:
                self._update_ideal_ring()
                truth = replace(self._current_truth(), wind=wind[int(c[C_WIND_SAMPLES]) - 1].copy())
                flight.listener(truth, self._read_at(truth)[1])
            else:
                break
        self._synchronise_simulation(why, wind, ran)
        return True

    def _is_undisturbed(self) -> bool:
        """Return whether no request is pending and no fault is active."""
        flight, auto = self._flight, self._flight.autopilot
        motors, now = self._software.motors, flight.plant.time_s
        return (
            not flight.plant.crash_cause
            and not flight.is_first_period
            and self._software.law.is_settled
            and not auto.has_pending_request
            and (motors != "off" or not auto.armed)
            and (self._faulty_imu is None or not any(t.start_s <= now < t.stop_s for t in self._faulty_imu.faults))
        )

    def _current_truth(self) -> Truth:
        plant = self._flight.plant
        tick = int(self._counters[C_TICK])
        return Truth(
            tick / plant.rate_Hz, tick, plant.state.copy(), plant.attitude.copy(), plant.wind,
            float(plant.battery_output[0]), float(plant.battery_output[1]),
        )  # fmt: skip

    def _sample_python_sensors(self) -> None:
        """Sample the due sensors that Python handles."""
        truth = self._current_truth()
        t = truth.time_s
        assert self._filter is not None
        for k, sensor in enumerate(self._faulty):
            if self._next_sample_times[k] <= t:
                said = sensor.read(truth)
                self._next_sample_times[k] = _next_sample_time(sensor, t)
                if said is not self._last_readings[k]:  # equal: no new reading
                    self._last_readings[k] = said
                    self._latest |= said
                    self._filter.fill_readings(said, t)
        self._numbers[F_NEXT_PYTHON_SAMPLE_S] = min(self._next_sample_times, default=math.inf)
        if self._filter.ranges is not self._last_ranges:
            self._last_ranges = self._filter.ranges
            self._beams[:] = self._last_ranges
            self._board.write_ranges(self._last_ranges)

    def _assign_sensors(self) -> Any:
        """Assign sensors without an active fault to the loop, the others to Python; return the sampling table."""
        flight, filtered = self._flight, self._filter
        assert filtered is not None
        now = flight.plant.time_s
        quiet, asked, times = self._sampling_arguments[0], [], []
        for k, one in self._sensors_by_index.items():
            lent = not any(t.start_s <= now < t.stop_s for t in one.faults)
            assert isinstance(one.sensor, PeriodicSensor)
            quiet[k] = one.sensor.next_sample_s if lent else math.inf
            if lent:
                asked.append(one)
                times.append(int(one.sensor.counts[TIMES_SAID]))
        self._next_sample_times = [math.inf if one in asked else _next_sample_time(one, now) for one in self._faulty]
        self._last_readings, self._last_ranges = (
            [None] * len(self._faulty),
            filtered.ranges,
        )  # single periods may have sampled since
        self._numbers[F_NEXT_PYTHON_SAMPLE_S] = min(self._next_sample_times, default=math.inf)
        self._numbers[F_NEXT_SAMPLE_S] = -math.inf
        filtered.export_reading_state(self._sample_times, self._pictures, self._beams)
        self._reading_counts, self._compiled_sensors = times, asked
        # After single periods, the previous row is not the last published status.
        if self._last_statuses is not filtered.sensor_statuses:
            self._status_rows[0] = math.nan
        self._published_row = 0
        self._counters[C_IS_UNTROUBLED] = flight.autopilot.has_no_sensor_events(filtered.sensor_statuses)
        return self._sampling_arguments

    def _collect_samples(self) -> None:
        """Pass the samples of the loop to sensors and filter."""
        filtered = self._filter
        assert filtered is not None
        for k, one in enumerate(self._compiled_sensors):
            sensor: Any = one.sensor
            if sensor.counts[TIMES_SAID] != self._reading_counts[k]:
                self._reading_counts[k], said = int(sensor.counts[TIMES_SAID]), sensor.make_readings()
                one.accept_external_readings(said)
                self._latest |= said
                filtered.accept_external_readings(said, self._pictures, self._beams)

    def _call_listener(self) -> None:
        """Call the listener with the stored instants.

        A listener with a method ``add_estimates`` gets all instants in one call: true and estimated position, velocity
        and attitude (n, 9), covariances (n, 9, 9), and validity (n,).
        """
        flight, filtered, c = self._flight, self._filter, self._counters
        assert filtered is not None
        rows, rate = self._listener_rows[: c[C_LISTENER_ROWS]], flight.plant.rate_Hz
        c[C_LISTENER_ROWS] = 0
        together: Any = getattr(flight.listener, "add_estimates", None)
        if together is not None and len(rows):
            told, nine = rows[:, HEARD_TOLD].astype(int), EX_GYRO_BIAS
            covariances = self._status_rows[told, :SIGMA_START].reshape(-1, nine, nine)
            covariances[told == 0] = filtered.covariance[:nine, :nine]
            moving = rows[:, HEARD_STATE : HEARD_STATE + RS_ATT]
            true = np.hstack([moving, rows[:, HEARD_ATT:HEARD_OUT]])
            moving = rows[:, HEARD_OUT : HEARD_OUT + SX_ATT]
            estimated = np.hstack([moving, rows[:, HEARD_ANGLES:LISTENER_ROW_SIZE]])
            together(true, estimated, covariances, rows[:, HEARD_VALID] != 0.0)
            return
        for row in rows:
            self._publish_status_up_to(int(row[HEARD_TOLD]))
            tick = int(row[HEARD_TICK])
            truth = Truth(
                tick / rate, tick, row[HEARD_STATE:HEARD_ATT].copy(), row[HEARD_ATT:HEARD_OUT].copy(),
                row[HEARD_WIND:HEARD_SUPPLY].copy(), *row[HEARD_SUPPLY:HEARD_FORCE].tolist(),
            )  # fmt: skip
            flight.listener(truth, filtered.make_estimate(
                truth.time_s, bool(row[HEARD_VALID]), row[HEARD_OUT:HEARD_RATES].copy(), row[HEARD_RATES:HEARD_ANGLES],
                row[HEARD_ANGLES:LISTENER_ROW_SIZE], float(row[HEARD_VOLTS]), row[LISTENER_ROW_SIZE:].copy(),
                row[HEARD_FORCE:HEARD_STATE],
            ))  # fmt: skip

    def _publish_status_up_to(self, rows: int) -> None:
        """Publish the filter's status up to a row, if not yet published."""
        if rows > self._published_row:
            assert self._filter is not None
            self._filter.publish_status(_unpack_status_row(self._status_rows[rows].copy()))
            self._published_row = rows

    def _update_ideal_ring(self) -> None:
        """Pass the last ranges of the loop to the ideal ring."""
        if self._ring is not None and self._counters[C_LAST_RING_TICK] >= 0:
            looked_s = int(self._counters[C_LAST_RING_TICK]) / self._flight.plant.rate_Hz
            self._ring.accept_external_ranges(self._beams, looked_s)

    def _report_status(self, periods: int, last: str = "") -> None:
        """Report the sensor statuses of past periods to the autopilot; ``last``: mission state of the last period."""
        auto, filtered = self._flight.autopilot, self._filter
        if filtered is not None and not auto.has_no_sensor_events(filtered.sensor_statuses):
            for k in range(self._reported_periods, periods):
                state = last if last and k == periods - 1 else self._mission_state
                auto.report_sensor_checks(
                    filtered.sensor_statuses, (self._start_tick + 1 + k) / self._flight.plant.rate_Hz, state
                )
        self._reported_periods = periods

    def _read_at(self, truth: Truth) -> tuple[Readings, Estimate]:
        """Return the latest readings and the estimate."""
        flight, filtered, c = self._flight, self._filter, self._counters
        if filtered is None:
            readings = flight.sensors.read(truth)
            return readings, flight.estimator.update(readings)
        estimate = filtered.read_estimate(
            truth.time_s, bool(c[C_IS_VALID]), int(c[C_FILTER_PERIODS]) - filtered.period_count
        )
        return Readings(truth.time_s, self._latest), estimate

    def _synchronise_simulation(self, why: int, wind: _Array, ran: bool) -> None:
        """Copy the results of the loop into the simulation."""
        flight, plant, auto = self._flight, self._flight.plant, self._flight.autopilot
        software, c, filtered = self._software, self._counters, self._filter
        plant.consume_wind(wind[int(c[C_WIND_SAMPLES]) - 1], int(c[C_WIND_SAMPLES]))
        truth = self._current_truth()
        self._update_ideal_ring()
        if filtered is not None:
            self._collect_samples()
        if filtered is not None and c[C_IMU_SAMPLED]:
            sensed = truth if why not in (EXIT_CONTACT, EXIT_NOT_FINITE) else replace(
                truth, time_s=float(self._numbers[F_LAST_IMU_S]), state=self._previous_state
            )  # fmt: skip
            said = self._imu.accept_external_samples(sensed, *self._imu_reading)
            self._faulty_imu.accept_external_readings(said)
            self._latest |= said
        flight.current_A = float(self._numbers[F_CURRENT_A])
        self._board.read_log()
        software.clear_cached_records()
        periods, rows = int(c[C_PERIODS_RUN]), int(c[C_LOG_ROWS])
        whole = why not in (EXIT_CONTACT, EXIT_NOT_FINITE)
        last = int(whole and truth.tick % flight.record_periods == 0)
        if filtered is not None:
            self._call_listener()
            self._report_status(periods, str(software.state))
            self._publish_status_up_to(int(c[C_STATUS_ROWS]))
        self._record_rows(0, rows - last)
        if filtered is not None or whole:
            readings, estimate = self._read_at(truth)
        if filtered is not None:
            self._status_rows[0], self._last_statuses = (
                self._status_rows[c[C_STATUS_ROWS]],
                filtered.sensor_statuses,
            )
        flight.acting_actuators = Actuators(self._acting[1, MOTORS].copy(), self._acting[1, SERVOS].copy())
        flight.sent_actuators = Actuators(self._acting[2, MOTORS].copy(), self._acting[2, SERVOS].copy())
        if whole:
            flight.set_instant(truth, readings, estimate)
            auto.account_for_periods(estimate, flight.sent_actuators, periods, int(c[C_LAST_DUE_TICK]), truth.tick, ran)
        elif periods:
            auto.account_for_periods(None, flight.sent_actuators, periods, int(c[C_LAST_DUE_TICK]), truth.tick, ran)
        self._record_rows(rows - last, rows)
        plant.count_periods(int(c[C_WIND_SAMPLES]))
        if not whole:
            flight.finish_period(self._acting[0].copy())

    def _record_rows(self, first: int, stop: int) -> None:
        """Append log rows of this call to the recording."""
        if stop <= first:
            return
        flight, row = self._flight, self._log_rows[first:stop]
        state, attitude = row[:, ROW_STATE:ROW_ATT], row[:, ROW_ATT:ROW_WIND]
        measured: dict[str, _Array] = {}
        if flight.records_measurements:
            measured = {
                "measured_position": state[:, POSITION], "measured_velocity": state[:, VELOCITY],
                "measured_attitude": attitude, "measured_rates": state[:, RATES], "range": row[:, LOG_ROW_SIZE:],
            }  # fmt: skip
        truth = Truth(
            row[:, ROW_TIME], 0, state, attitude, row[:, ROW_WIND:ROW_SUPPLY], *row[:, ROW_SUPPLY:ROW_MOTORS].T,  # type: ignore[arg-type]
        )  # fmt: skip
        states = [_STATE_NAMES[k] for k in row[:, ROW_MISSION].astype(int).tolist()]
        append_rows(
            flight.recorder, truth, measured, Actuators(row[:, ROW_MOTORS:ROW_SERVOS], row[:, ROW_SERVOS:ROW_REF_POS]),
            (row[:, ROW_REF_POS:ROW_REF_VEL], row[:, ROW_REF_VEL:ROW_REF_ATT], row[:, ROW_REF_ATT:ROW_MISSION]), states,
        )  # fmt: skip


_STATE_NAMES = tuple(str(s) for s in State)


def _next_sample_time(sensor: FaultySensor, time_s: float) -> float:
    """Return the next sampling time of a sensor that was sampled at a time (s)."""
    wakes = sensor.sensor.next_sample_s if isinstance(sensor.sensor, PeriodicSensor) else -math.inf
    for fault in sensor.faults:
        if fault.start_s > time_s:
            wakes = min(wakes, fault.start_s)
        elif time_s < fault.stop_s:
            return -math.inf
    return wakes
