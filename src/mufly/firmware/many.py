"""Many periods of a simulated flight in one compiled call: plant, inertial unit, filter and flight software.

The loop itself is compiled by Numba. It calls the functions that a flight calls period by period: those of the plant
(:mod:`mufly.flight.plant`) and of the inertial unit (:mod:`mufly.sensors.imu`) as they stand, filter and flight
software in C by their addresses. Nothing is computed by another formula here, so that a flight is the same either
way to the last bit (``tests/firmware/test_many.py``).

It comes back to Python where something is due that Python does: a sensor other than the inertial unit measures
(:data:`SENSE`), the filter tells its covariance and what it thinks of its sensors (:data:`TELL`), the log has a new
line or the motors change (:data:`SAID`), something is touched (:data:`TOUCHED`), somebody listens (:data:`HEARD`); and
it goes on in the middle of the period. Commands, faults of the inertial unit, a crash: all else is done period by
period (:meth:`Flight.tick`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.estimate import Estimate, IdealEstimator
from mufly.estimate.fitted import KalmanEstimator
from mufly.estimate.guards import ACTING, CLIPPING
from mufly.estimate.kernel import TOLD_EVERY
from mufly.estimate.layout import R_ACCELERATION, R_BATTERY, R_RATES, STARTS
from mufly.flight.controllers import Actuators
from mufly.flight.flight import Flight
from mufly.flight.plant import append_rows, plant_period, touched, true_attitude
from mufly.mission import State
from mufly.sensors import FittedSensors, Imu, Readings, Sensors, Truth
from mufly.sensors.faults import Faulty
from mufly.sensors.imu import imu_period
from mufly.sensors.readings import IdealRing, Periodic

_Array = NDArray[np.float64]

MOST = 256
"""Periods of one call at most."""

# Why the loop came back
DONE, SENSE, TELL, SAID, TOUCHED, BROKEN, VALID, HEARD = range(8)
# Where it goes on in a period
_ADVANCE, _SENSED, _TOLD = range(3)
# Whole numbers that it keeps
(
    _PHASE, _TICK, _STOP, _BLOWN, _RING, _LOOK, _EVERY, _ARMED, _VALID, _UNTIL_VALID, _TELLS, _PERIODS, _ROWS, _DUE,
    _DREW, _STEPS, _LISTEN, _HEARD,
) = range(18)  # fmt: skip
# Numbers that it keeps
_RATE, _STEP_S, _RADIUS, _HOVER_A, _CURRENT_A, _BLEND, _WAKE_S, _DRAWN_S = range(8)
# Where things lie in the records of C, in units of eight, four or one byte
(
    _B_TIME, _B_MOTION, _B_VALID, _S_MOTORS, _S_LATE, _S_LOGGED, _S_FINISHED, _S_STATE, _S_POSITION, _S_VELOCITY,
    _S_HEADING, _S_TURN, _S_TILT,
) = range(13)  # fmt: skip
_MOTORS_OFF, _MOTORS_FLY = 0, 2
# Columns of what is kept of a period: time, state (21), attitude, wind, battery, what acts, reference (9), mission;
# beams follow
_WIDE = 44
_ACC, _RATE_AT, _VOLT = STARTS[R_ACCELERATION], STARTS[R_RATES], STARTS[R_BATTERY]


def _by_address(context: Any, address: Any, arguments: Any) -> Any:
    """Call the C function at an address with pointers; returns the lowest byte of what it returns."""
    count = len(arguments)

    def make(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(8), [word] * count)
        pointers = [builder.extract_value(given[1], k) for k in range(count)]
        return builder.call(builder.inttoptr(given[0], kind.as_pointer()), pointers)

    return types.int8(address, arguments), make


_call: Any = intrinsic(_by_address)


@compiled(error_model="numpy")
def _go_on(  # type: ignore[no-untyped-def]
    c, f, x, parameters, wind, supply, attitude, packed, acting, software, belief, out, at, to, log, seen, filtered,
    imu,
):  # fmt: skip
    """Advance until something is due that Python does; return what.

    Parameters
    ----------
    c, f : int64 and float64 arrays
        Counts and numbers, by the names above.
    x, parameters, wind, supply, attitude
        Of the plant; ``wind`` (n, 3) of the periods to come.
    packed : tuple
        Legs, whether there are obstacles, and the tables of the world.
    acting : (3, 4) array
        What acted in the last period, acts now, was sent last.
    software, belief : tuples of float64, int32 and uint8 arrays
        Views of the records of C.
    out : (4,) array
        What the software wants.
    at : int64 array
        Where things lie in those records.
    to : int64 array
        Addresses: software_step and its five arguments, estimator_step and its six.
    log : (n, columns) array
        A row for every recorded period.
    seen : (n,) array
        Beams of the ring, to be recorded.
    filtered : None, or tuple of arrays
        What the filter tells (state, rates, angles), and its readings, which are new, and their ages.
    imu : None, or tuple
        State before; normal numbers (n, m), how warm it is (n,), samples, what it reads and how often it clipped
        (6,), and the rest of what ``imu_period`` takes.
    """
    sd, si, sb = software
    bd, _, bb = belief
    now = at[_B_MOTION]
    while True:
        if c[_PHASE] == _ADVANCE:
            if c[_TICK] >= c[_STOP] or c[_BLOWN] >= wind.shape[0] or c[_ROWS] >= log.shape[0]:
                return DONE
            if imu is not None and c[_DREW] >= imu[1].shape[0]:
                return DONE
            if c[_LISTEN] > 0 and c[_TICK] % c[_LISTEN] == 0 and c[_TICK] != c[_HEARD]:
                c[_HEARD] = c[_TICK]
                return HEARD
            if imu is not None:
                imu[0][:] = x
            plant_period(x, acting[1], wind[c[_BLOWN]], parameters, f[_STEP_S], c[_STEPS], supply)
            c[_BLOWN] += 1
            c[_TICK] += 1
            acting[0, :] = acting[1]
            acting[1, :] = acting[2]
            if not math.isfinite(x[2]):
                return BROKEN
            t = c[_TICK] / f[_RATE]
            if c[_TICK] % c[_LOOK] == 0:
                if touched(x, parameters, packed[0], f[_RADIUS], packed[1], packed[2], packed[3], packed[4]):
                    return TOUCHED
                drawn = supply[1] if si[at[_S_MOTORS]] == _MOTORS_FLY else f[_HOVER_A]
                f[_CURRENT_A] += f[_BLEND] * (drawn - f[_CURRENT_A])
            true_attitude(x, attitude)
            c[_PHASE] = _SENSED
            if filtered is not None:
                z, new, age = filtered[3], filtered[4], filtered[5]
                new[:] = 0
                for k in range(4):
                    z[ACTING + k] = acting[0, k]
                if imu is not None:
                    n = c[_DREW]
                    c[_DREW] += 1
                    imu_period(
                        imu[0], x, t - f[_DRAWN_S], imu[3], imu[2][n], imu[1][n], *imu[6], imu[4], imu[5]
                    )
                    f[_DRAWN_S] = t
                    for k in range(3):
                        z[_ACC + k], z[_RATE_AT + k], z[CLIPPING + k] = imu[4][k], imu[4][3 + k], imu[5][k]
                    new[R_ACCELERATION] = new[R_RATES] = 1
                    age[R_ACCELERATION] = age[R_RATES] = 0.0
            if t >= f[_WAKE_S] or (c[_RING] > 0 and c[_TICK] % c[_RING] == 0):
                return SENSE
        t = c[_TICK] / f[_RATE]
        if c[_PHASE] == _SENSED:
            bd[at[_B_TIME]] = t
            if filtered is None:
                for k in range(3):
                    bd[now + k], bd[now + 3 + k] = x[k], x[3 + k]
                    bd[now + 6 + k], bd[now + 9 + k] = attitude[k], x[10 + k]
                bd[now + 12] = supply[0]
            else:
                valid = _call(to[6], (to[7], to[8], to[9], to[10], to[11], to[12])) & 1
                told, rates, angles = filtered[0], filtered[1], filtered[2]
                for k in range(3):
                    bd[now + k], bd[now + 3 + k] = told[k], told[3 + k]
                    bd[now + 6 + k], bd[now + 9 + k] = angles[k], rates[k]
                volts = filtered[3][_VOLT]
                bd[now + 12] = volts if volts != 0.0 else math.nan
                bb[at[_B_VALID]] = c[_VALID] = valid
                c[_TELLS] += 1
            c[_PHASE] = _TOLD
            if filtered is not None and c[_TELLS] % TOLD_EVERY == 0:
                return TELL
        logged, motors, finished = si[at[_S_LOGGED]], si[at[_S_MOTORS]], sb[at[_S_FINISHED]]
        _call(to[0], (to[1], to[2], to[3], to[4], to[5]))
        runs = c[_ARMED] > 0 or si[at[_S_MOTORS]] == _MOTORS_OFF
        for k in range(4):
            acting[2, k] = out[k] if runs else 0.0
        late = sd[at[_S_LATE]]
        if late == 0.0:
            c[_DUE] = c[_TICK]
        c[_PERIODS] += 1
        if c[_TICK] % c[_EVERY] == 0:
            row = log[c[_ROWS]]
            c[_ROWS] += 1
            row[0] = t
            row[1:22] = x
            row[22:25] = attitude
            row[25:28] = wind[c[_BLOWN] - 1]
            row[28:30] = supply
            row[30:34] = acting[1]
            for k in range(3):
                way = sd[at[_S_VELOCITY] + k]
                row[34 + k] = sd[at[_S_POSITION] + k] + late * way
                row[37 + k] = way
            row[40], row[41] = sd[at[_S_TILT]], sd[at[_S_TILT] + 1]
            row[42] = sd[at[_S_HEADING]] + late * sd[at[_S_TURN]]
            row[43] = si[at[_S_STATE]]
            row[_WIDE:] = seen
        c[_PHASE] = _ADVANCE
        if si[at[_S_LOGGED]] != logged or si[at[_S_MOTORS]] != motors or sb[at[_S_FINISHED]] != finished:
            return SAID
        if c[_UNTIL_VALID] > 0 and c[_VALID] > 0:
            return VALID


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
            offset(c, "reference", "heading_rate") // 8, offset(c, "tilt") // 8,
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
            self._filtered = (m["out"], m["out_rates"], m["angles"], *row)
            step, *held = self._filter.steps.place
            addresses += [step, self._filter.box.ctypes.data, *held, *(a.ctypes.data for a in row)]
        self._to = np.array(addresses, dtype=np.int64)
        legs, radius, obstacles, *tables = plant.body
        self._packed = (legs, obstacles, *tables)
        self._beams = np.zeros(flight.vehicle.range_ring.count)
        self._log = np.empty((MOST, _WIDE + self._beams.size))
        self._acting = np.zeros((3, 4))
        self._was, self._read = np.zeros(plant.state.size), np.zeros((2, 6))
        self._c, self._f = np.zeros(18, np.int64), np.zeros(8)
        self._c[[_RING, _LOOK, _EVERY, _STEPS]] = (
            0 if self._ring is None else self._ring.every, flight.look, flight.every, plant.steps,
        )  # fmt: skip
        self._f[[_RATE, _STEP_S, _RADIUS, _HOVER_A, _BLEND]] = (
            plant.rate_Hz, plant.step_s, radius, flight.autopilot.hover_A, flight.blend,
        )  # fmt: skip
        self._heard, self._start = 0, 0
        self._wakes = [math.inf] * len(self._faulty)
        self._said: list[Any] = [None] * len(self._faulty)
        self._seen: Any = None

    def _knows(self, flight: Flight, sensors: Sensors) -> bool:
        """Whether sensors and estimator are those that the loop can do, which are then kept."""
        if isinstance(flight.estimator, KalmanEstimator) and isinstance(sensors, FittedSensors):
            self._filter = flight.estimator
            all_of_them = [s for s in sensors.sensors if isinstance(s, Faulty)]
            self._faulty = tuple(s for s in all_of_them if isinstance(s.sensor, Periodic))
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
        if self._imu_in is not None:  # its faults are Python's
            ahead = [t.start_s for t in self._imu_in.faults if t.start_s > plant.time_s]
            until = min([until, *(math.floor(min(start, 1e9) * plant.rate_Hz) - 1 for start in ahead)])
        if until - plant.ticks < 2 or not self._steady():
            return False
        board, c, f = self._board, self._c, self._f
        board.settle(self._software.law)
        wind = plant.air_ahead(until - plant.ticks)
        c[[_PHASE, _TICK, _STOP, _BLOWN, _ARMED, _UNTIL_VALID, _PERIODS, _ROWS, _DUE, _DREW]] = (
            _ADVANCE, plant.ticks, until, 0, auto.armed, until_valid, 0, 0, -1, 0,
        )  # fmt: skip
        c[_LISTEN], c[_HEARD] = flight.listened_every, plant.ticks
        f[_CURRENT_A] = flight.current_A
        self._acting[1], self._acting[2] = flight.acting.array, flight.sent.array
        imu: Any = None
        self._start = ticks = plant.ticks
        self._state, ran = str(self._software.state), self._software.motors != "off"
        f[_WAKE_S] = math.inf
        self._latest = dict(flight.readings.latest)
        if self._filter is not None:
            c[_TELLS] = self._filter.periods
            samples = self._imu.samples(flight.period_s)
            normals = self._imu.normals(samples)
            warmth = np.array(
                [self._imu.warmth((ticks + 1 + k) / plant.rate_Hz) for k in range(len(normals))]
            )
            imu = (
                self._was, normals, warmth, samples, self._read[0], self._read[1], self._imu.parts,
            )  # fmt: skip
            f[_DRAWN_S] = plant.time_s
            self._wakes = [_wakes(s, plant.time_s) for s in self._faulty]
            self._said, self._seen = [None] * len(self._faulty), None  # others may have asked since
            f[_WAKE_S] = min(self._wakes, default=math.inf)
        else:
            self._beams[:] = self._latest["ranges"].value
        self._heard = 0
        while True:
            why = _go_on(
                c, f, plant.state, plant.box, wind, plant.supply, plant.attitude, self._packed, self._acting,
                *self._views, self._out, self._at, self._to, self._log, self._beams, self._filtered, imu,
            )  # fmt: skip
            if why == SENSE:
                self._sense()
            elif why == TELL:
                assert self._filter is not None
                self._hear(int(c[_PERIODS]))
                told = int(c[_TELLS]) - self._filter.periods
                board.believe(self._filter.told(int(c[_TICK]) / plant.rate_Hz, bool(c[_VALID]), told))
            elif why == HEARD:
                truth = replace(self._truth(), wind=wind[int(c[_BLOWN]) - 1].copy())
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
        tick = int(self._c[_TICK])
        return Truth(
            tick / plant.rate_Hz, tick, plant.state.copy(), plant.attitude.copy(), plant.wind,
            float(plant.supply[0]), float(plant.supply[1]),
        )  # fmt: skip

    def _sense(self) -> None:
        """Let the sensors measure whose time has come."""
        truth = self._truth()
        t = truth.time_s
        if self._ring is not None:
            said = self._ring.read(truth)
            self._latest |= said
            self._board.see(said["ranges"].value)
            self._beams[:] = said["ranges"].value
            return
        assert self._filter is not None
        for k, sensor in enumerate(self._faulty):
            if self._wakes[k] <= t:
                said = sensor.read(truth)
                self._wakes[k] = _wakes(sensor, t)
                if said is not self._said[k]:  # else nothing has come
                    self._said[k] = said
                    self._latest |= said
                    self._filter.hear(said, t)
        self._f[_WAKE_S] = min(self._wakes, default=math.inf)
        if self._filter.ranges is not self._seen:
            self._seen = self._filter.ranges
            self._board.see(self._seen)

    def _hear(self, periods: int, last: str = "") -> None:
        """Let the autopilot hear what was thought of the sensors until then; ``last``: state of the last period."""
        auto, filtered = self._flight.autopilot, self._filter
        if filtered is not None and not auto.untroubled(filtered.checks):
            for k in range(self._heard, periods):
                state = last if last and k == periods - 1 else self._state
                auto.hear(filtered.checks, (self._start + 1 + k) / self._flight.plant.rate_Hz, state)
        self._heard = periods

    def _read_at(self, truth: Truth) -> tuple[Readings, Estimate]:
        """What the sensors said last, and what is believed."""
        flight, filtered, c = self._flight, self._filter, self._c
        if filtered is None:
            readings = flight.sensors.read(truth)
            return readings, flight.estimator.update(readings)
        estimate = filtered.told(truth.time_s, bool(c[_VALID]), int(c[_TELLS]) - filtered.periods)
        return Readings(truth.time_s, self._latest), estimate

    def _end(self, why: int, wind: _Array, ran: bool) -> None:
        """Let the rest of the simulation know how it stands."""
        flight, plant, auto = self._flight, self._flight.plant, self._flight.autopilot
        software, c, filtered = self._software, self._c, self._filter
        plant.blew(wind[int(c[_BLOWN]) - 1], int(c[_BLOWN]))
        truth = self._truth()
        if filtered is not None and c[_DREW]:
            self._imu.used(self._imu.samples(flight.period_s), int(c[_DREW]))
            sensed = truth if why not in (TOUCHED, BROKEN) else replace(
                truth, time_s=float(self._f[_DRAWN_S]), state=self._was
            )  # fmt: skip
            said = self._imu.went_on(sensed, *self._read)
            self._imu_in.went_on(said)
            self._latest |= said
        flight.current_A = float(self._f[_CURRENT_A])
        self._board.listen()
        software.tell()
        periods, rows = int(c[_PERIODS]), int(c[_ROWS])
        whole = why not in (TOUCHED, BROKEN)
        last = int(whole and truth.tick % flight.every == 0)
        self._record(0, rows - last)
        if filtered is not None or whole:
            readings, estimate = self._read_at(truth)
        self._hear(periods, str(software.state))
        flight.acting = Actuators(self._acting[1, :2].copy(), self._acting[1, 2:].copy())
        flight.sent = Actuators(self._acting[2, :2].copy(), self._acting[2, 2:].copy())
        if whole:
            flight.take(truth, readings, estimate)
            auto.went_on(estimate, flight.sent, periods, int(c[_DUE]), truth.tick, ran)
        elif periods:
            auto.went_on(None, flight.sent, periods, int(c[_DUE]), truth.tick, ran)
        self._record(rows - last, rows)
        plant.passed(int(c[_BLOWN]))
        if not whole:
            flight.rest_of_period(self._acting[0].copy())

    def _record(self, first: int, stop: int) -> None:
        """Append rows of this run to the recording."""
        if stop <= first:
            return
        flight, row = self._flight, self._log[first:stop]
        measured: dict[str, _Array] = {}
        if flight.records_measured:
            measured = {
                "measured_position": row[:, 1:4], "measured_velocity": row[:, 4:7], "measured_attitude": row[:, 22:25],
                "measured_rates": row[:, 11:14], "range": row[:, _WIDE:],
            }  # fmt: skip
        truth = Truth(row[:, 0], 0, row[:, 1:22], row[:, 22:25], row[:, 25:28], row[:, 28], row[:, 29])  # type: ignore[arg-type]
        states = [_STATES[k] for k in row[:, 43].astype(int).tolist()]
        append_rows(
            flight.recorder, truth, measured, Actuators(row[:, 30:32], row[:, 32:34]),
            (row[:, 34:37], row[:, 37:40], row[:, 40:43]), states,
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
