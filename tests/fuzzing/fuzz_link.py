"""Bad messages to the vehicle's end of the link, in flight: check safety, outputs and memory.

``beside``: a station commands a flight (take off, go to places, land, again and again) while other senders send the
traffic of :mod:`hostile_traffic`. Their messages must not move the helicopter, so they leave out the emergency stop,
which a vehicle obeys from every sender.

``commander``: the hostile sender has the command; every second cycle includes emergency stops. It may fly the
helicopter into the ground. It must not raise an error, drive an output out of range or run unarmed motors. After a
landing or a crash the helicopter is reset and takes off again; the hostile sender is silent during the take-off.

Messages come slowly, fast and in floods by turns (:data:`RATES`), because a single message takes time to show.

After every controller period the checks are: actuators finite, motors within 0..1, servos within -1..1, motors at zero
when not armed, references of height and tilt bounded. Time is simulated. `tests/link/test_fuzz.py` runs it.
"""

from __future__ import annotations

import gc
import math
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from hostile_traffic import Hostile

from mufly.flight import Flight
from mufly.link import FrameDecoder, FrameEncoder, Peer, VehicleLink, mavlink
from mufly.mission import MAX_HEIGHT_M, Mission

FORCED = 21196  # MAVLink's magic number of a forced disarm, the emergency stop
STATION = Peer("udpin:127.0.0.1:14550", "127.0.0.1:50000")
PLACES = ((0.8, 0.0, -1.0), (0.8, 0.8, -1.3), (0.0, 0.8, -0.8), (0.0, 0.0, -1.0))
RATES = (0.02, 0.2, 4.0, 40.0)
"""Messages in a period of the controllers, one rate after the other."""

TURN = 2000
"""For how many periods each rate lasts."""

FLIGHT_S = 60.0
"""How long the station flies before it lands and takes off again (s)."""

TILT_MOST_RAD = math.radians(15.01)
"""Bound of the tilt references: the greatest CTL_TILT_MAX and STK_TILT that the parameters may be given."""


@dataclass
class Findings:
    """What a run has seen.

    Attributes
    ----------
    messages, bytes_in, bytes_out : int
    ticks, seconds : int, float
        Periods of the controllers, and simulated time (s).
    peers : int
        How many were sent to.
    faults : list of str
        What must not happen and did; empty if all is well.
    motor, servo, tilt_ref_rad, height_ref_m : (float, float)
        Least and greatest that was seen.
    armed_s : float
        Time armed (s).
    unarmed : int
        Periods since it was armed.
    flights : int
        How often it has flown.
    off_m : float
        Beside a station: how far the helicopter was from the place that it was sent to, once it was there.
    rss_MB : list of (int, float)
        Memory of the process after so many messages.
    kinds, answers : Counter
        Packets by kind; messages that came back by name.
    """

    messages: int = 0
    bytes_in: int = 0
    bytes_out: int = 0
    ticks: int = 0
    faults: list[str] = field(default_factory=list)
    motor: tuple[float, float] = (math.inf, -math.inf)
    servo: tuple[float, float] = (math.inf, -math.inf)
    tilt_ref_rad: float = 0.0
    seconds: float = 0.0
    peers: int = 0
    height_ref_m: tuple[float, float] = (math.inf, -math.inf)
    armed_s: float = 0.0
    unarmed: int = 0
    flights: int = 0
    off_m: float = 0.0
    rss_MB: list[tuple[int, float]] = field(default_factory=list)
    kinds: Counter[str] = field(default_factory=Counter)
    answers: Counter[str] = field(default_factory=Counter)


def rss_MB() -> float:
    """Memory that this process holds."""
    gc.collect()
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:  # not Linux
        return math.nan
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def harmless(name: str, fields: dict[str, Any]) -> bool:
    """Leave out what a vehicle rightly obeys whoever says it: the emergency stop."""
    if name not in ("COMMAND_LONG", "COMMAND_INT"):
        return True
    command = fields["command"]
    return command != mavlink.MAV_CMD_DO_FLIGHTTERMINATION and not (
        command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and round_or_none(fields["param2"]) == FORCED
    )


def round_or_none(x: float) -> int | None:
    return round(x) if math.isfinite(x) else None


class Pilot:
    """A station that flies places by set-points, lands, and begins again; it says each thing until it is so."""

    def __init__(self, link: VehicleLink, flight: Flight, found: Findings) -> None:
        self._link, self._flight, self._found = link, flight, found
        self._encode = FrameEncoder(255, 190)
        self._codec = FrameDecoder()
        self._places = cycle(PLACES)
        self._place = next(self._places)
        self._beat_s = self._ask_s = self._began_s = -math.inf
        self._there_s = math.inf
        self.landing = False

    def _say(self, now_s: float, message: Any) -> None:
        data = self._encode(message)
        self._found.bytes_in += len(data)
        self._link.process_bytes(now_s, STATION, data)

    def _ask(self, now_s: float, command: int, *parameters: float) -> None:
        filled = (*parameters, *([0.0] * (7 - len(parameters))))
        self._say(now_s, mavlink.MAVLink_command_long_message(1, 1, command, 0, *filled))

    def step(self, now_s: float) -> None:
        """Say what is due."""
        if now_s - self._beat_s > 1.0:
            self._beat_s = now_s
            gcs = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID
            self._say(now_s, mavlink.MAVLink_heartbeat_message(*gcs, 0, 0, 0, 3))
        if now_s - self._ask_s < 0.2:
            return
        self._ask_s = now_s
        status = self._flight.status
        if self.landing:
            if not status.armed:
                self.landing = False
                self._found.flights += 1
            elif status.state != "landing":
                self._ask(now_s, mavlink.MAV_CMD_NAV_LAND)
            return
        if not status.armed:
            self._began_s = now_s
            self._there_s = math.inf
            if status.battery_left_s < 2.0 * FLIGHT_S:
                self._ask(now_s, mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
            else:
                self._ask(now_s, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        elif not status.flying or status.state == "take-off":
            nan = math.nan
            self._ask(now_s, mavlink.MAV_CMD_NAV_TAKEOFF, nan, nan, nan, nan, nan, nan, 1.0)
        elif now_s - self._began_s > FLIGHT_S:
            self.landing = True
        else:
            self._to(now_s, status.truth.position)

    def _to(self, now_s: float, position: Any) -> None:
        off = math.dist(position, self._place)
        if off < 0.1:
            self._there_s = min(self._there_s, now_s)
        if now_s - self._there_s > 4.0:
            self._place, self._there_s = next(self._places), math.inf
        elif now_s - self._there_s > 2.0:  # it has settled; from here on nobody else moves it
            self._found.off_m = max(self._found.off_m, off)
        north, east, down = self._place
        target = mavlink.MAVLink_set_position_target_local_ned_message
        self._say(now_s, target(0, 1, 1, 1, 0x0DF8, north, east, down, *([0.0] * 8)))
        if self._flight.autopilot.status.state != "offboard":
            self._ask(now_s, mavlink.MAV_CMD_DO_SET_MODE, 1, 6)


def restart(flight: Flight) -> None:
    """Put it back to the start, armed and taking off, whatever has become of it."""
    flight.reset()
    flight.autopilot.arm()
    flight.autopilot.take_off(1.0)


def check(flight: Flight, found: Findings) -> None:
    """Judge one period; writes down what must not be, and the extremes that were seen."""
    status = flight.autopilot.status
    motors, servos = (
        flight.acting_actuators.motor_input.tolist(),
        flight.acting_actuators.servo_input.tolist(),
    )
    height, tilt = -float(status.reference_position[2]), np.abs(status.reference_attitude[:2]).tolist()
    wrong = []
    if not all(map(math.isfinite, (*motors, *servos))):
        wrong.append(f"actuators {motors} {servos}")
    if min(motors) < 0.0 or max(motors) > 1.0 or max(map(abs, servos)) > 1.0:
        wrong.append(f"actuators out of range {motors} {servos}")
    # What acts now was computed one period ago.
    found.unarmed = 0 if status.armed else found.unarmed + 1
    if found.unarmed > 2 and motors != [0.0, 0.0]:
        wrong.append(f"motors {motors} but not armed")
    if not (math.isfinite(height) and -1.5 <= height <= MAX_HEIGHT_M + 1.0):
        wrong.append(f"height reference {height}")
    if not all(math.isfinite(t) and t <= TILT_MOST_RAD for t in tilt):
        wrong.append(f"tilt reference {tilt}")
    found.faults += [f"{what} at {flight.time_s:.3f} s, state {status.state}" for what in wrong]
    found.motor = min(found.motor[0], *motors), max(found.motor[1], *motors)
    found.servo = min(found.servo[0], *servos), max(found.servo[1], *servos)
    found.height_ref_m = min(found.height_ref_m[0], height), max(found.height_ref_m[1], height)
    found.tilt_ref_rad = max(found.tilt_ref_rad, *tilt)
    found.armed_s += flight.period_s * status.armed
    found.ticks += 1


def fuzz(
    messages: int,
    seed: int,
    commander: bool,
    *,
    rates: Sequence[float] = RATES,
    turn: int = TURN,
    others: int = 5,
    samples: int = 20,
) -> Findings:
    """Send so many bad messages to a helicopter in flight.

    Parameters
    ----------
    messages : int
    seed : int
    commander : bool
        Whether the hostile one commands, or is one beside a station that does.
    rates, turn : sequence of float, int
        Messages in a period of the controllers, one rate after the other, each for ``turn`` periods.
    others : int
        From how many addresses the bad messages come, beside a station.
    samples : int
        How often the memory is looked at.
    """
    found, wild, started = Findings(), False, False
    flight = Flight("mufly-1.1", Mission(), keep=False, seed=seed)
    link = VehicleLink(flight, origin=None)
    hostile = Hostile(
        seed,
        parameters=[*flight.autopilot.parameters, "COM_DL_LOSS_T", "COM_DL_LAND_T"],
        senders=((66, 190), (66, 190), (66, 190), (67, 190), (255, 190)) if not commander else ((66, 190),),
        allowed=lambda name, fields: wild or harmless(name, fields),
    )
    peers = [Peer("udpin:127.0.0.1:14550", f"127.0.0.1:{50001 + k}") for k in range(1 if commander else others)]
    packets, pilot = hostile.packets(), None if commander else Pilot(link, flight, found)
    answers = FrameDecoder()
    next_sample, due, now_s, grounded_s = 0, 0.0, 0.0, 0.0
    while found.messages < messages and len(found.faults) < 20:
        if found.messages >= next_sample:
            found.rss_MB.append((found.messages, rss_MB()))
            next_sample += max(1, messages // samples)
        cycle_, part = divmod(found.ticks // turn, len(rates))
        wild = commander and cycle_ % 2 == 1
        taking_off = commander and started and not flight.autopilot.status.flying and grounded_s < 6.0
        due += 0.0 if taking_off else rates[part]
        while due > 0.0:
            packet = next(packets)
            due -= packet.messages
            found.messages += packet.messages
            found.bytes_in += len(packet.data)
            found.kinds[packet.kind] += 1
            link.process_bytes(now_s, peers[found.messages % len(peers)], packet.data)
        if pilot is not None:
            pilot.step(now_s)
        flight.step_period()
        check(flight, found)
        for out in link.take_due_frames(now_s):
            found.bytes_out += len(out.data)
            if found.ticks % 50 == 0:
                found.answers.update(m.get_type() for m in answers.decode_bytes(now_s, out.peer, out.data))
        now_s += flight.period_s
        if commander:
            grounded_s = 0.0 if flight.autopilot.status.flying else grounded_s + flight.period_s
            started = started and not flight.autopilot.status.flying
            if grounded_s > (6.0 if started else 1.0) or flight.plant.crash_cause:
                found.flights += 1
                grounded_s, started = 0.0, True
                restart(flight)
        elif flight.plant.crash_cause:
            found.faults.append(f"crashed: {flight.plant.crash_cause} at {flight.time_s:.1f} s")
            break
    found.rss_MB.append((found.messages, rss_MB()))
    found.seconds, found.peers = now_s, len(peers) + (pilot is not None)
    return found


def growth_MB(samples: Sequence[tuple[int, float]]) -> float:
    """How much memory the second half of a run has added: the first half may warm up."""
    half = [mb for n, mb in samples if n >= samples[-1][0] / 2]
    return half[-1] - half[0]


def quiet_kB_s(seconds: float = 10.0) -> float:
    """What a peer is sent that says nothing but that it is there, for comparison (kB/s)."""
    flight = Flight("mufly-1.1", Mission(), keep=False)
    link = VehicleLink(flight)
    encode, now_s, sent = FrameEncoder(255, 190), 0.0, 0
    for tick in range(round(seconds / flight.period_s)):
        if tick % 250 == 0:
            link.process_bytes(now_s, STATION, encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)))
        flight.step_period()
        sent += sum(len(out.data) for out in link.take_due_frames(now_s))
        now_s += flight.period_s
    return sent / now_s / 1e3


def report(name: str, found: Findings) -> None:
    """Print the findings of a run; ``pytest -s`` shows them."""
    m, s, h = found.motor, found.servo, found.height_ref_m
    print(f"\n{name}: {found.messages} messages in {found.ticks} periods")
    print(f"  motors, servos      {m[0]:.3f} to {m[1]:.3f}, {s[0]:.3f} to {s[1]:.3f}")
    print(f"  height reference    {h[0]:.2f} to {h[1]:.2f} m")
    print(f"  tilt reference      at most {math.degrees(found.tilt_ref_rad):.1f} deg")
    print(f"  armed               {found.armed_s:.0f} s, {found.flights} flights")
    if name == "beside":
        print(f"  position error      {1e3 * found.off_m:.1f} mm at most, once settled")
    each = found.bytes_out / found.seconds / found.peers / 1e3
    print(f"  traffic             {found.bytes_in / 1e6:.1f} MB in, {found.bytes_out / 1e6:.1f} MB out in "
          f"{found.seconds:.0f} s to {found.peers} peers: {each:.1f} kB/s each")  # fmt: skip
    print(f"  a quiet peer is sent {quiet_kB_s():.1f} kB/s")
    print(f"  memory              {found.rss_MB[0][1]:.1f} MB at first, {found.rss_MB[-1][1]:.1f} MB at the end, "
          f"{growth_MB(found.rss_MB):+.2f} MB in the second half")  # fmt: skip
    print(f"  packets             {dict(found.kinds)}")
    print(f"  answers (1 of 50)   {dict(found.answers.most_common(12))}")
