"""Many periods of a simulated flight in one compiled call: plant, inertial unit, filter and flight software.

The loop itself (:mod:`mufly.firmware.quick.loop`) is compiled by Numba. It calls the functions that a flight calls
period by period: those of the plant (:mod:`mufly.flight.plant`), of the inertial unit (:mod:`mufly.sensors.imu`) and
of all other sensors (:mod:`mufly.sensors.together`) as they stand, filter and flight software in C by their addresses.
Nothing is computed by another formula here, so that a flight is the same either way to the last bit
(``tests/firmware/test_many.py``).

It comes back to Python where something is due that Python does: a sensor with a fault measures (:data:`SENSE`), the
filter thinks otherwise of a sensor (:data:`TELL`), the log has a new line or the motors change (:data:`SAID`),
something is touched (:data:`TOUCHED`), somebody listens to what is true (:data:`HEARD`); and it goes on in the middle
of the period. Who listens to estimates hears of them at the end of a call. Commands, faults of the inertial unit, a
crash: all else is done period by period (:meth:`Flight.tick`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.state import MOTORS, POSITION, RATES, RS_ATT, SERVOS, VELOCITY
from mufly.estimate import Estimate, IdealEstimator
from mufly.estimate.fitted import SHOWN, KalmanEstimator
from mufly.estimate.layout import EX_GYRO_BIAS, SENSORS, SX_ATT
from mufly.estimate.output_predictor import TOLD_EVERY
from mufly.firmware.quick.loop import (
    ADVANCE,
    BROKEN,
    C_ARMED,
    C_BEAMS,
    C_BLOWN,
    C_CALM,
    C_DREW,
    C_DUE,
    C_EVERY,
    C_HEARD,
    C_HEARD_ROWS,
    C_LISTEN,
    C_LOOK,
    C_LOOKED,
    C_PERIODS,
    C_PHASE,
    C_RING,
    C_ROWS,
    C_STEPS,
    C_STOP,
    C_TELLS,
    C_TICK,
    C_TOLD_ROWS,
    C_UNTIL_VALID,
    C_VALID,
    COMPONENT_AT,
    COUNTS,
    DEVIATIONS,
    F_ASK_S,
    F_BLEND,
    F_CURRENT_A,
    F_DRAWN_S,
    F_HOVER_A,
    F_RADIUS,
    F_RATE,
    F_STEP_S,
    F_WAKE_S,
    HEARD,
    HEARD_ANGLES,
    HEARD_ATT,
    HEARD_OUT,
    HEARD_RATES,
    HEARD_STATE,
    HEARD_SUPPLY,
    HEARD_TICK,
    HEARD_TOLD,
    HEARD_VALID,
    HEARD_VOLTS,
    HEARD_WIDE,
    HEARD_WIND,
    MOST,
    NUMBERS,
    OF_SENSORS,
    PERIOD_AT,
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
    ROW_WIDE,
    ROW_WIND,
    SENSE,
    SENSOR_WIDE,
    SHOWN_WIDE,
    TELL,
    TOUCHED,
    go_on,
)
from mufly.flight.controllers import Actuators
from mufly.flight.flight import Flight
from mufly.flight.plant import append_rows
from mufly.mission import State
from mufly.sensors import FittedSensors, Imu, Readings, Sensors, Truth
from mufly.sensors.faults import Faulty
from mufly.sensors.periodic import SAID as TIMES_SAID
from mufly.sensors.periodic import Periodic
from mufly.sensors.readings import IdealRing
from mufly.sensors.together import ASKED, asked_of

_Array = NDArray[np.float64]


def _shown(row: _Array) -> dict[str, Any]:
    """What stands in such a row, by the names of the memory."""
    of = row[OF_SENSORS:COMPONENT_AT].reshape(SENSORS, SENSOR_WIDE)
    parts = (
        row[:DEVIATIONS].reshape(EX_GYRO_BIAS, EX_GYRO_BIAS),
        row[DEVIATIONS:OF_SENSORS],
        *of.T,
        row[COMPONENT_AT],
        row[PERIOD_AT],
    )
    return dict(zip(SHOWN, parts, strict=True))


class Many:
    """The compiled loop of one flight with the exported flight software.

    Parameters
    ----------
    flight : Flight
        With :class:`mufly.firmware.FirmwareSoftware`.
    """

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        software: Any = flight.autopilot.software
        self._software, self._board = software, software.board
        plant, sensors = flight.plant, flight.sensors
        self._filter: KalmanEstimator | None = None
        self._ring: IdealRing | None = None
        self._faulty: tuple[Faulty, ...] = ()
        self._places: dict[int, Faulty] = {}
        self._taken = self._pictures = np.zeros(0)
        self._asked: Any = None
        self._imu_in: Any = None
        self._imu: Any = None
        self.can = flight.records_truth and self._knows(flight, sensors)
        if not self.can:
            return
        ffi, lib, board = software.firmware.ffi, software.firmware.lib, self._board
        kept = [np.frombuffer(ffi.buffer(p), dtype=np.uint8) for p in (board.c, board.belief)]
        self._views = tuple((raw.view(np.float64), raw.view(np.int32), raw) for raw in kept)
        self._out = np.frombuffer(ffi.buffer(board.out), dtype=np.float64)
        offset = ffi.offsetof
        c, b = "software_t", "belief_t"
        self._at = np.array([
            offset(b, "time_s") // 8, offset(b, "motion") // 8, offset(b, "valid"), offset(c, "motors") // 4,
            offset(c, "late_s") // 8, offset(c, "mission", "logged") // 4, offset(c, "mission", "finished"),
            offset(c, "mission", "state") // 4, offset(c, "reference", "path", "position") // 8,
            offset(c, "reference", "path", "velocity") // 8, offset(c, "reference", "heading") // 8,
            offset(c, "reference", "heading_rate") // 8, offset(c, "tilt") // 8, offset(b, "ranges") // 8,
            offset(b, "position_variance") // 8, offset(b, "attitude_variance") // 8,
            offset(b, "checks") // 4, ffi.sizeof("check_t") // 4, offset("check_t", "status") // 4,
            offset("check_t", "why") // 4,
        ])  # fmt: skip
        place = [
            int(ffi.cast("uintptr_t", p))
            for p in (board.setup, board.c, board.belief, board.command, board.out)
        ]
        call = int(ffi.cast("uintptr_t", ffi.addressof(lib, "software_step")))
        addresses = [call, *place]
        self._filtered: Any = None
        if self._filter is not None:
            m, row = self._filter.memory, self._filter.row
            beams = flight.vehicle.range_ring.count
            fitted = np.zeros(SENSORS, np.uint8)
            fitted[list(self._filter.fitted.values())] = 1
            self._taken, self._pictures = np.zeros(SENSORS), np.zeros((3, beams))
            of_memory = tuple(m[name] for name in SHOWN[:-2])
            self._filtered = (
                m["x_output"], m["rates_output"], m["angles_output"], *row, fitted, self._taken, self._pictures,
                self._filter.beams.astype(np.int64), (*of_memory, *(self._filter.box[name] for name in SHOWN[-2:])),
                board.told_of_sensors(),
            )  # fmt: skip
            self._asked = asked_of({k: one.sensor for k, one in self._places.items()})
            step, *held = self._filter.steps.place
            addresses += [step, self._filter.box.ctypes.data, *held, *(a.ctypes.data for a in row)]
        self._to = np.array(addresses, dtype=np.int64)
        legs, radius, obstacles, *tables = plant.body
        self._packed = (legs, obstacles, *tables)
        self._beams = np.zeros(flight.vehicle.range_ring.count)
        self._log = np.empty((MOST, ROW_WIDE + self._beams.size))
        self._acting = np.zeros((3, 4))
        self._was, self._read = np.zeros(plant.state.size), np.zeros((2, 6))
        self._shown = np.zeros((2 + MOST // TOLD_EVERY + 1, SHOWN_WIDE))
        self._heard = np.zeros((MOST + 1, HEARD_WIDE + self._beams.size))
        self._c, self._f = np.zeros(COUNTS, np.int64), np.zeros(NUMBERS)
        self._c[[C_RING, C_LOOK, C_EVERY, C_STEPS, C_BEAMS]] = (
            0 if self._ring is None else self._ring.every, flight.look, flight.every, plant.steps,
            min(self._beams.size, board.beams),
        )  # fmt: skip
        self._f[[F_RATE, F_STEP_S, F_RADIUS, F_HOVER_A, F_BLEND]] = (
            plant.rate_Hz, plant.step_s, radius, flight.autopilot.hover_A, flight.blend,
        )  # fmt: skip
        self._hears, self._start = 0, 0
        self._thought: Any = None
        self._wakes = [math.inf] * len(self._faulty)
        self._said: list[Any] = [None] * len(self._faulty)
        self._seen: Any = None

    def _knows(self, flight: Flight, sensors: Sensors) -> bool:
        """Whether sensors and estimator are those that the loop can do, which are then kept."""
        if isinstance(flight.estimator, KalmanEstimator) and isinstance(sensors, FittedSensors):
            self._filter = flight.estimator
            all_of_them = [s for s in sensors.sensors if isinstance(s, Faulty)]
            self._faulty = tuple(s for s in all_of_them if isinstance(s.sensor, Periodic))
            self._places = {
                k: s for k, kind in enumerate(ASKED) for s in self._faulty if type(s.sensor) is kind
            }
            rest = [s for s in all_of_them if not isinstance(s.sensor, Periodic)]
            if len(rest) == 1 and isinstance(rest[0].sensor, Imu):
                self._imu_in, self._imu = rest[0], rest[0].sensor
            return self._imu is not None and self._filter.steps.name == "C"
        self._ring = next((s for s in sensors.sensors if isinstance(s, IdealRing)), None)
        return (
            type(flight.estimator) is IdealEstimator and len(sensors.sensors) == 3 and self._ring is not None
        )

    def run(self, until: int, *, until_valid: bool = False) -> bool:
        """Advance up to period ``until``, or until something has happened; False if it has to be done singly."""
        flight, plant, auto = self._flight, self._flight.plant, self._flight.autopilot
        if not self.can:
            return False
        until = min(until, plant.ticks + MOST)
        if self._filter is not None:  # faults are Python's
            ahead = [f.start_s for one in (self._imu_in, *self._faulty) for f in one.faults]
            until = min([
                until,
                *(math.floor(min(s, 1e9) * plant.rate_Hz) - 1 for s in ahead if s > plant.time_s),
            ])  # fmt: skip
        if until - plant.ticks < 2 or not self._steady():
            return False
        board, c, f = self._board, self._c, self._f
        board.settle(self._software.law)
        wind = plant.air_ahead(until - plant.ticks)
        c[[C_PHASE, C_TICK, C_STOP, C_BLOWN, C_ARMED, C_UNTIL_VALID, C_PERIODS, C_ROWS, C_DUE, C_DREW]] = (
            ADVANCE, plant.ticks, until, 0, auto.armed, until_valid, 0, 0, -1, 0,
        )  # fmt: skip
        c[C_LISTEN], c[C_HEARD], c[C_LOOKED] = flight.listened_every, plant.ticks, -1
        c[[C_TOLD_ROWS, C_HEARD_ROWS]] = 0
        f[F_CURRENT_A] = flight.current_A
        self._acting[1], self._acting[2] = flight.acting.array, flight.sent.array
        imu: Any = None
        self._start = plant.ticks
        self._state, ran = str(self._software.state), self._software.motors != "off"
        f[F_WAKE_S] = math.inf
        self._latest = dict(flight.readings.latest)
        imu = asked = ring = None
        if self._filter is not None:
            c[C_TELLS], f[F_DRAWN_S] = self._filter.periods, plant.time_s
            normal = np.empty(6 + 6 * self._imu.samples(flight.period_s))
            imu = (self._was, self._imu.source, normal, self._read[0], self._read[1], self._imu.parts)
            asked = self._lend()
        elif self._ring is not None:
            ring = self._ring.parts
            self._beams[:] = self._latest["ranges"].value
        self._hears = 0
        while True:
            why = go_on(
                c, f, plant.state, plant.box, wind, plant.supply, plant.attitude, self._packed, self._acting,
                *self._views, self._out, self._at, self._to, self._log, self._beams, ring,
                self._filtered, imu, asked, self._shown, self._heard,
            )  # fmt: skip
            if why == SENSE:
                self._sense()
            elif why == TELL:
                assert self._filter is not None
                self._hear(int(c[C_PERIODS]))
                told = int(c[C_TELLS]) - self._filter.periods
                self._listened()
                self._returned()
                board.believe(self._filter.told(int(c[C_TICK]) / plant.rate_Hz, bool(c[C_VALID]), told))
                self._tells = int(c[C_TOLD_ROWS])
                c[C_CALM] = auto.untroubled(self._filter.checks)
            elif why == HEARD:
                self._looked()
                truth = replace(self._truth(), wind=wind[int(c[C_BLOWN]) - 1].copy())
                flight.listen(truth, self._read_at(truth)[1])
            else:
                break
        self._end(why, wind, ran)
        return True

    def _steady(self) -> bool:
        """Whether nothing is asked for and nothing is wrong."""
        flight, auto = self._flight, self._flight.autopilot
        motors, now = self._software.motors, flight.plant.time_s
        return (
            not flight.plant.crashed
            and not flight.fresh
            and self._software.law.settled
            and not auto.asked
            and (motors != "off" or not auto.armed)
            and (self._imu_in is None or not any(t.start_s <= now < t.stop_s for t in self._imu_in.faults))
        )

    def _truth(self) -> Truth:
        plant = self._flight.plant
        tick = int(self._c[C_TICK])
        return Truth(
            tick / plant.rate_Hz, tick, plant.state.copy(), plant.attitude.copy(), plant.wind,
            float(plant.supply[0]), float(plant.supply[1]),
        )  # fmt: skip

    def _sense(self) -> None:
        """Let the sensors measure that Python asks, and whose time has come."""
        truth = self._truth()
        t = truth.time_s
        assert self._filter is not None
        for k, sensor in enumerate(self._faulty):
            if self._wakes[k] <= t:
                said = sensor.read(truth)
                self._wakes[k] = _wakes(sensor, t)
                if said is not self._said[k]:  # else nothing has come
                    self._said[k] = said
                    self._latest |= said
                    self._filter.hear(said, t)
        self._f[F_WAKE_S] = min(self._wakes, default=math.inf)
        if self._filter.ranges is not self._seen:
            self._seen = self._filter.ranges
            self._beams[:] = self._seen
            self._board.see(self._seen)

    def _lend(self) -> Any:
        """Let the loop ask those sensors of which nothing is wrong, and Python the others; return what it takes."""
        flight, filtered = self._flight, self._filter
        assert filtered is not None
        now = flight.plant.time_s
        quiet, asked, times = self._asked[0], [], []
        for k, one in self._places.items():
            lent = not any(t.start_s <= now < t.stop_s for t in one.faults)
            assert isinstance(one.sensor, Periodic)
            quiet[k] = one.sensor.quiet_s if lent else math.inf
            if lent:
                asked.append(one)
                times.append(int(one.sensor.counts[TIMES_SAID]))
        self._wakes = [math.inf if one in asked else _wakes(one, now) for one in self._faulty]
        self._said, self._seen = [None] * len(self._faulty), filtered.ranges  # others may have asked since
        self._f[F_WAKE_S] = min(self._wakes, default=math.inf)
        self._f[F_ASK_S] = -math.inf
        filtered.lend(self._taken, self._pictures, self._beams)
        self._times, self._lent = times, asked
        # Where others were told since, the row before is not what was told last.
        if self._thought is not filtered.checks:
            self._shown[0] = math.nan
        self._tells = 0
        self._c[C_CALM] = flight.autopilot.untroubled(filtered.checks)
        return self._asked

    def _returned(self) -> None:
        """Let sensors and filter know what the loop asked."""
        filtered = self._filter
        assert filtered is not None
        for k, one in enumerate(self._lent):
            sensor: Any = one.sensor
            if sensor.counts[TIMES_SAID] != self._times[k]:
                self._times[k], said = int(sensor.counts[TIMES_SAID]), sensor.said()
                one.went_on(said)
                self._latest |= said
                filtered.went_on(said, self._pictures, self._beams)

    def _listened(self) -> None:
        """Let who listens hear what was so, and take what was told last.

        Who has a method ``many`` hears of all instants at once: true and estimated position, velocity, attitude (n, 9)
        each, covariances (n, 9, 9), whether valid (n,).
        """
        flight, filtered, c = self._flight, self._filter, self._c
        assert filtered is not None
        rows, rate = self._heard[: c[C_HEARD_ROWS]], flight.plant.rate_Hz
        c[C_HEARD_ROWS] = 0
        together: Any = getattr(flight.listen, "many", None)
        if together is not None and len(rows):
            told, nine = rows[:, HEARD_TOLD].astype(int), EX_GYRO_BIAS
            covariances = self._shown[told, :DEVIATIONS].reshape(-1, nine, nine)
            covariances[told == 0] = filtered.covariance[:nine, :nine]
            moving = rows[:, HEARD_STATE : HEARD_STATE + RS_ATT]
            true = np.hstack([moving, rows[:, HEARD_ATT:HEARD_OUT]])
            moving = rows[:, HEARD_OUT : HEARD_OUT + SX_ATT]
            estimated = np.hstack([moving, rows[:, HEARD_ANGLES:HEARD_WIDE]])
            together(true, estimated, covariances, rows[:, HEARD_VALID] != 0.0)
            return
        for row in rows:
            self._tell_up_to(int(row[HEARD_TOLD]))
            tick = int(row[HEARD_TICK])
            truth = Truth(
                tick / rate, tick, row[HEARD_STATE:HEARD_ATT].copy(), row[HEARD_ATT:HEARD_OUT].copy(),
                row[HEARD_WIND:HEARD_SUPPLY].copy(), *row[HEARD_SUPPLY:HEARD_STATE].tolist(),
            )  # fmt: skip
            flight.listen(truth, filtered.said(
                truth.time_s, bool(row[HEARD_VALID]), row[HEARD_OUT:HEARD_RATES].copy(), row[HEARD_RATES:HEARD_ANGLES],
                row[HEARD_ANGLES:HEARD_WIDE], float(row[HEARD_VOLTS]), row[HEARD_WIDE:].copy(),
            ))  # fmt: skip

    def _tell_up_to(self, rows: int) -> None:
        """Let the filter tell what stands in the rows up to one, where it does not yet."""
        if rows > self._tells:
            assert self._filter is not None
            self._filter.show(_shown(self._shown[rows].copy()))
            self._tells = rows

    def _looked(self) -> None:
        """Let the ring without errors know what it saw last."""
        if self._ring is not None and self._c[C_LOOKED] >= 0:
            looked_s = int(self._c[C_LOOKED]) / self._flight.plant.rate_Hz
            self._ring.went_on(self._beams, looked_s)

    def _hear(self, periods: int, last: str = "") -> None:
        """Let the autopilot hear what was thought of the sensors until then; ``last``: state of the last period."""
        auto, filtered = self._flight.autopilot, self._filter
        if filtered is not None and not auto.untroubled(filtered.checks):
            for k in range(self._hears, periods):
                state = last if last and k == periods - 1 else self._state
                auto.hear(filtered.checks, (self._start + 1 + k) / self._flight.plant.rate_Hz, state)
        self._hears = periods

    def _read_at(self, truth: Truth) -> tuple[Readings, Estimate]:
        """What the sensors said last, and what is believed."""
        flight, filtered, c = self._flight, self._filter, self._c
        if filtered is None:
            readings = flight.sensors.read(truth)
            return readings, flight.estimator.update(readings)
        estimate = filtered.told(truth.time_s, bool(c[C_VALID]), int(c[C_TELLS]) - filtered.periods)
        return Readings(truth.time_s, self._latest), estimate

    def _end(self, why: int, wind: _Array, ran: bool) -> None:
        """Let the rest of the simulation know how it stands."""
        flight, plant, auto = self._flight, self._flight.plant, self._flight.autopilot
        software, c, filtered = self._software, self._c, self._filter
        plant.blew(wind[int(c[C_BLOWN]) - 1], int(c[C_BLOWN]))
        truth = self._truth()
        self._looked()
        if filtered is not None:
            self._returned()
        if filtered is not None and c[C_DREW]:
            sensed = truth if why not in (TOUCHED, BROKEN) else replace(
                truth, time_s=float(self._f[F_DRAWN_S]), state=self._was
            )  # fmt: skip
            said = self._imu.went_on(sensed, *self._read)
            self._imu_in.went_on(said)
            self._latest |= said
        flight.current_A = float(self._f[F_CURRENT_A])
        self._board.listen()
        software.tell()
        periods, rows = int(c[C_PERIODS]), int(c[C_ROWS])
        whole = why not in (TOUCHED, BROKEN)
        last = int(whole and truth.tick % flight.every == 0)
        if filtered is not None:
            self._listened()
            self._hear(periods, str(software.state))
            self._tell_up_to(int(c[C_TOLD_ROWS]))
        self._record(0, rows - last)
        if filtered is not None or whole:
            readings, estimate = self._read_at(truth)
        if filtered is not None:
            self._shown[0], self._thought = self._shown[c[C_TOLD_ROWS]], filtered.checks
        flight.acting = Actuators(self._acting[1, MOTORS].copy(), self._acting[1, SERVOS].copy())
        flight.sent = Actuators(self._acting[2, MOTORS].copy(), self._acting[2, SERVOS].copy())
        if whole:
            flight.take(truth, readings, estimate)
            auto.went_on(estimate, flight.sent, periods, int(c[C_DUE]), truth.tick, ran)
        elif periods:
            auto.went_on(None, flight.sent, periods, int(c[C_DUE]), truth.tick, ran)
        self._record(rows - last, rows)
        plant.passed(int(c[C_BLOWN]))
        if not whole:
            flight.rest_of_period(self._acting[0].copy())

    def _record(self, first: int, stop: int) -> None:
        """Append rows of this run to the recording."""
        if stop <= first:
            return
        flight, row = self._flight, self._log[first:stop]
        state, attitude = row[:, ROW_STATE:ROW_ATT], row[:, ROW_ATT:ROW_WIND]
        measured: dict[str, _Array] = {}
        if flight.records_measured:
            measured = {
                "measured_position": state[:, POSITION], "measured_velocity": state[:, VELOCITY],
                "measured_attitude": attitude, "measured_rates": state[:, RATES], "range": row[:, ROW_WIDE:],
            }  # fmt: skip
        truth = Truth(
            row[:, ROW_TIME], 0, state, attitude, row[:, ROW_WIND:ROW_SUPPLY], *row[:, ROW_SUPPLY:ROW_MOTORS].T,  # type: ignore[arg-type]
        )  # fmt: skip
        states = [_STATES[k] for k in row[:, ROW_MISSION].astype(int).tolist()]
        append_rows(
            flight.recorder, truth, measured, Actuators(row[:, ROW_MOTORS:ROW_SERVOS], row[:, ROW_SERVOS:ROW_REF_POS]),
            (row[:, ROW_REF_POS:ROW_REF_VEL], row[:, ROW_REF_VEL:ROW_REF_ATT], row[:, ROW_REF_ATT:ROW_MISSION]), states,
        )  # fmt: skip


_STATES = tuple(str(s) for s in State)


def _wakes(sensor: Faulty, time_s: float) -> float:
    """When a sensor that was asked at a time has to be asked again (s)."""
    wakes = sensor.sensor.quiet_s if isinstance(sensor.sensor, Periodic) else -math.inf
    for fault in sensor.faults:
        if fault.start_s > time_s:
            wakes = min(wakes, fault.start_s)
        elif time_s < fault.stop_s:
            return -math.inf
    return wakes
