"""The flight software: what runs on board, as a function of time steps.

``step(estimate, command) -> actuators``, called at the control design's rate. It knows nothing of the simulator.
The mission logic runs in every n-th step, with the position cascade (50 Hz), and says what the motors are to do and
what to follow:

=========== =========================================================================================
off         motors and servos at rest
spin_up     motor inputs rise to 0.9 of hover, too little to lift off; servos at trim. A vehicle that lifts off all
            the same, being lighter than its controllers believe, goes on to ``fly`` at once
fly         heave-yaw controller; from 2 cm above the floor, or once it turns on its legs, also roll-pitch and,
            every n-th step, position
ramp_down   after touchdown motor inputs fall to zero
blind       the estimate is lost: servos at trim, which the stabiliser bar makes a level attitude, and motor
            voltages around those of the last second that keep to a rate of descent while the height is known all
            the same, else a little below them, until the floor has come
=========== =========================================================================================

Between two steps of the mission logic its reference is carried on at the reference velocity. Where the mission asks
for more than the controllers can follow, it is flown more slowly (:mod:`mufly.mission.check`). Estimates that are
missing or frozen are bridged for half a second (:func:`mufly.estimate.watch`), then the flight is given up; what is
done about uncertain ones is in :mod:`mufly.flight.trust`. Actuators that oscillate (:mod:`mufly.flight.oscillation`)
end the mission too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.control import FlightController
from mufly.estimate import Estimate, Watch, watch
from mufly.flight.controllers import Actuators, Controllers, able
from mufly.flight.oscillation import Oscillation, OscillationWatch, steered
from mufly.flight.trust import HEIGHT_M, Doubts, Smooth, turns_unfelt
from mufly.mission import (
    NO_SIGNAL,
    RAMP_DOWN_S,
    SPIN_UP_S,
    Command,
    Mission,
    MissionState,
    Reference,
    State,
    Words,
    begin,
    blind,
    come_down,
    down_blind,
    go_on,
    lifted_off,
    log,
    pause,
    prepare,
    slowed,
    step,
    stop_at_once,
    tips,
    watch_out,
)
from mufly.units import GRAVITY
from mufly.vehicle import Vehicle

_Array = NDArray[np.floating[Any]]

LOST_S = 0.5
"""How long a measurement may be missing or frozen in flight (s)."""

DOWN_SHARE = 0.8
"""How much of the motors' running down is left out where it is known to be down."""

STEP_MOTOR, STEP_SERVO = 0.1, 0.2
"""How far an input moves in a period at most, on an estimate: twice what flights in gusts need (quantile 0.999)."""

_LEARN_S = 1.0
_VOLTS_S = 0.5  # in which the battery's reading counts while the rotors speed up, on an estimate


class FlightSoftware:
    """Mission logic and controllers of one vehicle.

    ``plan`` is the mission as it is flown, ``asked`` as it was loaded; ``slower`` says in words which of its limits
    were brought down to what the controllers can follow. ``mission_state`` is what the state machine remembers,
    ``oscillation`` what the actuators do that they should not, if anything.

    Parameters
    ----------
    vehicle : Vehicle
        For its range ring and battery limit.
    controller : FlightController
        From :func:`mufly.control.design`.
    mission : Mission
        Checked.

    Raises
    ------
    InputError
        If the mission does not suit the vehicle.
    """

    def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
        self._vehicle = vehicle
        self._controller = controller
        self._make: Callable[[FlightController], Controllers] = Controllers
        self.change(mission)
        self.reset()

    def reset(self) -> None:
        """Forget the flight: before the first step."""
        controller = self._controller
        self._period_s = 1.0 / controller.rate_Hz
        self._every = controller.position_divider
        self.mission_state = MissionState()
        self._reference = Reference(np.zeros(3), np.zeros(3), np.zeros(3), 0.0, 0.0, "off")
        self._command = NO_SIGNAL
        self._ticks = 0
        self._motors = "off"
        self._since_s = 0.0
        self._motor_input: _Array = np.zeros(2)
        self._tilt: _Array = np.zeros(2)
        self._controllers = self._make(controller)
        self._released: _Array = np.zeros(2)
        self._lifted = False
        self._late_s = 0.0
        self._watch: Watch | None = None
        self._oscillations = OscillationWatch()
        self.oscillation: Oscillation | None = None
        self._doubts, self._held, self._waits = Doubts(), False, False
        self._smooth = Smooth()
        self._given = Actuators.idle()
        # Motor voltages, averaged over the last second of flight.
        self._held_up: _Array = np.zeros(2)
        self._trusts_until_s = 0.0
        self._volts = 0.0

    def compute_with(self, make: Callable[[FlightController], Controllers]) -> None:
        """Let other code compute the control law, such as that for a board; on the floor, before the first step."""
        self._make = make
        self.reset()

    def change(self, mission: Mission) -> None:
        """Fly by another mission's limits from now on; its waypoints and index have to be those of the present one.

        Raises
        ------
        InputError
            If it does not suit the vehicle; nothing has changed then.
        """
        flown, slower = slowed(mission, able(self._controller))
        self.plan = prepare(flown, self._vehicle)
        self.asked, self.slower = mission, slower

    def flown(self, mission: Mission) -> Mission:
        """A mission as it would be flown: no faster than the controllers can follow."""
        return slowed(mission, able(self._controller))[0]

    def load(self, mission: Mission) -> None:
        """Take another mission, from its first waypoint on, when it is started.

        Raises
        ------
        InputError
            If it does not suit the vehicle; nothing has changed then.
        """
        self.change(mission)
        if self._watch is not None:
            n = len(mission.waypoint)
            loaded = Words.LOADED_ONE if n == 1 else Words.LOADED
            s = log(self.mission_state, loaded(mission.name or "a mission", n))
            s = replace(s, index=0, begun=False)
            # A flight that goes on is one without a mission until that is started.
            flying = s.state is not State.INIT
            self.mission_state = replace(s, outcome="", reason="", manual=True, quit="") if flying else s

    def retune(self, controller: FlightController) -> None:
        """Go over to other numbers of the same control law, without a bump."""
        self._controller = controller
        self._controllers.retune(controller)
        self.change(self.asked)

    @property
    def due(self) -> bool:
        """Whether the next step runs the mission logic, which hears the user's signals."""
        return self._ticks % self._every == 0

    @property
    def every(self) -> int:
        """Periods from one step of the mission logic to the next."""
        return self._every

    def many(self, flight: Any) -> Callable[..., bool] | None:
        """Return what advances a flight by many periods in one call, if there is such code: ``run(until)``."""
        return None

    @property
    def motors(self) -> str:
        """What the motors do: the table above."""
        return self._motors

    @property
    def state(self) -> State:
        """State of the mission."""
        return self.mission_state.state

    @property
    def logged(self) -> int:
        """Entries of the mission's log so far."""
        return self.mission_state.logged

    @property
    def finished(self) -> bool:
        """Whether the mission is over."""
        return self.mission_state.finished

    @property
    def flying(self) -> bool:
        """Whether it is off the floor."""
        return self._lifted and self._motors in ("fly", "blind")

    @property
    def reference(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """What is being followed: position, velocity (N-E-D), and roll, pitch, yaw."""
        r = self._reference
        heading = r.heading + self._late_s * r.heading_rate
        return r.position + self._late_s * r.velocity, r.velocity, np.array([*self._tilt, heading])

    def step(self, estimate: Estimate, command: Command) -> Actuators:
        """Advance by one period.

        Parameters
        ----------
        estimate : Estimate
        command : Command
            The user's signals; one given between two steps of the mission logic is kept for the next.

        Returns
        -------
        Actuators
        """
        first = self._watch is None
        self._watch = watch(self._watch, estimate, self._period_s, self.plan.ring.max_range)
        m = self._watch.good
        if m.beliefs is not None:
            m = self._smooth.step(m, anew=self._motors == "off")
        if first:
            self.mission_state = begin(self.plan, m)
        if command is not NO_SIGNAL and command != NO_SIGNAL:
            self._command = command
        if command.stop:
            return self._stop_at_once(command.stop, m)
        self._late_s = (self._ticks % self._every) * self._period_s
        self._ticks += 1
        if self._lost(self._watch):
            return self._steadied(m, self._sink_blindly(self._watch, estimate, Words.LOST(self._watch.what)))
        if self._late_s == 0.0 and m.beliefs is not None:
            doubt = self._doubt(m)
            if doubt:
                return self._steadied(m, self._sink_blindly(self._watch, estimate, doubt))
        if self._late_s == 0.0:
            self.mission_state, self._reference = step(self.plan, self.mission_state, m, self._command)
            self._command = NO_SIGNAL
        self._watch_out(m)
        r = self._reference
        if r.motors != self._motors:
            self._switch(r.motors, m)
        if r.motors == "fly":
            return self._steadied(m, self._fly(r, m))
        self._given = self._on_the_floor(r.motors, m)
        return self._given

    def _watch_out(self, m: Estimate) -> None:
        """What the beams see, in parts from one step of the mission logic to the next."""
        parts = max(1, self._every - 1)
        part = (self._ticks - 1) % self._every if self._every > 1 else 1
        if part > 0:
            self.mission_state = watch_out(self.plan, self.mission_state, m, part, parts)

    def _steadied(self, m: Estimate, wanted: Actuators) -> Actuators:
        """What is wanted, no faster than :data:`STEP_MOTOR` and :data:`STEP_SERVO` where it comes from an estimate."""
        if m.beliefs is not None:
            before = self._given
            motor, servo = _towards(
                before.motor_input, before.servo_input, wanted.motor_input, wanted.servo_input
            )
            wanted = Actuators(motor, servo)
        self._given = wanted
        return wanted

    def _stop_at_once(self, why: str, m: Estimate) -> Actuators:
        self._ticks += 1
        self.mission_state = stop_at_once(replace(self.mission_state, time_s=m.time_s), why)
        self._reference = replace(
            self._reference, velocity=np.zeros(3), heading_rate=0.0, motors="off", rc=False
        )
        self._command, self._motors, self._lifted, self._late_s = NO_SIGNAL, "off", False, 0.0
        self._given = Actuators.idle()
        self._motor_input, self._tilt = np.zeros(2), np.zeros(2)
        return Actuators.idle()

    def _lost(self, w: Watch) -> bool:
        """Whether it flies without knowing where it is or how it moves; it does not come back from that."""
        if self._motors == "blind":
            return True
        # While the motors are off it stands still, and a repeated measurement is no fault.
        running_s = w.good.time_s - self._since_s if self._motors in ("spin_up", "fly") else 0.0
        return min(w.lost_s, running_s) > LOST_S

    def _doubt(self, m: Estimate) -> str:
        """Hold or land where the estimate is not good enough for more; why it has to sink at once, "" if it has not."""
        s = self.mission_state
        if not (self._lifted and self._motors == "fly"):
            stood = max(m.covariance[0, 0], m.covariance[1, 1])
            self._doubts, self._held, self._waits = Doubts(stood=float(stood)), False, False
            return ""
        before, now = self._doubts.now, self._doubts.step(m)
        if now.demand == "sink" or (now.demand == "land" and turns_unfelt(m) and self._height(m) < TOUCHES_M):
            return now.why
        if (
            now.demand == "hold"
            and not self._held
            and s.state in (State.WAYPOINT, State.OBSTACLE, State.HOVER)
        ):
            self._held, self._waits = True, s.begun and not s.manual and s.outcome == ""
            s = log(s, now.why, level="warning")
            self.mission_state = pause(self.plan, s, Words.HOLDS())
        elif now is not before and now.demand == "land":
            self.mission_state = come_down(s, now.why)
        elif now is not before and s.state is State.RC:
            self.mission_state = log(s, now.why or Words.KNOWN(), level="warning")
        elif self._held and now.demand == "":
            goes_on = self._waits and s.state is State.HOVER and s.manual
            self._held = self._waits = False
            if goes_on:
                self.mission_state = go_on(self.plan, log(s, Words.KNOWN()), None)
        return ""

    def _sink_blindly(self, w: Watch, told: Estimate, why: str) -> Actuators:
        now = w.good.time_s
        height = self._height_still_known(told)
        if self._motors != "blind":
            self._motors = "blind"
            span = self._way_down_s(self._height(w.good)) if self._lifted else 0.0
            self._since_s, self._trusts_until_s = now + span, now + 2.0 * span
            self.mission_state = blind(self.mission_state, now, why)
            self._reference = replace(self._reference, motors="blind", velocity=np.zeros(3), heading_rate=0.0)
            self._tilt, self._command = np.zeros(2), NO_SIGNAL
        knows = self._lifted and now < self._trusts_until_s and TOUCHES_M < height < math.inf
        if knows:  # should that end, it goes on from here
            self._since_s = now + self._way_down_s(height)
        elif height <= TOUCHES_M:  # it is down: on its legs nothing holds a rotor that still lifts
            self._since_s = min(self._since_s, now - DOWN_SHARE * RAMP_DOWN_S)
        left_s = self._since_s + RAMP_DOWN_S - now
        if left_s <= 0.0:
            self.mission_state = down_blind(self.mission_state, now)
            self._reference = replace(self._reference, motors="off")
            self._motors, self._motor_input = "off", np.zeros(2)
        else:
            share = sink_share(height, float(told.velocity[2])) if knows else SINK_SHARE
            self._motor_input = sink(self._held_up, share, left_s, w.good.battery_voltage)
        return Actuators(self._motor_input, np.zeros(2))

    def _height(self, m: Estimate) -> float:
        return float(self.mission_state.standing[2] - m.position[2])

    def _height_still_known(self, m: Estimate) -> float:
        """Height above where it stood (m) of an estimate that is lost as a whole; infinite if that is lost too."""
        certain = m.beliefs is not None and m.covariance[2, 2] < HEIGHT_M * HEIGHT_M
        height = self._height(m)
        return height if certain and abs(height) + abs(float(m.velocity[2])) < 1e3 else math.inf

    def _way_down_s(self, height: float) -> float:
        return way_down_s(height, float(self._controller.position_gains["gravity"]))

    def _switch(self, motors: str, m: Estimate) -> None:
        """Engage or release the controllers without a bump."""
        if motors == "fly":
            self._controllers.engage(m, self._motor_input)
            self._lifted = False
            self._oscillations, self.oscillation = OscillationWatch(), None
            self._held_up = self._controller.motor_trim * self._controller.voltage_V
        elif motors == "spin_up":
            self._held_up, self._lifted = np.zeros(2), False
        self._motors, self._since_s = motors, m.time_s
        self._released = self._motor_input

    def _on_the_floor(self, motors: str, m: Estimate) -> Actuators:
        elapsed = m.time_s - self._since_s
        if motors == "spin_up" and m.beliefs is not None:
            self._volts += self._period_s / _VOLTS_S * (m.battery_voltage - self._volts)
        else:
            self._volts = m.battery_voltage
        if motors == "spin_up":
            hover_V = self._controller.motor_trim * self._controller.voltage_V
            self._motor_input = spin_up(hover_V, elapsed, self._volts)
        elif motors == "ramp_down":
            known = m.beliefs is None  # else it may slide, and a rotor that still lifts tips it over
            ahead = 0.0 if known else DOWN_SHARE * RAMP_DOWN_S
            self._motor_input = ramp_down(self._released, elapsed + ahead)
        else:
            self._motor_input = np.zeros(2)
        self._tilt = np.zeros(2)
        return Actuators(self._motor_input, np.zeros(2))

    def _fly(self, r: Reference, m: Estimate) -> Actuators:
        if not self._lifted and (lifted_off(self.mission_state, m) or tips(m)):
            self._lifted = True
            self._controllers.lift_off(m)
        if not self._lifted:
            self._tilt = np.zeros(2)
        elif r.rc:
            self._tilt = np.array([r.roll, r.pitch])
        elif self._late_s == 0.0:
            self._tilt = self._controllers.tilt_for(m, r.position, r.velocity, r.acceleration)
        down, turn = float(r.velocity[2]), r.heading_rate
        heave_yaw = np.array(
            [r.position[2] + self._late_s * down, r.heading + self._late_s * turn, down, turn]
        )
        actuators = self._controllers.step(m, heave_yaw, self._tilt if self._lifted else None)
        self._motor_input = actuators.motor_input
        if self._late_s == 0.0:
            blend = self._every * self._period_s / _LEARN_S
            self._held_up += blend * (actuators.motor_input * m.battery_voltage - self._held_up)
            self._look_for_oscillations(actuators, r, m.time_s)
        return actuators

    def _look_for_oscillations(self, actuators: Actuators, r: Reference, time_s: float) -> None:
        before = self.oscillation
        asked = steered(self.mission_state.state, r.velocity.tolist(), r.heading_rate, r.roll, r.pitch)
        self.oscillation = self._oscillations.step(time_s, actuators.array.tolist(), asked)
        if self.oscillation is not None and before is None:
            self.mission_state = come_down(self.mission_state, str(self.oscillation))


@compiled
def _towards(
    motor: _Array, servo: _Array, wanted_motor: _Array, wanted_servo: _Array
) -> tuple[_Array, _Array]:
    """Both inputs, from what they are towards what is wanted, by no more than a step."""
    return (
        motor + np.minimum(np.maximum(wanted_motor - motor, -STEP_MOTOR), STEP_MOTOR),
        servo + np.minimum(np.maximum(wanted_servo - servo, -STEP_SERVO), STEP_SERVO),
    )


Computing = Callable[[FlightController], Controllers] | type[FlightSoftware]
"""What may fly in place of the classes above: what computes the control law, or all of the flight software."""


# Motors without a controller: speeding up and running down on the floor, and coming down when the estimate is lost
#
# Two rotors at a share s of the voltages that hold the helicopter up turn s times as fast and lift s^2 times as much.
# Speeding up to 0.9 leaves a fifth of the weight on the legs. Sinking blindly at 0.98 the weight is 0.04 short: it
# falls at 0.04 g and touches down from 2 m at 1.3 m/s (drag left out). Where height and rate of descent are known, the
# share s keeps to a rate: (1 - s^2) g is the acceleration, which takes 0.4 s for the rate.


SPIN_UP_SHARE = 0.9
SINK_SHARE = 0.98
TOUCHES_M = 0.03
"""Height from which it counts as down (m)."""
_SINK_M_S, _TOUCH_M_S = 0.9, 0.5  # high up and near the floor: the longer it takes, the faster it drifts
_SINK_GAIN = 1.0 / (2.0 * GRAVITY * 0.4)  # of the share, to the rate of descent (s/m)
_SINK_LEAST, _SINK_MOST = 0.92, 1.08
_MARGIN_S = 1.0


def spin_up(hover_V: _Array, elapsed_s: float, battery_V: float) -> _Array:
    """Motor inputs (2,) while the rotors speed up, ``elapsed_s`` (s) after they began.

    Half of the time is to rise, half for the slow upper rotor to follow.

    Parameters
    ----------
    hover_V : (2,) array
        Motor voltages of hover (V).
    elapsed_s, battery_V : float
    """
    share = SPIN_UP_SHARE * min(1.0, 2.0 * elapsed_s / SPIN_UP_S)
    return np.minimum(share * hover_V / battery_V, 1.0)


def ramp_down(released: _Array, elapsed_s: float) -> _Array:
    """Motor inputs (2,) after touchdown: from ``released`` (2,) to zero within a second."""
    return released * max(0.0, 1.0 - elapsed_s / RAMP_DOWN_S)


def sink(held_up_V: _Array, share: float, left_s: float, battery_V: float) -> _Array:
    """Motor inputs (2,) of a blind way down: a share of what held it up (V), to zero in its last second."""
    return np.minimum(share * min(1.0, left_s / RAMP_DOWN_S) * held_up_V / battery_V, 1.0)


def sink_share(height_m: float, descent_m_s: float) -> float:
    """Share of the voltages that held it up with which it comes down, at a height above the floor (m)."""
    wanted = min(max(height_m, _TOUCH_M_S), _SINK_M_S)
    return min(max(1.0 + _SINK_GAIN * (descent_m_s - wanted), _SINK_LEAST), _SINK_MOST)


def way_down_s(height_m: float, gravity: float) -> float:
    """How long a blind way down takes from a height (m), with a second to spare (s); ``gravity`` in m/s2."""
    return math.sqrt(2.0 * max(0.0, height_m) / ((1.0 - SINK_SHARE * SINK_SHARE) * gravity)) + _MARGIN_S
