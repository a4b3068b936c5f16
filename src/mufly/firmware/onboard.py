"""The exported flight software on this machine: called through cffi, told and asked in the words of Python.

What goes in (an estimate, a command, a mission) becomes the records of the C headers; what comes out (state of the
mission, log, reference, actuators) becomes the objects that the rest of the simulation knows. A line of the log is a
template and numbers on board (:mod:`mufly.mission.words`); here it is made the text that Python would have written.
Texts that go in, the reason of a stop or what an estimator says of a sensor, are known on board by a number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from mufly.control import FlightController
from mufly.errors import MuflyError
from mufly.estimate import Check, Estimate
from mufly.estimate.beliefs import ODD, REASONS, reason
from mufly.estimate.layout import CHECKED, EX_ATT, EX_GYRO_BIAS, EX_POS, EX_VEL
from mufly.firmware.host import Firmware, FirmwareControllers
from mufly.firmware.plan import plan_numbers, plan_of, setup_numbers
from mufly.flight.controllers import Actuators
from mufly.flight.oscillation import INPUTS, Oscillation
from mufly.flight.software import FlightSoftware
from mufly.flight.trust import sensor_name, told
from mufly.logs.mcap import Event
from mufly.mission import NO_SIGNAL, Command, Mission, MissionPlan, MissionState, Reference, State, Words
from mufly.mission.avoidance import CAPACITY, Memory, Sight
from mufly.mission.detour import Detour
from mufly.mission.state import LOG_KEPT
from mufly.mission.trajectory import Point, Profile, SplinePath, Stop, Trajectory, Unmade
from mufly.vehicle import Vehicle

if TYPE_CHECKING:
    from cffi import FFI

_STATES = tuple(State)
_MOTORS: tuple[Any, ...] = ("off", "spin_up", "fly", "ramp_down", "blind")
_OUTCOMES: tuple[Any, ...] = ("", "succeeded", "failed")
_LEVELS = ("info", "warning", "error")
_STATUS = ("waiting", "fused", "rejected", "missing", "faulty")
_NOT_FITTED = len(_STATUS)
_VITAL = ("position", "velocity", "attitude", "rates")
_WORDS = tuple(Words)


class Told:
    """Texts that the board knows by a number."""

    def __init__(self) -> None:
        self._texts: list[str] = [""]
        self._places: dict[str, int] = {"": 0}

    def number(self, text: str) -> int:
        """Return the number of a text; 0 is that of none."""
        if text not in self._places:
            self._places[text] = len(self._texts)
            self._texts.append(text)
        return self._places[text]

    def text(self, number: int) -> str:
        """Return the text of a number."""
        return self._texts[number]


class Onboard:
    """One ``software_t`` with its plan, from Python.

    Parameters
    ----------
    firmware : Firmware
    controller : FlightController
    plan : MissionPlan
    """

    def __init__(self, firmware: Firmware, controller: FlightController, plan: MissionPlan) -> None:
        f = self.firmware = firmware
        self.told = Told()
        self.belief, self.command = f.ffi.new("belief_t *"), f.ffi.new("command_t *")
        self.out, self.c = f.ffi.new("actuators_t *"), f.ffi.new("software_t *")
        self._plan, self.setup = f.ffi.new("plan_t *"), f.ffi.new("setup_t *")
        for name, value in setup_numbers(controller).items():
            setattr(self.setup, name, value)
        self.setup.plan = self._plan
        self.setup.gains = self._gains = (
            f.gains(controller) if f.of_any else f.ffi.addressof(f.lib.mufly_gains)
        )
        self._asked: Command | None = None
        self.fly_by(plan)
        self.start()

    def start(self) -> None:
        """Before the first period."""
        self.firmware.lib.software_start(self.setup, self.c)
        self._events: tuple[Event, ...] = ()
        self._logged = 0

    def fly_by(self, plan: MissionPlan) -> None:
        """Take another mission's numbers."""
        ffi = self.firmware.ffi
        numbers = plan_numbers(plan)
        fresh = ffi.new("plan_t *", numbers)
        ffi.memmove(self._plan, fresh, ffi.sizeof("plan_t"))
        self._names = plan.mission.name

    def loaded(self, name: str) -> None:
        """Another mission has been loaded; it is flown when it is started."""
        self._names = name or "a mission"
        self.firmware.lib.mission_loaded(self._plan, self.firmware.ffi.addressof(self.c, "mission"))
        self.listen()

    def step(self, m: Estimate, command: Command) -> Actuators:
        """One period."""
        self.believe(m)
        self._ask(command)
        self.firmware.lib.software_step(self.setup, self.c, self.belief, self.command, self.out)
        self.listen()
        out = self.out
        return Actuators(np.array(list(out.motor_input)), np.array(list(out.servo_input)))

    # in

    def believe(self, m: Estimate) -> None:
        """Lay an estimate into the record."""
        b = self.belief
        b.time_s, b.valid = m.time_s, m.valid
        now = b.motion
        now.position, now.velocity = m.position.tolist(), m.velocity.tolist()
        now.attitude, now.rates, now.voltage = m.attitude.tolist(), m.rates.tolist(), m.battery_voltage
        self.see(m.ranges)
        b.judged = m.beliefs is not None
        if m.beliefs is None:
            return
        variance = m.covariance.diagonal().tolist()
        b.position_variance, b.attitude_variance = variance[EX_POS:EX_VEL], variance[EX_ATT:EX_GYRO_BIAS]
        for one in b.checks:
            one.status = _NOT_FITTED
        for check in m.beliefs.checks:
            one = b.checks[CHECKED.index(check.name)]
            one.status, one.why = _STATUS.index(check.status), self.told.number(check.reason)

    def see(self, ranges: NDArray[np.floating[Any]]) -> None:
        """Lay what the beams see into the record."""
        ring = self._plan.ring
        count = min(len(ranges), ring.count)
        self.belief.ranges[0 : ring.count] = [
            *ranges.tolist()[:count],
            *[ring.max_range] * (ring.count - count),
        ]

    def told_of_sensors(self) -> NDArray[np.int64]:
        """Return the number of each reason's text, by the reasons of :mod:`mufly.estimate.sensor_checks`.

        It is -1 where the text holds a number, or is to be reported.
        """
        words = [
            (reason(why, 1.0, 0), why not in ODD and reason(why, 1.0, 0) == reason(why, 2.0, 0))
            for why in range(REASONS)
        ]
        return np.array([self.told.number(text) if plain else -1 for text, plain in words])

    @property
    def beams(self) -> int:
        """How many the ring has."""
        return int(self._plan.ring.count)

    def settle(self, law: FirmwareControllers) -> None:
        """Take the numbers of the law and no command, for periods that others step through."""
        self.setup.gains = law.numbers()
        self._ask(NO_SIGNAL)

    def _ask(self, c: Command) -> None:
        if c is NO_SIGNAL and self._asked is NO_SIGNAL:
            return
        self._asked = c
        to = self.command
        to.start, to.pause, to.home, to.land, to.rc = c.start, c.pause, c.home, c.land, c.rc
        to.has_first, to.first = c.first is not None, c.first or 0
        to.has_take_off, to.take_off = c.take_off is not None, c.take_off or 0.0
        to.has_waypoint, to.waypoint = c.waypoint is not None, c.waypoint or (0.0, 0.0, 0.0)
        to.has_heading, to.heading = c.heading is not None, c.heading or 0.0
        to.stop = self.told.number(c.stop)
        to.roll, to.pitch, to.yaw_rate, to.climb = c.roll, c.pitch, c.yaw_rate, c.climb
        to.has_set_point = c.set_point is not None
        if c.set_point is not None:
            nan = (math.nan, math.nan, math.nan)
            p = c.set_point
            to.set_point.position, to.set_point.velocity = p.position_m or nan, p.velocity_m_s or nan
            to.set_point.heading = math.nan if p.heading_rad is None else p.heading_rad
            to.set_point.yaw_rate = math.nan if p.yaw_rate_rad_s is None else p.yaw_rate_rad_s

    # out

    def listen(self) -> None:
        """Read what has been logged since."""
        s = self.c.mission
        kept = len(s.log)
        if s.logged < self._logged:
            self._events, self._logged = (), 0
        for k in range(max(self._logged, s.logged - kept), s.logged):
            e = s.log[k % kept]
            self._events = (
                *self._events[1 - LOG_KEPT :],
                Event(e.time_s, str(_STATES[e.state]), self.text(e.message), _LEVELS[e.level]),
            )
        self._logged = s.logged

    def text(self, message: Any) -> str:
        """Return the words of a ``message_t``."""
        word, numbers = _WORDS[message.code], list(message.number)
        wrong = [
            Check(CHECKED[b.sensor], _STATUS[b.status], reason=self.told.text(b.why))  # type: ignore[arg-type]
            for b in message.because
            if b.sensor >= 0
        ]
        because = f" ({'; '.join(told(c) for c in wrong)})" if wrong else ""
        if word is Words.GIVEN:
            return told(wrong[0]) if wrong else self.told.text(int(numbers[0]))
        if word is Words.READY:
            return word(self._names)
        if word in (Words.LOADED, Words.LOADED_ONE):
            return word(self._names, numbers[0])
        if word is Words.LOST:
            names = [name for k, name in enumerate(_VITAL) if int(numbers[0]) >> k & 1]
            return word(" and ".join(names) or "all, which is frozen")
        if word is Words.CONTRADICTED:
            return word(" and ".join(sensor_name(c.name) for c in wrong))
        if word is Words.PLACE_WAITED:
            return word(numbers[0], because, numbers[1])
        return word(*numbers) + because

    @property
    def state(self) -> MissionState:
        """What the mission remembers."""
        s = self.c.mission
        return MissionState(
            state=_STATES[s.state], time_s=s.time_s, entered_s=s.entered_s, clock_s=s.clock_s, step_s=s.step_s,
            motors=_MOTORS[s.motors], index=s.index, outcome=_OUTCOMES[s.outcome], reason=self.text(s.reason),
            finished=s.finished, manual=s.manual, started=s.started, begun=s.begun, reached=s.reached,
            quit=self.text(s.quit), homing=s.homing, events=self._events, logged=self._logged,
            standing=tuple(s.standing), hold=tuple(s.hold), goal=tuple(s.goal), heading=s.heading,
            motion=_course(s.course), ready_s=s.ready_s, sink=s.sink, sink_rate=s.sink_rate, still_s=s.still_s,
            impact=s.impact, battery_V=s.voltage, low_s=s.low_s, memory=self._memory(s.memory),
            beam=s.beam, sight=_sight(s.sight),
            detour=_detour(s.detour) if s.has_detour else None, back=_STATES[s.back], avoided_s=s.avoided_s,
            resumed=s.resumed, swing=s.swing, asked_heading=s.asked_heading if s.has_asked_heading else None,
            tracker=_point(s.tracker) if s.has_tracker else None, halt=s.halt,
        )  # fmt: skip

    def _memory(self, m: FFI.CData) -> Memory:
        raw = np.frombuffer(self.firmware.ffi.buffer(m.points), dtype=self.firmware.real)
        return Memory(raw.reshape(CAPACITY, 4).astype(np.float64), m.used, m.turn)

    @property
    def reference(self) -> Reference:
        """What is followed."""
        r = self.c.reference
        p = r.path
        return Reference(
            np.array(list(p.position)), np.array(list(p.velocity)), np.array(list(p.acceleration)), r.heading,
            r.heading_rate, _MOTORS[r.motors], rc=r.rc, roll=r.roll, pitch=r.pitch,
        )  # fmt: skip

    @property
    def oscillation(self) -> Oscillation | None:
        """What the actuators do that they should not, if anything."""
        o = self.c.oscillation
        if not o.there:
            return None
        return Oscillation(INPUTS[o.input], o.since_s, o.lasting_s, o.size, o.frequency_Hz)


def _profile(p: FFI.CData) -> Profile:
    return Profile(p.way, p.speed, p.ramp_s, p.cruise_s)


def _stop(b: FFI.CData) -> Stop:
    return Stop(tuple(b.start), tuple(b.velocity), b.heading, b.duration_s, b.heading_rate, b.turn_s)


def _point(p: FFI.CData) -> Point:
    return Point(tuple(p.position), tuple(p.velocity), tuple(p.acceleration), p.heading, p.heading_rate)


def _course(c: FFI.CData) -> Trajectory | Stop | None:
    if c.kind == 0:
        return None
    if c.kind == 2:
        return _stop(c.brake)
    w, curve = c.way, None
    if w.has_curve:
        curve = SplinePath(
            tuple(tuple(row) for row in w.curve.coefficients), tuple(w.curve.arc), _profile(w.curve.timing)
        )
    return Trajectory(
        tuple(w.start), tuple(w.goal), w.heading, w.turn, _profile(w.rise), _profile(w.yaw), _profile(w.way),
        w.gate_s, w.duration_s, curve, _stop(w.lead) if w.has_lead else None,
        Unmade(tuple(tuple(row) for row in w.curve.coefficients), *w.pace) if w.making else None,
    )  # fmt: skip


def _sight(s: FFI.CData) -> Sight:
    n, e, d = s.place
    goal_n, goal_e = s.goal
    block_n, block_e = s.block_at
    return Sight(
        n, e, d, goal_n, goal_e, s.ahead, s.row, s.way, s.onward, s.from_goal, s.across, s.blockers, s.block, block_n,
        block_e, np.array([list(row) for row in s.near]),
    )  # fmt: skip


def _detour(d: FFI.CData) -> Detour:
    return Detour(
        tuple(d.position), tuple(d.velocity), tuple(d.acceleration), d.side, tuple(d.hit), d.hit_distance,
        count=d.count, stray=d.stray, clear_s=d.clear_s, anchor=tuple(d.anchor), anchor_s=d.anchor_s,
        lap=tuple(d.lap) if d.has_lap else None, laps=d.laps, lap_way=d.lap_way, best=d.best, leaving=d.leaving,
        obstacle=tuple(d.obstacle),
    )  # fmt: skip


def different(ours: Any, theirs: Any, where: str = "") -> list[str]:
    """Return where two records of the same kind differ in some bit, each with both values."""
    if isinstance(ours, Memory) and isinstance(theirs, Memory):
        # Beyond the rows in use lies what each language left there.
        pairs = [
            ("used", ours.used, theirs.used),
            ("turn", ours.turn, theirs.turn),
            ("points", ours.points[: ours.used], theirs.points[: theirs.used]),
        ]
    elif is_dataclass(ours) and type(ours) is type(theirs):
        pairs = [(f.name, getattr(ours, f.name), getattr(theirs, f.name)) for f in fields(ours)]
    elif isinstance(ours, tuple) and isinstance(theirs, tuple) and len(ours) == len(theirs):
        pairs = [(str(k), a, b) for k, (a, b) in enumerate(zip(ours, theirs, strict=True))]
    elif isinstance(ours, np.ndarray) and isinstance(theirs, np.ndarray):
        return [] if ours.tobytes() == theirs.tobytes() else [f"{where}: {ours} and {theirs}"]
    else:
        # The sign of a zero is no part of what is compared: nothing that is computed from it differs.
        same = ours == theirs or (ours != ours and theirs != theirs)
        return [] if same else [f"{where}: {ours!r} and {theirs!r}"]
    return [line for name, a, b in pairs for line in different(a, b, f"{where}.{name}".lstrip("."))]


class FirmwareSoftware(FlightSoftware):
    """:class:`mufly.flight.software.FlightSoftware`, all of it computed by the exported code.

    Parameters
    ----------
    vehicle, controller, mission
        As there.
    firmware : Firmware, optional
        Built already; by default from ``controller``.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        controller: FlightController,
        mission: Mission,
        firmware: Firmware | None = None,
    ) -> None:
        self._board: Onboard | None = None
        self._first: dict[str, Any] = {}
        self._told: dict[str, Any] = {}
        self.firmware = firmware or Firmware(controller)
        super().__init__(vehicle, controller, mission)

    def _start(self) -> None:
        self._board = Onboard(self.firmware, self._controller, self.plan)
        self.law = FirmwareControllers(self._controller, self.firmware)

    def reset(self) -> None:
        """Forget the flight: before the first step."""
        super().reset()
        self._start()
        self.tell()

    def change(self, mission: Mission) -> None:
        """Fly by another mission's limits from now on."""
        super().change(mission)
        if self._board is not None:
            self._board.fly_by(self.plan)

    def load(self, mission: Mission) -> None:
        """Take another mission, from its first waypoint on, when it is started."""
        self.change(mission)
        assert self._board is not None
        if self._board.c.watch.begun:
            self._board.loaded(mission.name)
            self.tell()

    def retune(self, controller: FlightController) -> None:
        """Go over to other numbers of the same control law, without a bump."""
        self.law.retune(controller)
        super().retune(controller)

    @property
    def due(self) -> bool:
        """Whether the next step runs the mission logic."""
        return self._board is None or bool(self._board.c.tick == 0)

    def step(self, estimate: Estimate, command: Command) -> Actuators:
        """Advance by one period."""
        board = self._board
        assert board is not None
        board.setup.gains = self.law.numbers()
        actuators = board.step(estimate, command)
        self.tell()
        return actuators

    # What the rest of the simulation asks for is made when it asks: a period takes a tenth of the time of telling all.

    def tell(self) -> None:
        """What was made of the record is no longer true."""
        self._told = {}

    def _now(self, name: str) -> Any:
        """What the record holds under a name, in the words of Python; before there is one, what Python began with."""
        board = self._board
        if board is None:
            return self._first[name]
        if name not in self._told:
            self._told[name] = getattr(board, name)
        return self._told[name]

    @property
    def board(self) -> Onboard:
        """The records that it works on."""
        assert self._board is not None
        return self._board

    def many(self, flight: Any) -> Callable[..., bool] | None:
        """Return what advances a flight by many periods in one call."""
        from mufly.firmware.quick import Many  # it imports the flight, which imports the software

        loop = Many(flight)
        return loop.run if loop.can else None

    @property
    def motors(self) -> str:
        """What the motors do."""
        return "off" if self._board is None else str(_MOTORS[self._board.c.motors])

    @property
    def flying(self) -> bool:
        """Whether it is off the floor."""
        board = self._board
        return board is not None and bool(self.firmware.lib.software_flying(board.c))

    @property
    def logged(self) -> int:
        """Entries of the log so far."""
        return 0 if self._board is None else int(self._board.c.mission.logged)

    @property
    def finished(self) -> bool:
        """Whether the mission is over."""
        return self._board is not None and bool(self._board.c.mission.finished)

    @property
    def state(self) -> State:
        """State of the mission."""
        return State.INIT if self._board is None else _STATES[self._board.c.mission.state]

    @property
    def mission_state(self) -> MissionState:
        """What the mission remembers."""
        return cast(MissionState, self._now("state"))

    @mission_state.setter
    def mission_state(self, value: MissionState) -> None:
        self._first["state"] = value

    @property
    def oscillation(self) -> Oscillation | None:
        """What the actuators do that they should not, if anything."""
        return cast("Oscillation | None", self._now("oscillation"))

    @oscillation.setter
    def oscillation(self, value: Oscillation | None) -> None:
        self._first["oscillation"] = value

    @property
    def reference(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """What is being followed: position, velocity (N-E-D), and roll, pitch, yaw."""
        if self._board is not None:
            c = self._board.c
            self._reference, self._late_s = self._now("reference"), c.late_s
            self._tilt = np.array(list(c.tilt))
        return super().reference


class QuickSoftware(FirmwareSoftware):
    """The same without tables of its own, for flights that are to be over soon; nothing differs in any bit.

    Where there is no compiler, or the mission is too long for a board, it is a :class:`FlightSoftware` that is made.
    """

    def __new__(
        cls,
        vehicle: Vehicle,
        controller: FlightController,
        mission: Mission,
        firmware: Firmware | None = None,
    ) -> Any:
        """Return the exported code or, where it cannot be had, the software in Python."""
        try:
            Firmware(None)
            plan_numbers(plan_of(vehicle, controller, mission))
        except (MuflyError, OSError):
            return FlightSoftware(vehicle, controller, mission)
        return super().__new__(cls)

    def __init__(
        self,
        vehicle: Vehicle,
        controller: FlightController,
        mission: Mission,
        firmware: Firmware | None = None,
    ) -> None:
        super().__init__(vehicle, controller, mission, firmware or Firmware(None))


class SoftwareBeside(FlightSoftware):
    """Python flies; the exported code is told the same, and compared in all that it gives and remembers.

    Attributes
    ----------
    periods, different : int
        Compared, and in how many something was not the same.
    entries : int
        Of the log.
    first : str
        Where it differed first, and how; "" if it did not.
    """

    firmware: Firmware
    controllers: Any

    def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
        self.periods = self.different = 0
        self.first = ""
        self._board: Onboard | None = None
        super().__init__(vehicle, controller, mission)
        self.compute_with(self.controllers)

    def reset(self) -> None:
        """Forget the flight: before the first step."""
        super().reset()
        if self._board is not None:
            self._board.start()

    def change(self, mission: Mission) -> None:
        """Fly by another mission's limits from now on."""
        super().change(mission)
        if self._board is not None:
            self._board.fly_by(self.plan)

    @property
    def entries(self) -> int:
        """How many of the log's lines have been compared."""
        return self.mission_state.logged

    def step(self, estimate: Estimate, command: Command) -> Actuators:
        """Advance by one period."""
        if self._board is None:
            self._board = Onboard(self.firmware, self._controller, self.plan)
        board, logged = self._board, self.mission_state.logged
        ours, theirs = super().step(estimate, command), board.step(estimate, command)
        wrong = different(ours.array, theirs.array, "actuators")
        wrong += different(self._reference, board.reference, "reference")
        if self._late_s == 0.0 or self.mission_state.logged != logged:
            wrong += different(self.mission_state, board.state, "mission")
        self.periods += 1
        self.different += bool(wrong)
        if wrong and not self.first:
            self.first = f"{estimate.time_s:.3f} s: {wrong[0]}"
        return ours


def software_beside(controllers: Any, firmware: Firmware, kept: list[SoftwareBeside]) -> type[SoftwareBeside]:
    """Return a class of flight software that compares; ``kept`` gets what is made of it.

    Parameters
    ----------
    controllers : callable
        What computes the control law of the Python side.
    firmware : Firmware
    kept : list
    """

    class Beside(SoftwareBeside):
        def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
            super().__init__(vehicle, controller, mission)
            kept.append(self)

    Beside.firmware, Beside.controllers = firmware, staticmethod(controllers)
    return Beside
