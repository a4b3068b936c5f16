"""The station's model of a remote vehicle: its telemetry and the requests to it.

No I/O: messages in (:meth:`RemoteVehicle.handle_message`), messages out (:meth:`RemoteVehicle.take_due_messages`),
the clock is passed in. Its parts: telemetry with history, status texts, commands, parameters, mission, operator
control, connection, checks. Every request returns a :class:`mufly.station.signal_history.OperatorRequest` at once,
which reports its outcome. Impossible requests are refused here; the vehicle decides on all others.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from mufly.errors import InputError
from mufly.flight import TunableParameter
from mufly.link.codec import MavMessage, mavlink
from mufly.link.command_protocol import Command
from mufly.link.mission_transfer import TYPE_FENCE
from mufly.link.ports import MAX_REQUEST_AGE_S
from mufly.mission import Fence, Mission, fence_from_items, fence_to_items, load_mission
from mufly.mission.files.mission_items import MissionRefusedError, mission_to_items
from mufly.station.mission_rows import rows_from_items
from mufly.station.preflight_checks import StationContext, run_preflight_checks
from mufly.station.remote import autopilots
from mufly.station.remote.autopilots import select_action_commands
from mufly.station.remote.connection_setup import ConnectionSetup
from mufly.station.remote.pilot_sticks import PilotSticks
from mufly.station.remote.remote_commands import OperatorControlClient, RemoteCommands, RequestChain, StatusTextLog
from mufly.station.remote.remote_transfers import (
    RemoteMission,
    RemoteParameters,
)
from mufly.station.remote.vehicle_telemetry import VehicleTelemetry
from mufly.station.signal_history import (
    MissionRow,
    OperatorRequest,
    PreflightCheck,
    RequestOutcome,
    SignalHistory,
    StatusMessage,
    VehicleSnapshot,
)
from mufly.vehicle_types import MAV_AUTOPILOT_ARDUPILOT, ardupilot_family, is_vehicle, vehicle_type_name

LOST_TIMEOUT_S = 3.0
"""Silence after which a vehicle is lost (s)."""
_CANCEL_AFTER_MISSED_MESSAGES = 10
"""Number of missed messages after which open actions are cancelled."""

_NO_MISSION_ITEM = 65535  # MISSION_CURRENT.total
_ChainLink = Callable[[], OperatorRequest | None]


class RemoteVehicle:
    """One vehicle, as drawn and commanded by a page.

    Parameters
    ----------
    system, component : int
        MAVLink address of the vehicle.
    us : (system, component)
        MAVLink address of the station.
    color : int
        Index of the vehicle's colour on the page.
    rate_Hz : float
        Requested rate of motion messages (Hz).

    Attributes
    ----------
    history : SignalHistory
        Signals over the last ten minutes.
    station_context : StationContext
        State of the station, for the checks.
    sticks : PilotSticks
        The pilot's sticks: streamed while held, effective after :meth:`fly_manually`.
    on_mark : callable or None
        Called with the text of a mark; returns whether it was recorded.
    key : str
        Unique key in the station, from number and link; the same after a restart of the station.
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
        self.own_ids, self._asked_rate_Hz = us, rate_Hz
        self.history = SignalHistory()
        self.telemetry = VehicleTelemetry(self.history)
        self.texts = StatusTextLog()
        self._switch_target_component(component)
        self._control = OperatorControlClient(system, us)
        self.sticks = PilotSticks(system)
        self._by_hand = False
        self.station_context = StationContext()
        self.on_mark: Callable[[str], bool] | None = None
        self._chains: list[RequestChain] = []
        self._moving: OperatorRequest | None = None  # the latest motion request
        self._usual_rate_Hz = 0.0
        self._heard_s = self._now_s = -math.inf
        self._lost = False
        self._restarts = 0
        self._loss, self._rate_Hz = math.nan, math.nan
        self._reached = -1
        self._rows: tuple[object, list[MissionRow]] = (None, [])
        self._fence: tuple[object, Fence | None] = (None, None)

    def _switch_target_component(self, component: int) -> None:
        """Address a component of the system."""
        self.component = component
        target = (self.system, component)
        self.commands = RemoteCommands(self.texts, target)
        self.transfers = RemoteMission(self.texts, target)
        self.fence_transfers = RemoteMission(self.texts, target, TYPE_FENCE)
        self._parameters = RemoteParameters(self.texts, target)
        self._connection = ConnectionSetup(
            self.commands, self._parameters, (self.transfers, self.fence_transfers), self._asked_rate_Hz
        )

    # State and telemetry

    @property
    def kind(self) -> str:
        """Return ``"mufly"`` for a mufly vehicle, ``"other"`` for another autopilot."""
        return "mufly" if self._connection.is_mufly else "other"

    @property
    def firmware_kind(self) -> autopilots.FirmwareKind:
        """Return the firmware kind, which selects the commands."""
        return autopilots.identify_firmware(self.telemetry.autopilot, self._connection.is_mufly)

    @property
    def display_name(self) -> str:
        """Return the display name: "mufly, system 1"."""
        maker = self.firmware_kind if self.firmware_kind != "other" else "vehicle"
        what = "" if self._connection.is_mufly else vehicle_type_name(self.telemetry.vehicle_type)
        return f"{f'{maker} {what}'.strip()}, system {self.system}"

    @property
    def is_connected(self) -> bool:
        """Return whether the vehicle was heard recently."""
        return self._now_s - self._heard_s < LOST_TIMEOUT_S

    @property
    def has_operator_control(self) -> bool:
        """Return whether this station has control; true also if the vehicle publishes no commander."""
        return self.telemetry.commander_id in (None, self._own_station_number)

    @property
    def commander_text(self) -> str:
        """Return the commander as text; "" if none or unknown."""
        number = self.telemetry.commander_id
        if not number:
            return ""
        if number == self._own_station_number:
            return "this station"
        return f"station {number // 256} (component {number % 256})"

    @property
    def snapshot(self) -> VehicleSnapshot:
        """Return the present state of the vehicle."""
        t, items = self.telemetry, self.transfers.items
        return VehicleSnapshot.from_signals(
            t.present_value,
            ("estimated",),
            t.time_s,
            t.ranges.distances_m,
            connected=self.is_connected,
            silent_s=self._now_s - self._heard_s,
            armed=t.armed,
            flying=t.is_flying,
            in_command=self.has_operator_control,
            commander=self.commander_text,
            state=t.mission_state_or_mode,
            mission_running=t.mission_state == mavlink.MISSION_STATE_ACTIVE,
            mission_begun=t.mission_state in (mavlink.MISSION_STATE_ACTIVE, mavlink.MISSION_STATE_PAUSED),
            range_angles=t.ranges.angles_rad,
            range_max_m=t.ranges.max_range_m,
            battery_left_s=t.battery_left_s,
            mission_row=t.mission_current if t.mission_current in range(len(items or ())) else None,
            link_loss=self._loss,
            link_rate_Hz=self._rate_Hz,
            real_time_factor=t.real_time_factor(self._now_s),
            timing_overrun_count=t.slip_count,
        )

    @property
    def status_messages(self) -> deque[StatusMessage]:
        """Return the status messages, newest last."""
        return self.texts.messages

    @property
    def mission_rows(self) -> list[MissionRow]:
        """Return the vehicle's mission; empty while unknown."""
        key = (self.transfers.items, self.telemetry.origin, self.passed_row_count)
        if key != self._rows[0]:
            self._rows = (key, rows_from_items(self.transfers.items or (), key[1], key[2]))
        return self._rows[1]

    @property
    def passed_row_count(self) -> int:
        """Return the number of mission rows passed."""
        return max(self.telemetry.mission_current or 0, self._reached + 1)

    @property
    def parameters(self) -> dict[str, TunableParameter]:
        """Return the parameters by name."""
        return self._parameters.parameter_table

    @property
    def missing_parameter_count(self) -> int:
        """Return the number of parameters not received."""
        return self._parameters.missing_count

    @property
    def preflight_checks(self) -> list[PreflightCheck]:
        """Return the preflight checks."""
        parts = (self.telemetry, self.texts, self.transfers, self._parameters)
        return run_preflight_checks(self.snapshot, *parts, self.station_context)

    # Requests

    def arm(self) -> OperatorRequest:
        """Arm the motors."""
        return self._request_motion("arm", lambda: self._request_command("arm", autopilots.ARM_COMMAND))

    def disarm(self) -> OperatorRequest:
        """Disarm the motors; refused in flight."""
        return self._request_motion("disarm", lambda: self._request_command("disarm", autopilots.DISARM_COMMAND))

    def take_off(self, height_m: float) -> OperatorRequest:
        """Arm if needed, take off to a height above the ground position (m), and hover."""
        text = f"take off to {height_m:g} m"
        if not (math.isfinite(height_m) and height_m > 0.0):
            return _refused_request(text, "a height above the floor is required")
        links: list[_ChainLink] = []
        if self.firmware_kind == "PX4":
            links.append(lambda: self._parameters.set_parameter("MIS_TAKEOFF_ALT", height_m))
        before = self._select_commands(autopilots.PRE_ARM_COMMANDS)
        if isinstance(before, str):
            return _refused_request(text, before)
        links += self._make_chain_links("take off", before)
        climb = self._make_chain_links("take off", (autopilots.make_take_off_command(self.firmware_kind, height_m),))
        return self._request_motion(text, lambda: self._start_chain(text, [*links, self._arm_if_needed, *climb]))

    def start_mission(self) -> OperatorRequest:
        """Start or resume the mission; arm if needed."""
        if self.transfers.items is not None and not self.transfers.items:
            return _refused_request("start the mission", "no mission in the vehicle; upload one first")
        text, commands = "start the mission", self._select_commands(autopilots.START_MISSION_COMMANDS)
        if isinstance(commands, str):
            return _refused_request(text, commands)
        start = self._make_chain_links("start", commands)
        return self._request_motion(text, lambda: self._start_chain(text, [self._arm_if_needed, *start]))

    def pause(self) -> OperatorRequest:
        """Stop and hover."""
        return self._request_from_table("hover", autopilots.PAUSE_COMMANDS)

    def go_to(self, position: Sequence[float], heading_rad: float | None = None) -> OperatorRequest:
        """Fly to a position (N, E, D; m) and hold."""
        n, e, d = (float(v) for v in position)
        text = f"go to N {n:.2f}, E {e:.2f}, height {-d:.2f} m"
        if not all(map(math.isfinite, (n, e, d))):
            return _refused_request(text, "N, E and a height are required")
        heading = math.nan if heading_rad is None else heading_rad
        command = autopilots.make_go_to_command(self.firmware_kind, (n, e, d), heading, self.telemetry.origin)
        if isinstance(command, str):
            return _refused_request(text, command)
        return self._request_motion(text, lambda: self._request_command(text, command))

    def return_home(self) -> OperatorRequest:
        """Return to the take-off position and land."""
        return self._request_from_table("return and land", autopilots.RETURN_COMMANDS)

    def land(self) -> OperatorRequest:
        """Land at the present position."""
        return self._request_from_table("land", autopilots.LAND_COMMANDS)

    def emergency_stop(self) -> OperatorRequest:
        """Stop the motors at once, in flight too; cancel all open requests."""
        self._cancel_chains_and_actions("superseded by: EMERGENCY STOP")
        self.sticks.release_sticks()
        self._by_hand = False
        return self._request_command("EMERGENCY STOP", autopilots.EMERGENCY_STOP_COMMAND)

    def fly_manually(self) -> OperatorRequest:
        """Start manual flight with the held sticks, until :meth:`release_sticks` or another command."""
        if not self.sticks.is_held:
            return _refused_request("manual flight", "no stick input")
        self._by_hand = True
        return self._request_from_table("manual flight", autopilots.MANUAL_CONTROL_COMMANDS)

    def release_sticks(self) -> OperatorRequest | None:
        """Release the sticks and hover in place; return None if they did not fly the vehicle."""
        self.sticks.release_sticks()
        if not self._by_hand:
            return None
        self._by_hand = False
        return self._request_from_table("end manual flight", autopilots.RELEASE_STICKS_COMMANDS)

    def reboot(self) -> OperatorRequest:
        """Restart the autopilot; a simulation restarts too."""
        return self._request_command("reboot", autopilots.REBOOT_COMMAND)

    def inject_failure(
        self, unit: int, kind: int, text: str, amount: float = math.nan, duration_s: float = math.nan
    ) -> OperatorRequest:
        """Inject a sensor failure in a simulation (FAILURE_UNIT, FAILURE_TYPE); type 0 clears all failures.

        ``amount`` is in the unit of the reading (``late``: s), NaN the usual one; ``duration_s`` NaN: until cleared.
        """
        return self._request_command(text, autopilots.make_inject_failure_command(unit, kind, amount, duration_s))

    def request_operator_control(self) -> OperatorRequest:
        """Request operator control for this station."""
        return self._control.request_operator_control()

    def release_operator_control(self) -> OperatorRequest:
        """Release operator control."""
        return self._control.release_operator_control()

    def upload_mission(self, mission: Mission | str | Path) -> OperatorRequest:
        """Upload a mission, or the mission file of this name."""
        try:
            if isinstance(mission, str | Path):
                mission = load_mission(mission)
            items = mission_to_items(mission).items
        except InputError as error:
            return _refused_request("upload a mission", str(error))
        self._reached = -1
        return self.transfers.upload_items(items)

    def download_mission(self) -> OperatorRequest:
        """Download the vehicle's mission."""
        return self.transfers.download_items()

    def clear_mission(self) -> OperatorRequest:
        """Clear the vehicle's mission."""
        return self.transfers.clear_items()

    @property
    def fence(self) -> Fence | None:
        """Return the vehicle's geofence; None while unknown."""
        key = (self.fence_transfers.items, self.telemetry.origin)
        if key != self._fence[0]:
            base = self.station_context.base_mission
            known = None if base is None else base.fence
            try:
                held = known if key[0] is None else fence_from_items(key[0], known, key[1])
            except MissionRefusedError:
                held = None  # a fence of an unsupported kind
            self._fence = (key, held)
        return self._fence[1]

    def upload_fence(self, fence: Fence | None) -> OperatorRequest:
        """Upload a geofence, or clear it."""
        if fence is None:
            return self.fence_transfers.clear_items()
        on_globe = None if self.kind == "mufly" else self.telemetry.origin
        return self.fence_transfers.upload_items(fence_to_items(fence, on_globe))

    def set_parameter(self, name: str, value: float) -> OperatorRequest:
        """Write a parameter's value to the vehicle."""
        return self._parameters.set_parameter(name, value)

    def refresh_parameters(self) -> OperatorRequest:
        """Request all parameters again."""
        return self._parameters.request_all_parameters()

    def set_shown_mission(self, mission: Mission | None) -> None:
        """Set the mission shown on the page; a preflight check compares it with the vehicle's."""
        self.station_context.shown_items = None if mission is None else tuple(mission_to_items(mission).items)

    def set_base_mission(self, mission: Mission) -> None:
        """Set the mission file with which the vehicle was started: source of limits, path and obstacles."""
        self.station_context.base_mission = mission
        self.set_shown_mission(mission)

    def add_mark(self, text: str) -> OperatorRequest:
        """Add a mark with the present time to the recording and to the messages."""
        request = OperatorRequest(f"mark: {text}")
        recorded = self.on_mark is not None and self.on_mark(text)
        self.add_note("info", f"mark: {text}")
        request.set_outcome(RequestOutcome.ACCEPTED, "" if recorded else "not recorded: the recorder is off")
        return request

    def add_note(self, level: str, text: str) -> None:
        """Add a message of the station itself to the messages."""
        self.texts.add_message(self.telemetry.time_s, level, text)

    def _request_command(self, text: str, command: Command) -> OperatorRequest:
        return self.commands.request_command(text, command)

    def _request_from_table(self, text: str, table: autopilots.CommandTable) -> OperatorRequest:
        commands = self._select_commands(table)
        if isinstance(commands, str):
            return _refused_request(text, commands)
        return self._request_motion(text, lambda: self._request_command(text, *commands))

    def _select_commands(self, table: autopilots.CommandTable) -> tuple[Command, ...] | str:
        return select_action_commands(table, self.firmware_kind, ardupilot_family(self.telemetry.vehicle_type))

    def _request_motion(self, text: str, make: Callable[[], OperatorRequest]) -> OperatorRequest:
        """Request a motion; cancel earlier unanswered motion requests, which must not be executed after it.

        Repeating a request that waits for its answer returns the same request.
        """
        waiting = self._moving
        if waiting is not None and not waiting.is_done and waiting.text == text:
            return waiting
        self._cancel_chains_and_actions(f"superseded by: {text}", moves_only=True)
        self._moving = make()
        return self._moving

    def _cancel_chains_and_actions(self, why: str, *, moves_only: bool = False, stops: bool = False) -> None:
        for chain in self._chains:
            chain.request.set_outcome(RequestOutcome.REFUSED, why)
        self.commands.cancel_actions(why, moves_only=moves_only, stops=stops)

    def _make_chain_links(self, text: str, commands: Iterable[Command]) -> list[_ChainLink]:
        return [partial(self._request_command, text, command) for command in commands]

    def _arm_if_needed(self) -> OperatorRequest | None:
        return None if self.telemetry.armed else self._request_command("arm", autopilots.ARM_COMMAND)

    def _start_chain(self, text: str, links: Sequence[_ChainLink]) -> OperatorRequest:
        self._chains.append(chain := RequestChain(text, links))
        return chain.request

    # Message handling

    def handle_message(self, now_s: float, message: MavMessage) -> None:
        """Process a message from the vehicle.

        Parameters
        ----------
        now_s : float
            Station's clock (s).
        message : pymavlink message
        """
        self._now_s = max(self._now_s, now_s)
        name, component = message.get_type(), message.get_srcComponent()
        if name == "STATUSTEXT":
            self.texts.handle_status_text(now_s, self.telemetry.time_s, message)
        if component != self.component:
            return  # from a camera, a gimbal or a companion computer
        self._heard_s = now_s
        if name == "STATUSTEXT" or getattr(message, "target_system", 0) not in (0, self.own_ids[0]):
            return
        if name == "HEARTBEAT" and not is_vehicle(message.type, message.autopilot, component):
            return  # equipment with the vehicle's numbers
        self.telemetry.handle_message(now_s, message)
        if name == "COMMAND_ACK":
            self.commands.handle_command_ack(now_s, message)
        elif name == "PARAM_VALUE":
            self._parameters.handle_parameter_value(now_s, message)
        elif name == "MISSION_CURRENT":
            self._handle_mission_current(message)
        elif name == "MISSION_ITEM_REACHED":
            self._reached = max(self._reached, message.seq)
        elif name.startswith("MISSION_"):
            self.transfers.handle_message(now_s, message)
            self.fence_transfers.handle_message(now_s, message)
        elif name == "AUTOPILOT_VERSION":
            self._connection.handle_version(message)
        elif name == "CHANGE_OPERATOR_CONTROL_ACK":
            self._control.handle_control_answer(now_s, message)

    def take_due_messages(self, now_s: float) -> list[MavMessage]:
        """Return the messages to send to the vehicle."""
        self._now_s = max(self._now_s, now_s)
        self.telemetry.clear_expired_signals(now_s)
        self.texts.add_overdue_texts(now_s, self.telemetry.time_s)
        self._update_link_state(now_s)
        for chain in self._chains:
            chain.continue_if_answered()
        self._chains = [c for c in self._chains if not c.request.is_done]
        self._connection.send_due_request(now_s, self.telemetry)
        hand = self.sticks.take_due_messages(
            now_s
        )  # first: a vehicle needs stick messages before it accepts manual flight
        if self._by_hand and not self.sticks.is_held:
            self.add_note("warning", "stick input lost; hover requested")
            self.release_sticks()
        out = (
            hand
            + self.commands.take_due_messages(now_s)
            + self._parameters.take_due_messages(now_s)
            + self.transfers.take_due_messages(now_s)
        )
        out += self.fence_transfers.take_due_messages(now_s)
        return out + self._control.take_due_messages(now_s, self.telemetry.commander_id)

    def store_link_quality(self, now_s: float, loss: float, rate_Hz: float) -> None:
        """Store the link quality: share of packets lost (1), message rate (Hz)."""
        self._loss, self._rate_Hz = loss, rate_Hz
        self._usual_rate_Hz = max(0.5 * self._usual_rate_Hz, rate_Hz)
        self.telemetry.store_link_quality(now_s, loss, rate_Hz)

    def switch_to_autopilot_component(self, component: int) -> None:
        """Replace the vehicle's component by the autopilot, if another component was heard first.

        Parameters
        ----------
        component : int
            MAV_COMPONENT; subsequent commands, parameters and missions go there.
        """
        text = f"component {component} is the autopilot of system {self.system}, not component {self.component}"
        for chain in self._chains:
            chain.request.set_outcome(RequestOutcome.REFUSED, text)
        for part in (self.commands, self._parameters, self.transfers, self.fence_transfers):
            part.end_open_requests(text)
        self.telemetry.switch_component()
        self._reached = -1
        self._switch_target_component(component)
        self.add_note("warning", text)

    def handle_new_address(self) -> None:
        """Request the message streams again, after a change of the vehicle's address."""
        self._connection.request_streams_again()

    def cancel_actions_after_stall(self, seconds: float) -> None:
        """Cancel open actions after a stall of the station (s).

        The sticks are released too: the vehicle's own time-out has ended manual flight.
        """
        why = f"not executed: the station stalled for {seconds:.0f} s"
        self._cancel_chains_and_actions(why, stops=True)
        self._cancel_parameter_and_mission_changes(why)
        self.sticks.release_sticks()
        self._by_hand = False
        self.add_note(
            "warning",
            f"the station stalled for {seconds:.1f} s; open requests are cancelled",
        )

    def _cancel_parameter_and_mission_changes(self, why: str) -> None:
        self._parameters.cancel_writes(why)
        self.transfers.cancel_changes(why)
        self._control.end_open_request(why)

    def _cancel_actions_if_vehicle_silent(self, now_s: float) -> None:
        """Cancel open actions, except emergency stops, after a silence that random packet loss does not explain.

        A repeated action would otherwise be executed whenever the link returns.
        """
        silent_s = now_s - self._heard_s
        usual_s = _CANCEL_AFTER_MISSED_MESSAGES / self._usual_rate_Hz if self._usual_rate_Hz > 0.0 else LOST_TIMEOUT_S
        if math.isfinite(silent_s) and silent_s >= min(LOST_TIMEOUT_S, max(MAX_REQUEST_AGE_S, usual_s)):
            why = f"not executed: no message from the vehicle for {silent_s:.1f} s"
            self._cancel_chains_and_actions(why)
            self._cancel_parameter_and_mission_changes(why)

    def _update_link_state(self, now_s: float) -> None:
        self._cancel_actions_if_vehicle_silent(now_s)
        lost = now_s - self._heard_s >= LOST_TIMEOUT_S
        if lost and not self._lost:
            self.add_note("warning", f"{self.display_name}: communication lost")
        elif self._lost and not lost:
            self.add_note("info", f"{self.display_name}: communication regained")
            self._connection.request_streams_again()
        self._lost = lost
        if self.telemetry.clock.restart_count != self._restarts:
            self._restarts = self.telemetry.clock.restart_count
            self.add_note("warning", f"{self.display_name} has restarted")
            for part in (self.commands, self._parameters, self.transfers, self.fence_transfers):
                part.end_open_requests("the vehicle has restarted")
            self._reached = -1
            self._connection.restart_setup()

    def _handle_mission_current(self, message: MavMessage) -> None:
        if message.seq < self._reached:
            self._reached = -1  # the mission restarts, or another one begins
        items = self.transfers.items
        if items is None or not message.total or self.transfers.is_busy:  # total 0: not supported
            return
        total = 0 if message.total == _NO_MISSION_ITEM else message.total
        # ArduPilot's first item is its home, which this total omits.
        own = 1 if self.telemetry.autopilot == MAV_AUTOPILOT_ARDUPILOT else 0
        if total != max(0, len(items) - own):
            self.transfers.download_items()  # another station has sent a mission

    @property
    def _own_station_number(self) -> int:
        return self.own_ids[0] * 256 + self.own_ids[1]


def _refused_request(text: str, answer: str) -> OperatorRequest:
    return OperatorRequest(text, RequestOutcome.REFUSED, answer)
