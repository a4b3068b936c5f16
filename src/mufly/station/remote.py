"""A vehicle at the other end of a link: what it tells, and what is asked of it.

Pure: messages in (:meth:`RemoteVehicle.handle`), messages out (:meth:`RemoteVehicle.step`), the clock is passed in.
Its parts: telemetry with history, status texts, commands, parameters, mission, operator control, connection,
checks. Everything that is asked for returns a :class:`mufly.station.history.Request` at once, which tells what
becomes of it. What a vehicle could never do is refused here; all else is for the vehicle to judge.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from mufly.errors import InputError
from mufly.flight import Parameter
from mufly.flight.parameters import TABLE
from mufly.link.codec import MavMessage, mavlink
from mufly.link.commands import Command
from mufly.link.parameters import LINK_PARAMETERS
from mufly.link.ports import LATE_S
from mufly.mission import Fence, Mission, fence_of, items_of_fence, load_mission
from mufly.mission.items import Refusal
from mufly.mission.items import items_of as items_of_mission
from mufly.station import autopilots
from mufly.station.autopilots import commands_of
from mufly.station.checks import Surroundings, judge
from mufly.station.commands import Chain, OperatorControl, RemoteCommands, StatusTexts
from mufly.station.history import Check, History, Message, MissionRow, Outcome, Request, Snapshot
from mufly.station.sticks import PilotSticks
from mufly.station.telemetry import Telemetry
from mufly.station.transfers import FENCE, RemoteMission, RemoteParameters, items_of, rows_of
from mufly.vehicle_types import ARDUPILOT, PX4, ardupilot_family, is_vehicle, type_words

LOST_S = 3.0
"""A vehicle that was silent for so long is lost (s)."""
_MISSED = 10
"""After so many messages that did not come, nothing waits any more to be carried out when it is heard again."""

_NO_MISSION = 65535  # MISSION_CURRENT.total
_Link = Callable[[], Request | None]


class RemoteVehicle:
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
    sticks : PilotSticks
        What a pilot here holds; streamed while it is held, and followed after :meth:`fly_by_hand`.
    on_mark : callable or None
        Takes the text of a mark; returns whether it was recorded.
    key : str
        Tells it from all others of the station, also after the station was started anew: its number and its link.
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
        self.system, self.color, self.key = system, color, str(system)
        self.us, self._asked_rate_Hz = us, rate_Hz
        self.history = History()
        self.telemetry = Telemetry(self.history)
        self.texts = StatusTexts()
        self._address(component)
        self._control = OperatorControl(system, us)
        self.sticks = PilotSticks(system)
        self._by_hand = False
        self.surroundings = Surroundings()
        self.on_mark: Callable[[str], bool] | None = None
        self._chains: list[Chain] = []
        self._moving: Request | None = None  # what it was asked to do last
        self._usual_rate_Hz = 0.0
        self._heard_s = self._now_s = -math.inf
        self._lost = False
        self._restarts = 0
        self._loss, self._rate_Hz = math.nan, math.nan
        self._reached = -1
        self._rows: tuple[object, list[MissionRow]] = (None, [])
        self._fence: tuple[object, Fence | None] = (None, None)

    def _address(self, component: int) -> None:
        """Speak to a component of the system."""
        self.component = component
        target = (self.system, component)
        self.commands = RemoteCommands(self.texts, target)
        self.transfers = RemoteMission(self.texts, target)
        self.fence_transfers = RemoteMission(self.texts, target, FENCE)
        self._parameters = RemoteParameters(self.texts, target)
        self._connection = Connection(
            self.commands, self._parameters, (self.transfers, self.fence_transfers), self._asked_rate_Hz
        )

    # What it is and tells

    @property
    def kind(self) -> str:
        """``"mufly"`` or ``"other"``."""
        return "mufly" if self._connection.ours else "other"

    @property
    def firmware(self) -> autopilots.Firmware:
        """Whose vehicle it is, which says how it wants to be asked."""
        return autopilots.firmware_of(self.telemetry.autopilot, self._connection.ours)

    @property
    def name(self) -> str:
        """What to call it: "mufly, system 1"."""
        maker = self.firmware if self.firmware != "other" else "vehicle"
        what = "" if self._connection.ours else type_words(self.telemetry.vehicle_type)
        return f"{f'{maker} {what}'.strip()}, system {self.system}"

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
        t, items = self.telemetry, self.transfers.items
        return Snapshot.of(
            t.believes,
            ("estimated",),
            t.time_s,
            t.ranges.ranges,
            connected=self.connected,
            silent_s=self._now_s - self._heard_s,
            armed=t.armed,
            flying=t.flying,
            in_command=self.in_command,
            commander=self.commander,
            state=t.state,
            mission_running=t.mission_state == mavlink.MISSION_STATE_ACTIVE,
            begun=t.mission_state in (mavlink.MISSION_STATE_ACTIVE, mavlink.MISSION_STATE_PAUSED),
            range_angles=t.ranges.angles,
            range_max_m=t.ranges.most_m,
            battery_left_s=t.battery_left_s,
            mission_row=t.mission_current if t.mission_current in range(len(items or ())) else None,
            link_loss=self._loss,
            link_rate_Hz=self._rate_Hz,
            real_time_factor=t.real_time_factor(self._now_s),
            slips=t.slips,
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
        parts = (self.telemetry, self.texts, self.transfers, self._parameters)
        return judge(self.snapshot, *parts, self.surroundings)

    # What is asked of it

    def arm(self) -> Request:
        """Let the motors run."""
        return self._move("arm", lambda: self._ask("arm", autopilots.ARM))

    def disarm(self) -> Request:
        """Stop the motors; it refuses in flight."""
        return self._move("disarm", lambda: self._ask("disarm", autopilots.DISARM))

    def take_off(self, height_m: float) -> Request:
        """Arm if needed, take off to a height above where it stands (m), and hover."""
        text = f"take off to {height_m:g} m"
        if not (math.isfinite(height_m) and height_m > 0.0):
            return _refused(text, "a height above the floor is needed")
        links: list[_Link] = []
        if self.firmware == "PX4":
            links.append(lambda: self._parameters.set("MIS_TAKEOFF_ALT", height_m))
        before = self._commands_of(autopilots.BEFORE_ARMING)
        if isinstance(before, str):
            return _refused(text, before)
        links += self._links("take off", before)
        climb = self._links("take off", (autopilots.take_off(self.firmware, height_m),))
        return self._move(text, lambda: self._chain(text, [*links, self._arm_if_needed, *climb]))

    def start_mission(self) -> Request:
        """Fly the mission, or go on with it; arms if needed."""
        if self.transfers.items is not None and not self.transfers.items:
            return _refused("fly the mission", "the vehicle holds no mission; send one first")
        text, commands = "fly the mission", self._commands_of(autopilots.START_MISSION)
        if isinstance(commands, str):
            return _refused(text, commands)
        start = self._links("start", commands)
        return self._move(text, lambda: self._chain(text, [self._arm_if_needed, *start]))

    def pause(self) -> Request:
        """Stop and hover."""
        return self._do("hover here", autopilots.PAUSE)

    def go_to(self, position: Sequence[float], heading_rad: float | None = None) -> Request:
        """Fly to a place (N, E, D; m) and hold."""
        n, e, d = (float(v) for v in position)
        text = f"fly to N {n:.2f}, E {e:.2f}, height {-d:.2f} m"
        if not all(map(math.isfinite, (n, e, d))):
            return _refused(text, "N, E and a height are needed")
        heading = math.nan if heading_rad is None else heading_rad
        command = autopilots.go_to(self.firmware, (n, e, d), heading, self.telemetry.origin)
        if isinstance(command, str):
            return _refused(text, command)
        return self._move(text, lambda: self._ask(text, command))

    def return_home(self) -> Request:
        """Return to where it took off, and land."""
        return self._do("return and land", autopilots.RETURN)

    def land(self) -> Request:
        """Land here."""
        return self._do("land", autopilots.LAND)

    def emergency_stop(self) -> Request:
        """Stop the motors at once, in flight too; nothing that was asked for before goes on after it."""
        self._give_up_moves("given up for: EMERGENCY STOP")
        self.sticks.let_go()
        self._by_hand = False
        return self._ask("EMERGENCY STOP", autopilots.EMERGENCY_STOP)

    def fly_by_hand(self) -> Request:
        """Let the sticks that are held fly it, until :meth:`let_go` or another command."""
        if not self.sticks.held:
            return _refused("fly by hand", "no sticks; hold them first")
        self._by_hand = True
        return self._do("fly by hand", autopilots.BY_HAND)

    def let_go(self) -> Request | None:
        """Let go of the sticks: it hovers where it is. None if it was not flown by them."""
        self.sticks.let_go()
        if not self._by_hand:
            return None
        self._by_hand = False
        return self._do("let go of the sticks", autopilots.LET_GO)

    def reboot(self) -> Request:
        """Start the autopilot anew; a simulation begins anew."""
        return self._ask("start anew", autopilots.REBOOT)

    def inject(
        self, unit: int, kind: int, text: str, amount: float = math.nan, duration_s: float = math.nan
    ) -> Request:
        """Let a sensor of a simulation fail (FAILURE_UNIT, FAILURE_TYPE); type 0: nothing is wrong any more.

        ``amount`` is in the unit of the reading (``late``: s), NaN the usual one; ``duration_s`` NaN: until cleared.
        """
        return self._ask(text, autopilots.inject_failure(unit, kind, amount, duration_s))

    def take_command(self) -> Request:
        """Become the station that commands it."""
        return self._control.take()

    def release_command(self) -> Request:
        """Let another station command it."""
        return self._control.release()

    def upload_mission(self, mission: Mission | Sequence[MissionRow] | str | Path) -> Request:
        """Send a mission: one of ours, rows of the table, or the name of a file."""
        try:
            if isinstance(mission, str | Path):
                mission = load_mission(mission)
            items = items_of_mission(mission).items if isinstance(mission, Mission) else items_of(mission)
        except InputError as error:
            return _refused("send a mission", str(error))
        self._reached = -1
        return self.transfers.upload(items)

    def download_mission(self) -> Request:
        """Fetch the mission that it holds."""
        return self.transfers.download()

    def clear_mission(self) -> Request:
        """Let it forget its mission."""
        return self.transfers.clear()

    @property
    def fence(self) -> Fence | None:
        """Its geofence, as far as it is known."""
        key = (self.fence_transfers.items, self.telemetry.origin)
        if key != self._fence[0]:
            base = self.surroundings.base
            known = None if base is None else base.fence
            try:
                held = known if key[0] is None else fence_of(key[0], known, key[1])
            except Refusal:
                held = None  # of a kind that is not known here
            self._fence = (key, held)
        return self._fence[1]

    def upload_fence(self, fence: Fence | None) -> Request:
        """Send a geofence, or clear it."""
        if fence is None:
            return self.fence_transfers.clear()
        on_globe = None if self.kind == "mufly" else self.telemetry.origin
        return self.fence_transfers.upload(items_of_fence(fence, on_globe))

    def set_parameter(self, name: str, value: float) -> Request:
        """Set a parameter."""
        return self._parameters.set(name, value)

    def refresh_parameters(self) -> Request:
        """Read all parameters anew."""
        return self._parameters.refresh()

    def show_mission(self, mission: Mission | None) -> None:
        """Say which mission the page shows, for the check that the vehicle holds the same."""
        self.surroundings.shown = None if mission is None else tuple(items_of_mission(mission).items)

    def started_with(self, mission: Mission) -> None:
        """Say with which mission file it was started: limits, path and obstacles stay those of that file."""
        self.surroundings.base = mission
        self.show_mission(mission)

    def mark(self, text: str) -> Request:
        """Put a mark into the recording, and among the messages."""
        request = Request(f"mark: {text}")
        recorded = self.on_mark is not None and self.on_mark(text)
        self.note("info", f"mark: {text}")
        request.end(Outcome.ACCEPTED, "" if recorded else "not recorded: the recorder is off")
        return request

    def note(self, level: str, text: str) -> None:
        """Put a line of the station's own among the messages."""
        self.texts.note(self.telemetry.time_s, level, text)

    def _ask(self, text: str, command: Command) -> Request:
        return self.commands.ask(text, command)

    def _do(self, text: str, table: autopilots.Table) -> Request:
        commands = self._commands_of(table)
        if isinstance(commands, str):
            return _refused(text, commands)
        return self._move(text, lambda: self._ask(text, *commands))

    def _commands_of(self, table: autopilots.Table) -> tuple[Command, ...] | str:
        return commands_of(table, self.firmware, ardupilot_family(self.telemetry.vehicle_type))

    def _move(self, text: str, make: Callable[[], Request]) -> Request:
        """Ask for a movement. What was asked before and is not answered is given up: it must not be done after this.

        The same once more, while it waits for its answer, is one request.
        """
        waiting = self._moving
        if waiting is not None and not waiting.done and waiting.text == text:
            return waiting
        self._give_up_moves(f"given up for: {text}", moves_only=True)
        self._moving = make()
        return self._moving

    def _give_up_moves(self, why: str, *, moves_only: bool = False, stops: bool = False) -> None:
        for chain in self._chains:
            chain.request.end(Outcome.REFUSED, why)
        self.commands.give_up_acts(why, moves_only=moves_only, stops=stops)

    def _links(self, text: str, commands: Iterable[Command]) -> list[_Link]:
        return [partial(self._ask, text, command) for command in commands]

    def _arm_if_needed(self) -> Request | None:
        return None if self.telemetry.armed else self._ask("arm", autopilots.ARM)

    def _chain(self, text: str, links: Sequence[_Link]) -> Request:
        self._chains.append(chain := Chain(text, links))
        return chain.request

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
        name, component = message.get_type(), message.get_srcComponent()
        if name == "STATUSTEXT":
            self.texts.handle(now_s, self.telemetry.time_s, message)
        if component != self.component:
            return  # of a camera, a gimbal, a companion computer
        self._heard_s = now_s
        if name == "STATUSTEXT" or getattr(message, "target_system", 0) not in (0, self.us[0]):
            return
        if name == "HEARTBEAT" and not is_vehicle(message.type, message.autopilot, component):
            return  # equipment that was given the vehicle's numbers
        self.telemetry.handle(now_s, message)
        if name == "COMMAND_ACK":
            self.commands.handle(now_s, message)
        elif name == "PARAM_VALUE":
            self._parameters.handle(now_s, message)
        elif name == "MISSION_CURRENT":
            self._mission_current(message)
        elif name == "MISSION_ITEM_REACHED":
            self._reached = max(self._reached, message.seq)
        elif name.startswith("MISSION_"):
            self.transfers.handle(now_s, message)
            self.fence_transfers.handle(now_s, message)
        elif name == "AUTOPILOT_VERSION":
            self._connection.version(message)
        elif name == "CHANGE_OPERATOR_CONTROL_ACK":
            self._control.handle(now_s, message)

    def step(self, now_s: float) -> list[MavMessage]:
        """Return what is to be sent to it now."""
        self._now_s = max(self._now_s, now_s)
        self.telemetry.step(now_s)
        self.texts.step(now_s, self.telemetry.time_s)
        self._look_after_link(now_s)
        for chain in self._chains:
            chain.step()
        self._chains = [c for c in self._chains if not c.request.done]
        self._connection.step(now_s, self.telemetry)
        hand = self.sticks.step(now_s)  # first: a vehicle wants to have heard them before it obeys them
        if self._by_hand and not self.sticks.held:
            self.note("warning", "the sticks are not held any more; a hover is asked for")
            self.let_go()
        out = hand + self.commands.step(now_s) + self._parameters.step(now_s) + self.transfers.step(now_s)
        out += self.fence_transfers.step(now_s)
        return out + self._control.step(now_s, self.telemetry.commander)

    def note_link(self, now_s: float, loss: float, rate_Hz: float) -> None:
        """Take how good the link is: share of packets lost, messages a second."""
        self._loss, self._rate_Hz = loss, rate_Hz
        self._usual_rate_Hz = max(0.5 * self._usual_rate_Hz, rate_Hz)
        self.telemetry.note_link(now_s, loss, rate_Hz)

    def change_component(self, component: int) -> None:
        """Take another component of the system for the vehicle: its autopilot, which spoke later than another.

        Parameters
        ----------
        component : int
            MAV_COMPONENT; commands, parameters and mission go there from now on.
        """
        text = (
            f"component {component} is the autopilot of system {self.system}, not component {self.component}"
        )
        for chain in self._chains:
            chain.request.end(Outcome.REFUSED, text)
        for part in (self.commands, self._parameters, self.transfers, self.fence_transfers):
            part.give_up(text)
        self.telemetry.change_speaker()
        self._reached = -1
        self._address(component)
        self.note("warning", text)

    def moved(self) -> None:
        """Note that it is heard from another address, where it knows nothing of our wishes."""
        self._connection.again()

    def stand_still(self, seconds: float) -> None:
        """Note that the station stood still for so long: nothing that was asked before is done now.

        A vehicle that was flown by sticks has let go of them by its own time-out, and may be in other hands.
        """
        why = f"not carried out: the station stood still for {seconds:.0f} s"
        self._give_up_moves(why, stops=True)
        self._give_up_changes(why)
        self.sticks.let_go()
        self._by_hand = False
        self.note(
            "warning",
            f"the station stood still for {seconds:.1f} s; what was asked before is not carried out",
        )

    def _give_up_changes(self, why: str) -> None:
        self._parameters.give_up_changes(why)
        self.transfers.give_up_changes(why)
        self._control.give_up(why)

    def _give_up_unheard(self, now_s: float) -> None:
        """Give up what waits for an answer once more messages than can be chance did not come; but no emergency stop.

        Else it is repeated, and carried out whenever the link is back.
        """
        silent_s = now_s - self._heard_s
        usual_s = _MISSED / self._usual_rate_Hz if self._usual_rate_Hz > 0.0 else LOST_S
        if math.isfinite(silent_s) and silent_s >= min(LOST_S, max(LATE_S, usual_s)):
            why = f"not carried out: the vehicle was not heard for {silent_s:.1f} s"
            self._give_up_moves(why)
            self._give_up_changes(why)

    def _look_after_link(self, now_s: float) -> None:
        self._give_up_unheard(now_s)
        lost = now_s - self._heard_s >= LOST_S
        if lost and not self._lost:
            self.note("warning", f"{self.name} is not heard any more")
        elif self._lost and not lost:
            self.note("info", f"{self.name} is heard again")
            self._connection.again()
        self._lost = lost
        if self.telemetry.clock.restarts != self._restarts:
            self._restarts = self.telemetry.clock.restarts
            self.note("warning", f"{self.name} was started anew")
            for part in (self.commands, self._parameters, self.transfers, self.fence_transfers):
                part.give_up("the vehicle was started anew")
            self._reached = -1
            self._connection.anew()

    def _mission_current(self, message: MavMessage) -> None:
        if message.seq < self._reached:
            self._reached = -1  # it flies the mission again, or another
        items = self.transfers.items
        if items is None or not message.total or self.transfers.busy:  # 0: it does not count them
            return
        total = 0 if message.total == _NO_MISSION else message.total
        # ArduPilot's first item is its home, which this total leaves out.
        own = 1 if self.telemetry.autopilot == ARDUPILOT else 0
        if total != max(0, len(items) - own):
            self.transfers.download()  # somebody else has sent it another

    @property
    def _us_number(self) -> int:
        return self.us[0] * 256 + self.us[1]


def _refused(text: str, answer: str) -> Request:
    return Request(text, Outcome.REFUSED, answer)


WISHES: tuple[tuple[str, float], ...] = (
    ("ATTITUDE", 1.0),
    ("LOCAL_POSITION_NED", 1.0),
    ("POSITION_TARGET_LOCAL_NED", 1.0),
    ("ATTITUDE_TARGET", 1.0),
    ("ODOMETRY", 0.2),
    ("ESTIMATOR_STATUS", 0.04),
    ("ACTUATOR_OUTPUT_STATUS", 1.0),
    ("VISION_POSITION_ESTIMATE", 0.5),
    ("RAW_RPM", 0.5),
    ("DEBUG_FLOAT_ARRAY", 0.5),
    ("OBSTACLE_DISTANCE", 0.25),
    ("DISTANCE_SENSOR", 0.0),
)
"""Messages, and their rates as a share of the fastest."""
_FOREIGN = (
    ("SERVO_OUTPUT_RAW", 0.1),
    ("RC_CHANNELS", 0.05),
    ("BATTERY_STATUS", 0.01),
    ("EXTENDED_SYS_STATE", 0.02),
)
_STREAM_HZ = 10
_BYTEWISE, _C_CAST = 16, 131072  # MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_*
_PATIENCE_S = 3.0


class Connection:
    """What is asked of a vehicle that was just found, or found again.

    First who it is (AUTOPILOT_VERSION); then how often it is to tell what (SET_MESSAGE_INTERVAL, or REQUEST_DATA_STREAM
    if it does not know that); then its parameters and its mission.

    Parameters
    ----------
    commands, parameters, transfers
        What does the asking; of missions and of geofences.
    rate_Hz : float
        Fastest rate.

    Attributes
    ----------
    ours : bool
        Whether it said that it is a mufly vehicle.
    """

    def __init__(
        self,
        commands: RemoteCommands,
        parameters: RemoteParameters,
        transfers: tuple[RemoteMission, RemoteMission],
        rate_Hz: float,
    ) -> None:
        self._commands, self._parameters = commands, parameters
        self._mission, self._fence = transfers
        self._rate_Hz = rate_Hz
        self.ours = False
        self.anew()

    def again(self) -> None:
        """Wish anew: it was away, or is heard from elsewhere."""
        self._wished: Request | None = None
        self._older = False

    def anew(self) -> None:
        """Ask everything anew: it was started anew."""
        self._version: MavMessage | None = None
        self._asked_s = math.nan
        self._read = False
        self.again()

    def version(self, message: MavMessage) -> None:
        """Take AUTOPILOT_VERSION."""
        self._version = message
        self.ours = bytes(message.flight_custom_version).startswith(b"mufly")
        if self.ours:
            self._parameters.describe(_ours())

    def step(self, now_s: float, telemetry: Telemetry) -> None:
        """Ask for what comes next."""
        if math.isnan(self._asked_s):
            self._asked_s = now_s
            version = autopilots.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            self._commands.ask("who are you?", version)
        if self._version is None and now_s - self._asked_s < _PATIENCE_S:
            return
        if self._wished is None:
            for name, share in WISHES if self.ours else (*WISHES[:-1], *_FOREIGN):
                number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
                command = autopilots.message_interval(number, share * self._rate_Hz)
                request = self._commands.ask(f"tell {name}", command)
                # Every vehicle has the first: if it refuses that, it does not know the command.
                self._wished = self._wished or request
        if not self._read:
            self._read = True
            known = self._version.capabilities if self._version is not None else 0
            guess = telemetry.autopilot == PX4
            self._parameters.encode_bytewise(bool(known & _BYTEWISE) or (guess and not known & _C_CAST))
            self._parameters.refresh()
            self._mission.download()
            if known & mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE:
                self._fence.download()
        if not self._older and self._wished is not None and self._wished.outcome is Outcome.REFUSED:
            self._older = True
            everything = mavlink.MAV_DATA_STREAM_ALL
            self._commands.send(
                mavlink.MAVLink_request_data_stream_message(*self._commands.target, everything, _STREAM_HZ, 1)
            )


def _ours() -> dict[str, Parameter]:
    """What is known of the parameters of our own vehicles: unit, bounds, help."""
    return TABLE | {name: replace(p, value=math.nan) for name, p in LINK_PARAMETERS.items()}
