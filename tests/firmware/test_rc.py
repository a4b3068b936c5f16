"""Receivers of a pilot's transmitter: CRSF and SBUS by their published layout, sticks, switches, loss."""

from __future__ import annotations

import shutil
import socket

import numpy as np
import pytest
from board_station import Station
from pymavlink.dialects.v20 import common as mavlink

from mufly.control import design_flight_controller
from mufly.firmware import describe_missing_tools
from mufly.firmware.emulated import HostBoard
from mufly.firmware.emulated.board_flight import BoardEstimator, make_board_software
from mufly.firmware.emulated.board_link import run_linked_board
from mufly.firmware.emulated.image_build import build_host_board
from mufly.flight import Flight
from mufly.flight.tunable_parameters import StickRanges
from mufly.link.steering_input import parse_rc_override
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler: install gcc or clang"
)
MIDDLE, LOW, HIGH = 992, 172, 1811
FRAME_LOST, FAILSAFE = 4, 8


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def library(vehicle):
    return build_host_board(vehicle, design_flight_controller(vehicle), load_mission("demonstration"), single=False)


# An encoder of both formats, from their description alone


def _pack(channels) -> bytes:
    return sum(int(c) << 11 * k for k, c in enumerate(channels)).to_bytes(22, "little")


def _crc8(data) -> int:
    """Remainder of the polynomial division by x^8 + x^7 + x^6 + x^4 + x^2 + 1 (DVB-S2)."""
    bits = int.from_bytes(data + b"\0", "big")
    for k in range(bits.bit_length() - 1, 7, -1):
        if bits >> k & 1:
            bits ^= 0x1D5 << (k - 8)
    return bits


def _crsf(payload, kind=0x16, sync=0xC8) -> bytes:
    body = bytes([kind]) + payload
    return bytes([sync, len(body) + 1]) + body + bytes([_crc8(body)])


def _sbus(channels, flags=0, end=0) -> bytes:
    return b"\x0f" + _pack(channels) + bytes([flags, end])


def _statistics(quality) -> bytes:
    return _crsf(bytes([60, 60, quality, 10, 0, 2, 3, 50, 100, 10]), 0x14)


class Decoder:
    def __init__(self, library, kind) -> None:
        self.ffi, self.lib = library
        self.record = self.ffi.new("rc_decoder_t *", {"kind": getattr(self.lib, kind)})

    def feed(self, data) -> list[tuple[int, ...]]:
        """Return the channels of each frame that the bytes complete."""
        return [tuple(self.record.channel) for byte in data if self.lib.rc_decode(self.record, byte)]


def _channels(rng) -> tuple[int, ...]:
    return tuple(rng.integers(0, 2048, 16).tolist())


def test_crsf_frames_are_read_and_found_again_after_noise(library) -> None:
    published = bytes.fromhex("c81816e0031ff8c0073ef0810f7ce0031ff8c0073ef0810f7cad")  # all channels at 1500 us
    assert _crsf(_pack([MIDDLE] * 16)) == published
    assert Decoder(library, "RC_CRSF").feed(published) == [(MIDDLE,) * 16]
    rng, d = np.random.default_rng(1), Decoder(library, "RC_CRSF")
    sent, found = [], []
    for n in range(400):
        channels = _channels(rng)
        frame = _crsf(_pack(channels), sync=0xEE if n % 7 == 0 else 0xC8)
        if n % 3 == 1:  # a bit is wrong, or a byte is missing
            at = int(rng.integers(len(frame)))
            cut = n % 2 == 0
            frame = frame[:at] + (b"" if cut else bytes([frame[at] ^ 1 << int(rng.integers(8))])) + frame[at + 1 :]
        else:
            sent.append(channels)
        noise = bytes(rng.integers(0, 256, int(rng.integers(0, 9)), dtype=np.uint8))
        found += d.feed(noise + frame + (_crsf(b"\x01\x02\x03", 0x08) if n % 5 == 0 else b""))
    found += d.feed(bytes(64))
    # A checksum of 8 bits lets one in 256 spoilt frames pass.
    assert [f for f in found if f in sent] == sent
    assert len(sent) <= len(found) == d.record.frame_count <= len(sent) + 2
    # The link's quality of 0 % is a failsafe, and ends with another value.
    for quality, failsafe in ((0, True), (80, False)):
        assert d.feed(_statistics(quality)) == []
        assert d.record.failsafe == failsafe
    for wrong in (_crsf(_pack([MIDDLE] * 16) + b"\0"), b"\xc8\x01\x16", b"\xc8\xff" + bytes(64)):
        assert Decoder(library, "RC_CRSF").feed(wrong) == []
    assert Decoder(library, "RC_NONE").feed(published) == []


def test_sbus_frames_are_read_with_their_flags(library) -> None:
    rng, d = np.random.default_rng(2), Decoder(library, "RC_SBUS")
    last = None
    for n in range(300):
        channels, flags = _channels(rng), (0, FRAME_LOST, FAILSAFE | FRAME_LOST, 3)[n % 4]
        end = (0x00, 0x04, 0x14, 0x24, 0x34)[n % 5]
        noisy = n % 10 == 0
        found = d.feed((b"\x55\x0f\x01" if noisy else b"") + _sbus(channels, flags, end))
        # Without a checksum the first frame after other bytes does not count.
        if noisy:
            assert channels not in found
            d.feed(_sbus(channels, flags, end))
            found = d.feed(_sbus(channels, flags, end))
        assert found == [channels], n
        last = channels
        assert (d.record.frame_lost, d.record.failsafe) == (bool(flags & FRAME_LOST), bool(flags & FAILSAFE))
    for spoilt in (_sbus(last, 0x10), _sbus(last, 0, 0x01), _sbus(last, 0, 0x0F)):
        assert d.feed(spoilt) == []
    # Random bytes hardly ever make two frames in a row.
    assert len(Decoder(library, "RC_SBUS").feed(rng.bytes(200_000))) < 3


class Pilot(Station):
    """A board with a receiver, its estimates from outside."""

    def __init__(self, library, kind="RC_CRSF") -> None:
        super().__init__(library)
        self.lib.rc_start(self.ffi.addressof(self.board.record, "rc"), getattr(self.lib, kind))
        self.channels = [MIDDLE] * 16
        self.channels[4:7] = [LOW] * 3
        self.is_sbus = kind == "RC_SBUS"

    def move(self, frames=4, flags=0, **levers) -> None:
        """Move sticks and switches; so many frames follow."""
        numbers = {"roll": 0, "pitch": 1, "throttle": 2, "yaw": 3, "arm": 4, "manual": 5, "kill": 6}
        for name, value in levers.items():
            self.channels[numbers[name]] = value
        for _ in range(frames):
            self.receive(_sbus(self.channels, flags) if self.is_sbus else _crsf(_pack(self.channels)))

    def receive(self, data) -> None:
        rc = self.board.record.rc
        self.ffi.memmove(rc.input, data, len(data))
        rc.input_count = len(data)
        self.step()
        rc.input_count = 0

    def ready(self) -> None:
        """Let the vehicle stand with a valid estimate, as far as the supervisor asks."""
        self.board.record.rc.was_heard = False
        original = self.board.compute_control

        def compute_control(request):
            m = self.board.record.belief
            m.valid, m.motion.voltage, m.specific_force = True, 8.0, [0.0, 0.0, -9.81]
            for quantity in (m.motion.position, m.motion.velocity, m.motion.attitude, m.motion.rates):
                quantity[0:3] = [0.0, 0.0, 0.0]
            s = self.board.record.supervisor
            m.motion.position[2] = -s.floor_m - s.settings.standing_m
            original(request)

        self.board.compute_control = compute_control


@pytest.mark.parametrize("kind", ["RC_CRSF", "RC_SBUS"])
def test_sticks_are_those_of_the_simulated_link(library, kind) -> None:
    s, rng, ranges = Pilot(library, kind), np.random.default_rng(3), StickRanges()
    s.ready()
    s.move(manual=HIGH)
    for n in range(200):
        raw = rng.integers(0, 2048, 4) if n % 2 else rng.integers(MIDDLE - 40, MIDDLE + 40, 4)
        s.channels[:4] = raw.tolist()
        s.move(1)
        pulses = [1500 + (int(v) - MIDDLE) * 5 / 8 for v in raw]
        message = mavlink.MAVLink_rc_channels_override_message(1, 1, *pulses, *[0] * 4)
        d = parse_rc_override(message)
        sticks = s.board.record.supervisor.sticks
        assert s.board.record.supervisor.has_sticks
        assert (sticks.pilot_roll, sticks.pilot_pitch) == (d.roll * ranges.tilt, d.pitch * ranges.tilt)
        assert (sticks.pilot_yaw_rate, sticks.pilot_climb_rate) == (d.yaw * ranges.yaw_rate, d.climb * ranges.climb)
    # The switch off releases them; another mapping moves them.
    s.move(manual=LOW)
    assert not s.board.record.supervisor.has_sticks
    s.board.record.rc.settings.roll, s.board.record.rc.settings.yaw = 4.0, 0.0
    s.move(manual=HIGH, roll=MIDDLE, pitch=MIDDLE, throttle=MIDDLE, yaw=HIGH)
    sticks = s.board.record.supervisor.sticks
    assert (sticks.pilot_roll, sticks.pilot_yaw_rate) == (pytest.approx(ranges.tilt), 0.0)
    s.board.record.rc.settings.switches[s.lib.RC_SWITCH_MANUAL] = 0.0  # without a switch, sticks count always
    s.move(manual=LOW)
    assert s.board.record.supervisor.has_sticks


def test_the_arm_switch_arms_only_when_moved_and_the_kill_switch_stops(library) -> None:
    s = Pilot(library)
    s.ready()
    supervisor = s.board.record.supervisor
    s.move(arm=HIGH, frames=20)
    assert not supervisor.armed  # on since the start
    s.move(arm=LOW)
    s.move(arm=HIGH, frames=2)
    assert not supervisor.armed  # two frames are no position of a switch
    s.move(arm=HIGH, frames=2)
    assert supervisor.armed
    s.move(arm=LOW)
    assert not supervisor.armed
    s.move(arm=HIGH)
    s.move(kill=HIGH)
    assert not supervisor.armed
    s.move(arm=LOW)
    s.move(arm=HIGH)
    assert not supervisor.armed  # no arming while the kill switch is on
    s.move(kill=LOW)
    assert not supervisor.armed
    s.move(arm=LOW)
    supervisor.interruption, supervisor.interruption_told = s.lib.INTERRUPTION_RESET, False
    s.heard.clear()
    s.move(arm=HIGH)
    for _ in range(5):
        s.step()
    assert not supervisor.armed
    assert "interrupted" in " ".join(m.text for m in s.heard if m.get_type() == "STATUSTEXT")
    # The first request was told the reason, the next one acknowledges it.
    s.move(arm=LOW)
    s.move(arm=HIGH)
    assert supervisor.armed


def test_in_the_air_only_the_kill_switch_stops_the_motors(library) -> None:
    for switch, armed in (("arm", True), ("kill", False)):
        s = Pilot(library)
        s.ready()
        s.move()
        s.move(arm=HIGH)
        record, software = s.board.record, s.board.record.software
        assert record.supervisor.armed
        # It hovers 1 m above its start.
        software.mission.state, software.mission.has_taken_off = s.lib.STATE_HOVER, True
        software.motors = software.mission.motors = s.lib.MOTORS_FLY
        software.mission.home_position[2] = record.belief.motion.position[2] + 1.0
        software.is_lifted = True
        s.move()
        assert (record.supervisor.armed, software.motors) == (True, s.lib.MOTORS_FLY)
        s.move(**{switch: LOW if switch == "arm" else HIGH})
        for _ in range(8):
            s.step()
        assert record.supervisor.armed == armed, switch
        assert software.motors == (s.lib.MOTORS_FLY if armed else s.lib.MOTORS_OFF)
        assert record.supervisor.interruption == (s.lib.INTERRUPTION_NONE if armed else s.lib.INTERRUPTION_STOPPED)


def test_a_silent_receiver_and_its_failsafe_release_the_sticks(library) -> None:
    for how in ("silence", "flag", "lost frames"):
        s = Pilot(library, "RC_SBUS")
        s.ready()
        s.move(manual=HIGH, roll=HIGH)
        assert s.board.record.supervisor.has_sticks
        periods = 0
        while s.board.record.supervisor.has_sticks:
            if how == "silence":
                s.step()
            else:
                s.move(1, FRAME_LOST if how == "lost frames" else FAILSAFE)
            periods += 1
        assert periods <= 2 if how == "flag" else 100 <= periods <= 103, how
        assert not s.board.record.rc.is_alive
        s.move(roll=LOW)
        assert s.board.record.supervisor.has_sticks
    s = Pilot(library)
    s.ready()
    s.move(manual=HIGH)
    s.receive(_statistics(0))
    assert not s.board.record.supervisor.has_sticks
    s.move(20)
    assert not s.board.record.supervisor.has_sticks
    s.receive(_statistics(99))
    s.move()
    assert s.board.record.supervisor.has_sticks


def test_frames_of_another_length_and_channels_beyond_the_last_count_for_nothing(library) -> None:
    d = Decoder(library, "RC_CRSF")
    d.record.failsafe = True
    for payload in (bytes(9), bytes(11)):  # statistics have ten bytes
        assert d.feed(_crsf(payload, 0x14)) == []
    assert d.record.failsafe
    s = Pilot(library)
    s.ready()
    s.board.record.rc.settings.roll = 16.5  # no such channel
    s.channels[15] = HIGH
    s.move(manual=HIGH)
    assert s.board.record.supervisor.sticks.pilot_roll == 0.0
    s.board.record.rc.settings.roll = 16.0
    s.move()
    assert s.board.record.supervisor.sticks.pilot_roll > 0.1


def test_a_lost_receiver_lands_the_vehicle_only_in_the_air_and_without_a_commander(library) -> None:
    s = Pilot(library)
    ffi, lib, record = s.ffi, s.lib, s.board.record
    supervisor, software, belief = (ffi.new(f"{name}_t *") for name in ("supervisor", "software", "estimate"))
    setup = ffi.addressof(lib, "mufly_setup")
    vehicle = ffi.new("rc_vehicle_t *", {
        "supervisor": supervisor, "setup": setup, "software": software, "belief": belief
    })  # fmt: skip
    mission, loss_s, land_s = software.mission, 0.5, 2.0

    def lose(steers=True, height=1.0, commander_s=None, permitted=True, silent_s=loss_s + land_s + 0.3):
        """Return whether a landing is pending, and whether one is still owed, after so much silence."""
        lib.supervisor_start(supervisor, ffi.addressof(lib, "mufly_supervisor"), lib.INTERRUPTION_NONE)
        supervisor.settings.link_loss_s, supervisor.settings.link_land_s = 10.0, land_s
        rc = ffi.new("rc_t *", {"settings": record.rc.settings})
        rc.was_heard, rc.is_alive, rc.steers, rc.heard_s = True, True, steers, 5.0
        supervisor.armed = software.is_lifted = True
        software.motors = mission.motors = lib.MOTORS_FLY
        mission.state = lib.STATE_HOVER if permitted else lib.STATE_RC
        mission.has_taken_off, belief.motion.position[2] = True, -height
        for t in np.arange(5.0, 5.0 + silent_s, 0.1):
            supervisor.now_s = t
            if commander_s is not None:
                supervisor.has_commander, supervisor.commander_heard_s = True, t - commander_s
            lib.rc_step(rc, vehicle)
        return bool(supervisor.is_pending and supervisor.pending.land), bool(rc.owes_landing)

    assert lose() == (True, False)
    assert lose(silent_s=loss_s + land_s - 0.1) == (False, True)
    assert lose(steers=False) == (False, False)  # it flew by itself
    assert lose(height=0.01) == (False, False)  # on the floor
    assert lose(commander_s=1.0) == (False, False)  # a station decides
    assert lose(commander_s=11.0) == (True, False)  # and that one is silent too
    assert lose(permitted=False) == (False, True)  # asked again in the next period


def test_the_kill_switch_stops_a_disarmed_vehicle_whose_motors_still_run(library) -> None:
    s = Pilot(library)
    s.ready()
    s.move(arm=LOW)
    s.move(kill=HIGH)
    s.move(manual=HIGH)
    record = s.board.record
    assert record.rc.steers
    assert not record.supervisor.has_sticks  # the switch takes the sticks too
    record.supervisor.armed, record.software.motors = False, s.lib.MOTORS_RAMP_DOWN
    rc = s.ffi.addressof(record, "rc")
    vehicle = s.ffi.new("rc_vehicle_t *", {
        "supervisor": s.ffi.addressof(record, "supervisor"), "setup": s.ffi.addressof(s.lib, "mufly_setup"),
        "software": s.ffi.addressof(record, "software"), "belief": s.ffi.addressof(record, "belief"),
    })  # fmt: skip
    s.lib.rc_step(rc, vehicle)
    assert record.supervisor.is_pending
    assert record.supervisor.pending.motor_stop_reason == s.lib.STOP_EMERGENCY


def test_a_pilot_flies_and_a_lost_receiver_makes_it_hover_and_land(vehicle, library) -> None:
    """The whole loop on this machine: arm, climb by the stick, silence; the vehicle holds, lands, disarms."""
    controller, mission = design_flight_controller(vehicle), load_mission("demonstration")
    board = HostBoard(*library)
    record, lib, ffi = board.record, *library[::-1]
    channels = [MIDDLE] * 16
    channels[4:7] = [LOW, HIGH, LOW]
    heights: list[float] = []
    with Flight(
        vehicle, mission, controller=controller, keep=False, sensors="fitted", seed=3,
        estimator=BoardEstimator(board, vehicle, mission.world, controller.rate_Hz),
        controllers=make_board_software(board),
    ) as flight:  # fmt: skip
        flight.autopilot.software.commands_itself = True
        lib.rc_start(ffi.addressof(record, "rc"), lib.RC_SBUS)
        record.supervisor.settings.link_land_s = 3.0
        silent_s = None
        while flight.time_s < 40.0:
            t = flight.time_s
            if t > 3.0 and not record.supervisor.armed and silent_s is None:
                channels[4] = HIGH if int(t / 0.3) % 2 else LOW
            elif silent_s is None and record.supervisor.armed:
                height = -float(flight.truth.position[2])
                channels[2] = HIGH if height < 0.6 else MIDDLE
                if height >= 0.6:
                    channels[0] = MIDDLE + 200
                    silent_s = t + 0.5 if silent_s is None else silent_s
            rc = record.rc
            if silent_s is None or t < silent_s:
                frame = _sbus(channels)
                ffi.memmove(rc.input, frame, len(frame))
                rc.input_count = len(frame)
            flight.step_period()
            board.exchange_bytes(b"")
            rc.input_count = 0
            if silent_s is not None and t > silent_s:
                heights.append(-float(flight.truth.position[2]))
                if t < silent_s + 0.45:
                    assert record.software.mission.state == lib.STATE_RC
                elif silent_s + 1.0 < t < silent_s + 3.0:
                    assert record.software.mission.state == lib.STATE_HOVER
                if not record.supervisor.armed:
                    break
        assert silent_s is not None
        assert not flight.plant.crash_cause
        assert not record.supervisor.armed
    assert min(heights[:600]) > 0.4
    assert heights[-1] < 0.12


@pytest.mark.skipif(bool(describe_missing_tools()), reason=describe_missing_tools() or "-")
@pytest.mark.parametrize(("name", "encode"), [("crsf", lambda c: _crsf(_pack(c))), ("sbus", _sbus)])
def test_a_pilot_at_the_uart_of_the_emulated_board(vehicle, name, encode) -> None:
    """Switches arm and kill; a cut wire counts as a lost receiver; no byte of memory differs from this machine's."""
    with socket.socket() as a, socket.socket() as b:
        for one in (a, b):
            one.bind(("127.0.0.1", 0))
        port, receiver_port = a.getsockname()[1], b.getsockname()[1]
    channels, seen, wire = [MIDDLE] * 16, [], []
    channels[2], channels[4:7] = LOW, [LOW, LOW, LOW]
    sent = -1 if name == "sbus" else 0  # frames that count: without a checksum the first does not

    def stop(flight) -> bool:
        """Send the next frame when the board has decoded the last one: a busy machine takes long over each byte."""
        nonlocal sent
        board = flight.autopilot.software.board.record
        rc, frames = board.rc, board.rc.decoder.frame_count
        kills = bool(rc.is_on[1])
        seen.append((bool(rc.is_alive), bool(board.supervisor.armed), kills, frames))
        if not wire:
            wire.append(socket.create_connection(("127.0.0.1", receiver_port)))
        armed = [one[1] for one in seen[-2:]]
        if wire[0].fileno() < 0:
            return not seen[-1][0]
        if any(armed[:1]) and not armed[-1]:
            wire[0].close()  # no byte is under way
        elif len(seen) % 4 == 0 and frames == max(0, sent):
            if armed[-1]:
                channels[6] = HIGH
            elif flight.time_s > 3.0:
                channels[4] = HIGH if frames // 15 % 2 else LOW
            wire[0].sendall(encode(channels))
            sent += 1
        return flight.time_s > 100.0

    flown = run_linked_board(
        vehicle, load_mission("demonstration"), port=port, receiver=name, receiver_port=receiver_port, pace=0.0,
        stop=stop,
    )  # fmt: skip
    assert flown.mismatch_count == 0, flown.first_mismatch
    armed = [one[1] for one in seen]
    assert any(armed), ("the arm switch did not arm", sent, seen[-1])
    disarmed = armed.index(True) + armed[armed.index(True) :].index(False)
    assert seen[disarmed][2], "the kill switch did not disarm"
    assert not seen[-1][0], "the cut wire was not noticed"
    assert seen[-1][3] == sent > 20
    last_frame = [one[3] for one in seen].index(sent)
    assert 100 <= len(seen) - 1 - last_frame <= 102
