"""A vehicle at the other end of a link: what it tells, and what is asked of it.

Pure: messages in (:meth:`RemoteVehicle.handle`), messages out (:meth:`RemoteVehicle.step`), the clock is passed in.
Parts, each in a file of its own: telemetry and history, texts, commands, parameters, mission transfers, command of
the vehicle, checks. Everything that is asked for returns a :class:`mufly.station.view.Request` at once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from mufly.link.dialect import MavMessage
from mufly.station import orders
from mufly.station.asking import Asking
from mufly.station.checks import Surroundings, judge
from mufly.station.command_desk import CommandDesk
from mufly.station.greeting import Greeting
from mufly.station.history import History
from mufly.station.missions import rows_of
from mufly.station.modes import ARDUPILOT
from mufly.station.parameters import Parameters
from mufly.station.requests import Chain, Commands
from mufly.station.telemetry import Telemetry
from mufly.station.texts import Texts
from mufly.station.transfers import Transfers
from mufly.station.view import Check, Message, MissionRow, Parameter, Snapshot

__all__ = ["LOST_S", "RemoteVehicle"]

LOST_S = 3.0
"""A vehicle that was silent for so long is lost (s)."""

_TYPES = {1: "aeroplane", 2: "quadrotor", 3: "coaxial helicopter", 4: "helicopter", 10: "rover", 12: "submarine",
          13: "hexarotor", 14: "octorotor"}  # fmt: skip


class RemoteVehicle(Asking):
    """One vehicle, as a page draws and commands it.

    Parameters
    ----------
    system, component : int
        Its MAVLink address.
    us : (system, component)
        Ours.
    color : int
        Which of the page's colours it has.
    rate_Hz : float
        How often it is asked to tell its motion.

    Attributes
    ----------
    history : History
        Its signals over the last ten minutes.
    surroundings : Surroundings
        What the station knows besides, for the checks.
    on_mark : callable or None
        Takes the text of a mark; returns whether it was recorded.
    """

    def __init__(
        self,
        system: int,
        component: int,
        *,
        us: tuple[int, int] = (255, 190),
        color: int = 0,
        rate_Hz: float = 100.0,
    ) -> None:
        self.system, self.component, self.color = system, component, color
        self.us = us
        target = (system, component)
        self.history = History()
        self.telemetry = Telemetry(self.history)
        self.texts = Texts()
        self.commands = Commands(self.texts, target)
        self.transfers = Transfers(self.texts, target)
        self._parameters = Parameters(self.texts, target)
        self._desk = CommandDesk(system, us)
        self._greeting = Greeting(self.commands, self._parameters, self.transfers, rate_Hz)
        self.surroundings = Surroundings()
        self.on_mark: Callable[[str], bool] | None = None
        self._chains: list[Chain] = []
        self._heard_s = self._now_s = -math.inf
        self._lost = False
        self._restarts = 0
        self._loss, self._rate_Hz = math.nan, math.nan
        self._reached = -1
        self._rows: tuple[object, list[MissionRow]] = (None, [])

    # What it is and tells

    @property
    def kind(self) -> str:
        """``"mufly"`` or ``"other"``."""
        return "mufly" if self._greeting.ours else "other"

    @property
    def dialect(self) -> orders.Dialect:
        """How it wants to be asked."""
        return orders.dialect_of(self.telemetry.autopilot, self._greeting.ours)

    @property
    def name(self) -> str:
        """What to call it: "mufly, system 1"."""
        maker = self.dialect if self.dialect != "other" else "vehicle"
        what = (
            maker if self._greeting.ours else f"{maker} {_TYPES.get(self.telemetry.vehicle_type, '')}".strip()
        )
        return f"{what}, system {self.system}"

    @property
    def connected(self) -> bool:
        """Whether it was heard of late."""
        return self._now_s - self._heard_s < LOST_S

    @property
    def in_command(self) -> bool:
        """Whether this station commands it. A vehicle that tells nobody who does obeys everybody."""
        return self.telemetry.commander in (None, self._us_number)

    @property
    def commander(self) -> str:
        """Who commands it, in words; "" if nobody or unknown."""
        number = self.telemetry.commander
        if not number:
            return ""
        if number == self._us_number:
            return "this station"
        return f"station {number // 256} (component {number % 256})"

    @property
    def snapshot(self) -> Snapshot:
        """The present."""
        t = self.telemetry
        rotor_speed = t.believes("measured_rotor_speed")
        if not all(map(math.isfinite, rotor_speed)):
            rotor_speed = t.believes("truth_rotor_speed")
        return Snapshot(
            time_s=t.time_s,
            connected=self.connected,
            silent_s=self._now_s - self._heard_s,
            armed=t.armed,
            flying=t.flying,
            in_command=self.in_command,
            commander=self.commander,
            state=t.state,
            position=t.believes("estimated_position"),
            velocity=t.believes("estimated_velocity"),
            attitude=t.believes("estimated_attitude"),
            rates=t.believes("estimated_rates"),
            reference_position=t.believes("reference_position"),
            reference_velocity=t.believes("reference_velocity"),
            reference_attitude=t.believes("reference_attitude"),
            motor_input=t.believes("motor_input"),
            servo_input=t.believes("servo_input"),
            rotor_speed=rotor_speed,
            ranges=t.ranges.ranges,
            range_angles=t.ranges.angles,
            range_max_m=t.ranges.most_m,
            battery_voltage=float(t.believes("battery_voltage")[0]),
            battery_current=float(t.believes("battery_current")[0]),
            battery_charge=float(t.believes("battery_charge")[0]),
            battery_left_s=t.battery_left_s,
            waypoint=self._waypoint,
            link_loss=self._loss,
            link_rate_Hz=self._rate_Hz,
        )

    @property
    def messages(self) -> deque[Message]:
        """What it said, newest last."""
        return self.texts.messages

    @property
    def mission(self) -> list[MissionRow]:
        """The mission that it holds; empty while that is not known."""
        key = (self.transfers.items, self.telemetry.origin, self.mission_progress)
        if key != self._rows[0]:
            self._rows = (key, rows_of(self.transfers.items or (), key[1], key[2]))
        return self._rows[1]

    @property
    def mission_progress(self) -> int:
        """How many rows of the mission are behind it."""
        return max(self.telemetry.mission_current or 0, self._reached + 1)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Its parameters by name."""
        return self._parameters.table

    @property
    def parameters_missing(self) -> int:
        """How many have not come yet."""
        return self._parameters.missing

    @property
    def checks(self) -> list[Check]:
        """What to look at before it flies."""
        return judge(self, self.surroundings)

    # The machine

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take a message that it sent.

        Parameters
        ----------
        now_s : float
            Our clock (s).
        message : pymavlink message
        """
        self._now_s = max(self._now_s, now_s)
        self._heard_s = now_s
        if getattr(message, "target_system", 0) not in (0, self.us[0]):
            return
        name = message.get_type()
        if name == "STATUSTEXT":
            self.texts.handle(now_s, self.telemetry.time_s, message)
            return
        if message.get_srcComponent() != self.component:
            return  # of a camera, a gimbal, a companion computer
        self.telemetry.handle(now_s, message)
        if name == "COMMAND_ACK":
            self.commands.handle(now_s, message)
        elif name == "PARAM_VALUE":
            self._parameters.handle(now_s, message)
        elif name.startswith("MISSION_"):
            self._mission_message(now_s, message)
        elif name == "AUTOPILOT_VERSION":
            self._greeting.version(message)
        elif name == "CHANGE_OPERATOR_CONTROL_ACK":
            self._desk.handle(now_s, message)

    def step(self, now_s: float) -> list[MavMessage]:
        """Return what is to be sent to it now."""
        self._now_s = max(self._now_s, now_s)
        self.telemetry.step(now_s)
        self.texts.step(now_s, self.telemetry.time_s)
        self._look_after_link(now_s)
        for chain in self._chains:
            chain.step()
        self._chains = [c for c in self._chains if not c.request.done]
        self._greeting.step(now_s, self.telemetry)
        out = self.commands.step(now_s) + self._parameters.step(now_s) + self.transfers.step(now_s)
        return out + self._desk.step(now_s, self.telemetry.commander)

    def note_link(self, now_s: float, loss: float, rate_Hz: float) -> None:
        """Take how good the link is: share of packets lost, messages a second."""
        self._loss, self._rate_Hz = loss, rate_Hz
        self.telemetry.note_link(now_s, loss, rate_Hz)

    def moved(self) -> None:
        """Note that it is heard from another address, where it knows nothing of our wishes."""
        self._greeting.again()

    def _look_after_link(self, now_s: float) -> None:
        lost = now_s - self._heard_s >= LOST_S
        if lost and not self._lost:
            self.texts.note(self.telemetry.time_s, "warning", f"{self.name} is not heard any more")
        elif self._lost and not lost:
            self.texts.note(self.telemetry.time_s, "info", f"{self.name} is heard again")
            self._greeting.again()
        self._lost = lost
        if self.telemetry.clock.restarts != self._restarts:
            self._restarts = self.telemetry.clock.restarts
            self.texts.note(self.telemetry.time_s, "warning", f"{self.name} was started anew")
            for part in (self.commands, self._parameters, self.transfers):
                part.give_up("the vehicle was started anew")
            self._reached = -1
            self._greeting.anew()

    def _mission_message(self, now_s: float, message: MavMessage) -> None:
        name = message.get_type()
        if name == "MISSION_CURRENT":
            if message.seq < self._reached:
                self._reached = -1  # it flies the mission again, or another
            items = self.transfers.items
            counted = 0 < message.total < 65535 or (message.total == 0 and self._greeting.ours)
            # ArduPilot's first item is its home, which this total leaves out.
            own = 1 if self.telemetry.autopilot == ARDUPILOT else 0
            if (
                items is not None
                and counted
                and message.total != max(0, len(items) - own)
                and not self.transfers.busy
            ):
                self.transfers.download()  # somebody else has sent it another
        elif name == "MISSION_ITEM_REACHED":
            self._reached = max(self._reached, message.seq)
        else:
            self.transfers.handle(now_s, message)

    @property
    def _us_number(self) -> int:
        return self.us[0] * 256 + self.us[1]

    @property
    def _waypoint(self) -> int | None:
        current, items = self.telemetry.mission_current, self.transfers.items
        return current if current is not None and items and current < len(items) else None
