"""What a station asks until it is answered, message by message on a clock that the test steps."""

from itertools import pairwise

import pytest

from mufly.link import Command, mavlink
from mufly.station import Outcome
from mufly.station.commands import (
    PROGRESS_S,
    REASON_S,
    RETRY_S,
    TRIES,
    OperatorControl,
    RemoteCommands,
    StatusTexts,
)

LAND = Command(21)


def asked():
    """Commands of a station, with one that was sent at 10 s."""
    texts = StatusTexts()
    commands = RemoteCommands(texts, (1, 1))
    request = commands.ask("land", LAND)
    assert [m.command for m in commands.step(10.0)] == [21]
    return commands, texts, request


def ack(result, progress=255, number=21):
    return mavlink.MAVLink_command_ack_message(number, result, progress)


def test_a_command_is_repeated_counted_up_and_given_up():
    commands, _, request = asked()
    sent = [commands.step(10.0 + 0.1 * k) for k in range(1, 120)]
    again = [(0.1 * k, m.confirmation) for k, out in enumerate(sent, 1) for m in out]
    assert [n for _, n in again] == list(range(1, TRIES))
    assert all(RETRY_S - 1e-6 < b - a < RETRY_S + 0.11 for (a, _), (b, _) in pairwise([(0.0, 0), *again]))
    assert (request.outcome, request.answer) == (Outcome.TIMED_OUT, "no answer in 10 s; is the link up?")


def test_what_is_in_progress_is_waited_for():
    commands, _, request = asked()
    commands.handle(10.5, ack(mavlink.MAV_RESULT_IN_PROGRESS, 40))
    assert request.progress == pytest.approx(0.4)
    commands.handle(11.0, ack(mavlink.MAV_RESULT_IN_PROGRESS, 100))
    assert request.progress == 1.0
    commands.handle(12.0, ack(mavlink.MAV_RESULT_IN_PROGRESS, 255))  # not known
    assert request.progress == 1.0
    assert commands.step(12.0 + PROGRESS_S - 0.1) == []  # it is not asked again meanwhile
    assert not request.done
    commands.step(12.0 + PROGRESS_S + 0.1)
    assert (request.outcome, request.answer) == (
        Outcome.TIMED_OUT,
        "begun, but it was never said to be done",
    )


def test_a_refusal_waits_a_moment_for_its_reason():
    commands, _, request = asked()
    commands.handle(10.5, ack(mavlink.MAV_RESULT_DENIED))
    commands.step(10.5 + REASON_S - 0.1)
    assert not request.done
    commands.handle(10.6, ack(mavlink.MAV_RESULT_ACCEPTED))  # a refusal stands
    commands.step(10.5 + REASON_S + 0.01)
    assert (request.outcome, request.answer) == (Outcome.REFUSED, "refused")
    commands, texts, request = asked()
    commands.handle(10.5, ack(mavlink.MAV_RESULT_DENIED))
    texts.handle(10.6, 0.0, mavlink.MAVLink_statustext_message(4, b"not now"))
    commands.step(10.61)
    assert (request.outcome, request.answer) == (Outcome.REFUSED, "not now")


def test_command_is_taken_when_the_vehicle_answers_us_and_what_we_asked():
    control = OperatorControl(1, (250, 190))

    def answer(station, request, result):
        control.handle(1.0, mavlink.MAVLink_change_operator_control_ack_message(station, request, result))

    answer(250, 0, 0)  # nobody has asked
    for stranger in ((251, 0), (250, 1)):
        request = control.take()
        (message,) = control.step(1.0, 0)
        assert (message.target_system, message.control_request) == (1, 0)
        answer(*stranger, 0)
        assert not request.done
    answer(250, 0, 0)
    assert request.outcome is Outcome.ACCEPTED
    request = control.release()
    (message,) = control.step(2.0, 0)
    assert message.control_request == 1
    answer(250, 1, 3)
    assert (request.outcome, request.answer) == (
        Outcome.REFUSED,
        "another station commands it; it has to hand over",
    )
