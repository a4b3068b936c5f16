"""What a station asks until it is answered, message by message on a clock that the test steps."""

import math
from itertools import pairwise

import pytest

from mufly.link import Command, GlobalOrigin, mavlink
from mufly.station import RequestOutcome
from mufly.station.remote import autopilots
from mufly.station.remote.autopilots import identify_firmware, select_action_commands
from mufly.station.remote.remote_commands import (
    MAX_COMMAND_TRIES,
    PROGRESS_TIMEOUT_S,
    REFUSAL_REASON_WAIT_S,
    RETRY_PERIOD_S,
    OperatorControlClient,
    RemoteCommands,
    StatusTextLog,
)
from mufly.vehicle_types import ardupilot_family, flight_mode_name, vehicle_shape

LAND = Command(21)


def asked():
    """Commands of a station, with one that was sent at 10 s."""
    texts = StatusTextLog()
    commands = RemoteCommands(texts, (1, 1))
    request = commands.request_command("land", LAND)
    assert [m.command for m in commands.take_due_messages(10.0)] == [21]
    return commands, texts, request


def ack(result, progress=255, number=21):
    return mavlink.MAVLink_command_ack_message(number, result, progress)


def test_a_command_is_repeated_counted_up_and_given_up():
    commands, _, request = asked()
    sent = [commands.take_due_messages(10.0 + 0.1 * k) for k in range(1, 120)]
    again = [(0.1 * k, m.confirmation) for k, out in enumerate(sent, 1) for m in out]
    assert [n for _, n in again] == list(range(1, MAX_COMMAND_TRIES))
    assert all(RETRY_PERIOD_S - 1e-6 < b - a < RETRY_PERIOD_S + 0.11 for (a, _), (b, _) in pairwise([(0.0, 0), *again]))
    assert (request.outcome, request.answer) == (
        RequestOutcome.TIMED_OUT,
        "no answer in 10 s; check the link",
    )


def test_what_is_in_progress_is_waited_for():
    commands, _, request = asked()
    commands.handle_command_ack(10.5, ack(mavlink.MAV_RESULT_IN_PROGRESS, 40))
    assert request.progress == pytest.approx(0.4)
    commands.handle_command_ack(11.0, ack(mavlink.MAV_RESULT_IN_PROGRESS, 100))
    assert request.progress == 1.0
    commands.handle_command_ack(12.0, ack(mavlink.MAV_RESULT_IN_PROGRESS, 255))  # not known
    assert request.progress == 1.0
    assert commands.take_due_messages(12.0 + PROGRESS_TIMEOUT_S - 0.1) == []  # it is not asked again meanwhile
    assert not request.is_done
    commands.take_due_messages(12.0 + PROGRESS_TIMEOUT_S + 0.1)
    assert (request.outcome, request.answer) == (
        RequestOutcome.TIMED_OUT,
        "started, but completion not reported",
    )


def test_a_refusal_waits_a_moment_for_its_reason():
    commands, _, request = asked()
    commands.handle_command_ack(10.5, ack(mavlink.MAV_RESULT_DENIED))
    commands.take_due_messages(10.5 + REFUSAL_REASON_WAIT_S - 0.1)
    assert not request.is_done
    commands.handle_command_ack(10.6, ack(mavlink.MAV_RESULT_ACCEPTED))  # a refusal stands
    commands.take_due_messages(10.5 + REFUSAL_REASON_WAIT_S + 0.01)
    assert (request.outcome, request.answer) == (RequestOutcome.REFUSED, "denied")
    commands, texts, request = asked()
    commands.handle_command_ack(10.5, ack(mavlink.MAV_RESULT_DENIED))
    texts.handle_status_text(10.6, 0.0, mavlink.MAVLink_statustext_message(4, b"not now"))
    commands.take_due_messages(10.61)
    assert (request.outcome, request.answer) == (RequestOutcome.REFUSED, "not now")


def test_command_is_taken_when_the_vehicle_answers_us_and_what_we_asked():
    control = OperatorControlClient(1, (250, 190))

    def answer(station, request, result):
        control.handle_control_answer(
            1.0, mavlink.MAVLink_change_operator_control_ack_message(station, request, result)
        )

    answer(250, 0, 0)  # nobody has asked
    for stranger in ((251, 0), (250, 1)):
        request = control.request_operator_control()
        (message,) = control.take_due_messages(1.0, 0)
        assert (message.target_system, message.control_request) == (1, 0)
        answer(*stranger, 0)
        assert not request.is_done
    answer(250, 0, 0)
    assert request.outcome is RequestOutcome.ACCEPTED
    request = control.release_operator_control()
    (message,) = control.take_due_messages(2.0, 0)
    assert message.control_request == 1
    answer(250, 1, 3)
    assert (request.outcome, request.answer) == (
        RequestOutcome.REFUSED,
        "another station has control and must release it",
    )


def test_every_autopilot_is_asked_in_its_own_way():
    """By MAVLink's meaning of the parameters; modes are those of PX4 and of ArduCopter."""
    firmwares = [identify_firmware(*who) for who in ((12, True), (12, False), (3, False), (18, False))]
    assert firmwares == ["mufly", "PX4", "ArduPilot", "other"]
    ours, px4, copter, other = (autopilots.make_take_off_command(f, 1.5) for f in firmwares)
    assert (ours.command_id, ours.frame, ours.params[6]) == (22, 1, -1.5)
    assert math.isnan(px4.params[6])  # it climbs to its parameter MIS_TAKEOFF_ALT
    assert (copter.params[6], other.params[6], copter.frame) == (1.5, 1.5, None)
    assert len(copter.params) == 7
    at = GlobalOrigin(47.0, 8.0, 400.0)
    ours, px4 = (autopilots.make_go_to_command(f, (3.0, -2.0, -1.5), math.nan, at) for f in ("mufly", "PX4"))
    assert (ours.frame, ours.params[4:]) == (1, (3.0, -2.0, -1.5))
    assert (px4.frame, px4.params[4:]) == (0, pytest.approx(at.to_global(3.0, -2.0, -1.5)))
    for order in (ours, px4):
        assert order.params[0] == -1.0  # at its own speed
        assert math.isnan(order.params[3])  # the nose as it likes
    assert px4.params[1] == 1.0  # whatever mode it is in
    assert "not reported its origin" in autopilots.make_go_to_command("PX4", (0, 0, -1), 0.0, None)
    interval = autopilots.make_message_interval_command
    assert [interval(30, rate).params[:2] for rate in (50.0, 0.0)] == [(30, 20_000.0), (30, -1.0)]
    assert (
        autopilots.ARM_COMMAND.params[0],
        autopilots.DISARM_COMMAND.params[0],
        autopilots.REBOOT_COMMAND.params[0],
    ) == (
        1.0,
        0.0,
        1.0,
    )
    assert autopilots.EMERGENCY_STOP_COMMAND.is_emergency_stop
    for table, words in (
        (autopilots.PAUSE_COMMANDS, {"PX4": "hold", "ArduPilot": "brake"}),
        (autopilots.MANUAL_CONTROL_COMMANDS, {"PX4": "position control", "ArduPilot": "loiter"}),
        (autopilots.RELEASE_STICKS_COMMANDS, {"PX4": "hold", "ArduPilot": "brake"}),
        (autopilots.RETURN_COMMANDS, {"ArduPilot": "return"}),
        (autopilots.LAND_COMMANDS, {"ArduPilot": "landing"}),
        (autopilots.START_MISSION_COMMANDS, {"PX4": "mission", "ArduPilot": "auto"}),
        (autopilots.PRE_ARM_COMMANDS, {"ArduPilot": "guided"}),
    ):
        for firmware, word in words.items():
            base, main, sub = select_action_commands(table, firmware)[-1].params[:3]
            number = int(main) << 16 | int(sub) << 24 if firmware == "PX4" else int(main)
            assert int(base) == 1
            assert base == 1.0
            assert flight_mode_name({"PX4": 12, "ArduPilot": 3}[firmware], 2, 1, number) == word


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (
            1,
            {
                "START_MISSION_COMMANDS": "auto",
                "PAUSE_COMMANDS": "loiter",
                "MANUAL_CONTROL_COMMANDS": "fly by wire A",
                "RETURN_COMMANDS": "return",
            },
        ),
        (
            10,
            {
                "START_MISSION_COMMANDS": "auto",
                "PAUSE_COMMANDS": "hold",
                "RELEASE_STICKS_COMMANDS": "hold",
                "RETURN_COMMANDS": "return",
            },
        ),
        (12, {"START_MISSION_COMMANDS": "auto", "PAUSE_COMMANDS": "position hold"}),
        (7, {"PAUSE_COMMANDS": "loiter", "LAND_COMMANDS": "landing", "RETURN_COMMANDS": "return"}),
    ],
)
def test_every_ardupilot_is_asked_for_a_mode_of_its_own(kind: int, words: dict[str, str]) -> None:
    """A copter's mode 3 is "auto", a plane's is "training": numbers of another firmware are never sent."""
    family = ardupilot_family(kind)
    for name, word in words.items():
        commands = select_action_commands(getattr(autopilots, name), "ArduPilot", family)
        assert flight_mode_name(3, kind, 1, int(commands[-1].params[1])) == word
    for name in {"PRE_ARM_COMMANDS", "LAND_COMMANDS"} - set(words):
        assert "has no flight mode for this" in select_action_commands(getattr(autopilots, name), "ArduPilot", family)
    assert "of this type" in select_action_commands(autopilots.PAUSE_COMMANDS, "ArduPilot", "")


@pytest.mark.parametrize(
    ("autopilot", "kind", "mode", "words"),
    [
        (12, 2, 4 << 16 | 5 << 24, "return"),
        (12, 2, 6 << 16, "offboard"),
        (12, 2, 4 << 16 | 99 << 24, "auto 99"),
        (12, 2, 99 << 16, "mode 99"),
        (12, 2, 0, ""),
        (3, 2, 8, "mode 8"),  # a number that it gave up
        (3, 4, 5, "loiter"),
        (3, 1, 5, "fly by wire A"),  # of an aeroplane
        (3, 10, 4, "hold"),
        (3, 12, 19, "manual"),
        (3, 0, 5, "mode 5"),
        (18, 2, 5, "mode 5"),
    ],
)
def test_modes_have_the_words_of_their_autopilot(autopilot, kind, mode, words):
    assert flight_mode_name(autopilot, kind, 1, mode) == words
    assert flight_mode_name(autopilot, kind, 0, mode) == ""


def test_a_vehicle_is_drawn_as_what_its_type_says() -> None:
    types = (1, 2, 3, 4, 10, 11, 12, 13, 14, 15, 19, 0, 99)
    assert [vehicle_shape(t) for t in types] == [
        "plane", "quadrotor", "coaxial", "helicopter", "rover", "boat", "submarine", "hexarotor", "octorotor",
        "tricopter", "plane", "block", "block",
    ]  # fmt: skip
