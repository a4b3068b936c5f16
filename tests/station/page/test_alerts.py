"""What is said aloud, and that it is said once."""

import math
from dataclasses import replace

from mufly.station import MissionRow, OperatorRequest, RequestOutcome, StatusMessage, VehicleSnapshot
from mufly.station.page.alerts import ALERT_REPEAT_PERIOD_S, MAX_ALERTS_PER_CALL, AlertWatch, SpokenAlert

FLIES = VehicleSnapshot(connected=True, armed=True, flying=True, state="waypoint", battery_charge=0.8)


def said(watch: AlertWatch, now_s: float, s: VehicleSnapshot = FLIES, *others: object) -> list[tuple[str, str]]:
    return [(a.level, a.text) for a in watch.find_new_alerts(now_s, s, *others)]  # type: ignore[arg-type]


def test_a_link_that_goes_and_comes_is_said_once_each() -> None:
    watch, gone = AlertWatch(), replace(FLIES, connected=False)
    assert said(watch, 0.0) == []  # what was so from the beginning is no news
    assert said(watch, 1.0, gone) == [("error", "communication lost")]
    assert said(watch, 2.0, gone) == []
    assert said(watch, 3.0) == [("info", "communication regained")]
    assert said(AlertWatch(), 0.0, gone) == []


def test_a_battery_that_hovers_about_a_limit_is_said_once_a_limit() -> None:
    watch, out = AlertWatch(), []
    charges = [0.5, 0.31, 0.299, 0.301, 0.299, 0.31, 0.2, 0.149, 0.151, 0.149, math.nan, 0.14]
    for k, charge in enumerate(charges):
        out += said(watch, 30.0 * k, replace(FLIES, battery_charge=charge))
    assert out == [("warning", "battery low, 30 percent"), ("error", "battery critical, 15 percent")]
    assert said(watch, 1e3, replace(FLIES, battery_charge=0.9)) == []  # charged, and then again
    assert said(watch, 2e3, replace(FLIES, battery_charge=0.25)) == [("warning", "battery low, 25 percent")]


def test_a_mission_is_done_once_its_last_row_is_behind_it() -> None:
    watch = AlertWatch()
    rows = [MissionRow("take off", reached=True), MissionRow("land")]
    done = [replace(r, reached=True) for r in rows]
    assert said(AlertWatch(), 0.0, FLIES, (), done) == []  # it was done before this window was opened
    assert said(watch, 0.0, FLIES, (), rows) == []
    assert said(watch, 1.0, FLIES, (), done) == [("info", "mission complete")]
    assert said(watch, 2.0, FLIES, (), done) == []
    assert said(watch, 3.0, FLIES, (), []) == []


def test_what_was_refused_or_not_answered_is_said_and_what_was_given_up_is_not() -> None:
    watch = AlertWatch()
    old = OperatorRequest("arm", RequestOutcome.REFUSED, "battery low")
    assert said(watch, 0.0, FLIES, (), (), [old]) == []
    asked = [
        OperatorRequest("land"),
        OperatorRequest("take off to 1 m"),
        OperatorRequest("arm"),
        OperatorRequest("go on"),
    ]
    assert said(watch, 1.0, FLIES, (), (), [old, *asked]) == []
    asked[0].set_outcome(RequestOutcome.REFUSED, "on the floor")
    asked[1].set_outcome(RequestOutcome.TIMED_OUT)
    asked[2].set_outcome(RequestOutcome.ACCEPTED)
    asked[3].set_outcome(RequestOutcome.REFUSED, "superseded by: EMERGENCY STOP")
    found = said(watch, 2.0, FLIES, (), (), [old, *asked])
    assert found == [("warning", "refused: land"), ("warning", "no answer: take off to 1 m")]
    assert said(watch, 3.0, FLIES, (), (), [old, *asked]) == []


def test_warnings_in_words_are_said_the_gravest_first_and_not_all_the_time() -> None:
    watch = AlertWatch()
    told = [StatusMessage(0.0, "error", "an old one")]
    assert said(watch, 0.0, FLIES, told) == []
    told += [
        StatusMessage(1.0, "info", "on to waypoint 2"),
        StatusMessage(1.0, "warning", "limit cycle in height, 1.2 Hz"),
        StatusMessage(1.1, "error", "battery low: 6.10 V, below 6.20 V"),
    ]
    assert said(watch, 1.0, FLIES, told) == [
        ("error", "battery low: 6.10 V, below 6.20 V"),
        ("warning", "limit cycle in height, 1.2 Hz"),
    ]
    told.append(StatusMessage(2.0, "warning", "limit cycle in height, 1.2 Hz"))
    assert said(watch, 2.0, FLIES, told) == []
    told.append(StatusMessage(3.0, "warning", "limit cycle in height, 1.2 Hz"))
    assert len(said(watch, 1.0 + ALERT_REPEAT_PERIOD_S, FLIES, told)) == 1
    told.append(StatusMessage(3.5, "warning", "limit cycle in height, 1.3 Hz"))
    assert said(watch, 2.0 + ALERT_REPEAT_PERIOD_S, FLIES, told) == []  # the same with other numbers
    told += [StatusMessage(4.0, "warning", f"fault {letter}") for letter in "abcdefghi"]
    assert len(watch.find_new_alerts(60.0, FLIES, told)) == MAX_ALERTS_PER_CALL
    told.append(StatusMessage(5.0, "warning", "mufly, system 1: communication lost"))  # the link says it, graver
    lost = watch.find_new_alerts(70.0, replace(FLIES, connected=False), told)
    assert lost == [SpokenAlert("error", "communication lost")]
