"""Catalogue of signals, spectrum, availability of commands, parameter sheet: the page's logic without a browser."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.estimate import Estimate
from mufly.flight import TunableParameter
from mufly.station import OperatorRequest, RequestOutcome, VehicleSnapshot
from mufly.station.page.frame_feed import (
    alias_frequency,
    build_signal_catalog,
    compute_spectrum,
    display_unit,
    make_rotor_frequency_marks,
)
from mufly.station.page.page_layout import SentDestination
from mufly.station.page.page_session import (
    COMMAND_NAMES,
    ParameterEdits,
    describe_slow_pace,
    find_recordings,
    find_refusal_reasons,
    format_parameter_file,
    mission_button_label,
    read_parameter_file,
)
from mufly.station.remote.remote_transfers import find_parameter_refusal_reason


def test_one_quantity_holds_all_who_speak_of_it() -> None:
    names = [
        f"{source}_attitude_{angle}"
        for source in ("truth", "estimated", "reference")
        for angle in ("roll", "pitch", "yaw")
    ]
    found = build_signal_catalog([*names, "battery_voltage", "motor_input_upper", "gyro_temperature"], lambda n: "rad")
    attitude = next(q for q in found if q["key"] == "attitude")
    assert attitude["components"] == ["roll", "pitch", "yaw"]
    assert attitude["sources"] == ["estimated", "reference", "truth"]
    assert attitude["signals"]["reference/yaw"] == "reference_attitude_yaw"
    assert attitude["unit"] == "°"
    assert attitude["factor"] == pytest.approx(180 / math.pi)
    assert sum(len(q["signals"]) for q in found) == len(names) + 3  # nothing is lost, nothing twice
    assert next(q for q in found if q["key"] == "gyro_temperature")["signals"] == {"/": "gyro_temperature"}
    assert attitude["upward"] == []


def test_height_and_climb_are_called_that_and_grow_upward() -> None:
    place, speed = build_signal_catalog(
        [f"estimated_{q}_{a}" for q in ("position", "velocity") for a in "NED"], lambda n: "m"
    )
    assert (place["components"], place["upward"]) == (["N", "E", "height"], ["height"])
    assert (speed["components"], speed["upward"]) == (["N", "E", "climb"], ["climb"])
    assert place["signals"]["estimated/height"] == "estimated_position_D"


def test_units_are_those_that_people_read() -> None:
    assert display_unit("rad/s", "rotor_speed")[0] == "rpm"
    assert display_unit("rad/s", "rotor_speed")[1] * 2 * math.pi == pytest.approx(60)
    assert display_unit("rad/s", "rates") == ("°/s", pytest.approx(180 / math.pi))
    assert display_unit("1", "motor_input") == ("", 1.0)
    assert display_unit("m", "position") == ("m", 1.0)


def test_the_spectrum_of_a_sine_is_a_peak_that_holds_its_power() -> None:
    rate, frequency, amplitude = 100.0, 12.5, 0.3
    t = np.arange(0, 20, 1 / rate)
    found = compute_spectrum(t, amplitude * np.sin(2 * math.pi * frequency * t))
    assert found is not None
    fs, f, density = found
    assert fs == pytest.approx(rate)
    assert f[np.argmax(density)] == pytest.approx(frequency, abs=0.11)
    assert np.trapezoid(density, f) == pytest.approx(amplitude**2 / 2, rel=0.02)  # Parseval


def test_gaps_and_missing_samples_are_bridged_and_too_few_say_nothing() -> None:
    t = np.arange(0, 10, 0.01)
    x = np.sin(2 * math.pi * 3 * t)
    x[::7] = np.nan
    found = compute_spectrum(t, x)
    assert found is not None
    assert found[1][np.argmax(found[2])] == pytest.approx(3.0, abs=0.15)
    assert compute_spectrum(t[:20], x[:20]) is None
    assert compute_spectrum(t, np.full_like(t, np.nan)) is None


def test_frequencies_above_half_the_rate_fold() -> None:
    # A sampled sine at f and at its fold differ by nothing but the sign: the definition of aliasing.
    rate = 100.0
    t = np.arange(200) / rate
    for f in (12.0, 60.0, 70.6, 141.2, 250.0):
        image = alias_frequency(f, rate)
        assert 0 <= image <= rate / 2
        np.testing.assert_allclose(np.cos(2 * np.pi * f * t), np.cos(2 * np.pi * image * t), atol=1e-9)


def test_rotors_are_marked_once_and_twice_a_turn() -> None:
    found = {m["name"]: m for m in make_rotor_frequency_marks(np.array([2 * math.pi * 20, math.nan]), 100.0)}
    assert set(found) == {"upper", "upper ×2"}
    assert found["upper"] == {
        "name": "upper",
        "hz": pytest.approx(20),
        "at": pytest.approx(20),
        "folded": False,
    }
    assert found["upper ×2"]["hz"] == pytest.approx(40)
    assert make_rotor_frequency_marks(np.array([0.0, 0.0]), 100.0) == []


HOVER = VehicleSnapshot(connected=True, armed=True, flying=True, in_command=True, state="hover")
FLOOR = VehicleSnapshot(connected=True, state="init")


def ask(s: VehicleSnapshot | None, **changes: object) -> dict[str, str]:
    return find_refusal_reasons(s, **({"kind": "mufly", "has_controls": True, "rows": 3} | changes))  # type: ignore[arg-type]


def test_on_the_floor_one_takes_off_and_in_the_air_one_lands() -> None:
    floor, air = ask(FLOOR), ask(HOVER)
    assert not floor["take_off"]
    assert not floor["mission"]
    assert floor["land"]
    assert floor["go_to"]
    assert air["take_off"]
    assert air["disarm"]
    assert not any(air[c] for c in ("land", "return", "go_to", "pause", "mission", "stop"))


SITUATIONS = [
    # state, flying, and what cannot be asked of the vehicle then (emergency stop and disarming aside)
    ("init", False, {"pause", "go_to", "land", "return"}),
    ("take-off", False, {"take_off", "go_to", "return"}),
    ("landing", True, {"take_off", "mission", "go_to", "return"}),
    ("rc", True, {"take_off", "mission", "pause", "go_to", "land", "return"}),
    ("offboard", True, {"take_off"}),
]


@pytest.mark.parametrize(("state", "flying", "refused_then"), SITUATIONS)
def test_a_button_offers_what_the_autopilot_accepts_in_that_state(
    state: str, flying: bool, refused_then: set[str]
) -> None:
    """One table for all three: while it lands it could be sent elsewhere by the page, and the vehicle refused."""
    found = ask(VehicleSnapshot(connected=True, armed=True, flying=flying, state=state))
    assert {c for c, why in found.items() if why} - {"arm", "disarm"} == refused_then
    assert all(len(why) < 30 for why in found.values())


@pytest.mark.parametrize("mode", ["landing", "take-off", "return", "offboard", "stabilise", ""])
def test_a_flight_mode_of_another_autopilot_is_no_state_of_ours(mode: str) -> None:
    air = ask(VehicleSnapshot(connected=True, armed=True, flying=True, state=mode), kind="other")
    assert not any(air[c] for c in ("land", "return", "go_to", "pause", "stop"))
    floor = ask(VehicleSnapshot(connected=True, state=mode), kind="other")
    assert not any(floor[c] for c in ("arm", "take_off", "mission"))
    assert floor["land"] == "on the floor"


def test_every_command_is_always_judged_and_the_reasons_are_words() -> None:
    for s in (None, FLOOR, HOVER, VehicleSnapshot()):
        for kind in ("mufly", "other", "recording"):
            for has in (True, False):
                assert set(ask(s, kind=kind, has_controls=has)) == set(COMMAND_NAMES)


def test_who_only_watches_can_stop_the_motors_but_nothing_else() -> None:
    watching = VehicleSnapshot(connected=True, armed=True, flying=True, commander="station 255")
    for found in (ask(HOVER, has_controls=False), ask(watching)):
        assert not found.pop("stop")
        assert all(found.values())
    assert ask(watching)["land"] == "view only"


def test_a_recording_commands_nothing_and_a_lost_link_lets_one_try_to_stop() -> None:
    assert all(ask(FLOOR, kind="recording").values())
    lost = ask(VehicleSnapshot(connected=False, armed=True, flying=True))
    assert lost["stop"] == ""
    assert lost["land"] == "no link"


def test_the_vehicle_says_why_it_cannot_be_armed() -> None:
    assert ask(FLOOR, unready="battery low")["take_off"] == "battery low"
    assert ask(FLOOR, rows=0)["mission"] == "no mission in the vehicle"


MISSION = [
    # what it does, whether its mission runs and was begun; what the button says, and whether it can be pressed
    (FLOOR, False, False, "Start mission", True),
    (replace(FLOOR, armed=True, state="take-off"), True, True, "Mission running", False),  # it spins up
    (replace(HOVER, state="waypoint"), True, True, "Mission running", False),
    (HOVER, True, True, "Mission running", False),  # it waits at a waypoint
    (HOVER, False, True, "Resume mission", True),  # interrupted, before a waypoint was reached too
    (replace(HOVER, state="waypoint"), False, True, "Resume mission", True),  # sent elsewhere meanwhile
    (HOVER, False, False, "Start mission", True),  # took off by hand
    (replace(FLOOR, mission_begun=True), False, False, "Start mission", True),
]


@pytest.mark.parametrize(("s", "runs", "begun", "label", "open_"), MISSION)
def test_the_main_button_says_what_the_mission_does(
    s: VehicleSnapshot, runs: bool, begun: bool, label: str, open_: bool
) -> None:
    now = replace(s, mission_running=runs, mission_begun=begun)
    assert mission_button_label(now) == label
    assert (not ask(now)["mission"]) is open_


def test_real_time_that_is_lost_is_told() -> None:
    assert (
        describe_slow_pace(VehicleSnapshot())
        == describe_slow_pace(VehicleSnapshot(real_time_factor=0.96, timing_overrun_count=0))
        == ""
    )
    assert (
        describe_slow_pace(VehicleSnapshot(real_time_factor=0.194, timing_overrun_count=3))
        == "real-time factor 0.19, 3 timing overruns"
    )
    assert describe_slow_pace(VehicleSnapshot(real_time_factor=1.0, timing_overrun_count=1)) == "1 timing overrun"


def test_undo_takes_back_in_order_and_redo_makes_again() -> None:
    sheet = ParameterEdits()
    sheet.record_baseline({"A": TunableParameter("A", 1.0), "B": TunableParameter("B", 5.0)})
    sheet.record_change("A", 1.0, 2.0)
    sheet.record_change("B", 5.0, 6.0)
    assert sheet.undo_name == "B"
    assert sheet.pop_undo_value() == ("B", 5.0)
    assert sheet.pop_undo_value() == ("A", 1.0)
    assert sheet.pop_undo_value() is None
    assert sheet.pop_redo_value() == ("A", 2.0)
    sheet.record_change("A", 2.0, 3.0)
    assert sheet.pop_redo_value() is None  # what was undone before another change is gone
    sheet.record_baseline(
        {"A": TunableParameter("A", 3.0), "B": TunableParameter("B", 5.0), "C": TunableParameter("C", 0.0)}
    )
    assert sheet.baseline == {"A": 1.0, "B": 5.0, "C": 0.0}


def test_the_undo_list_does_not_grow_for_ever() -> None:
    sheet = ParameterEdits()
    for k in range(1000):
        sheet.record_change("A", k, k + 1)
    steps = 0
    while sheet.pop_undo_value():
        steps += 1
    assert steps == 200


def test_bounds_are_named_before_anything_is_sent() -> None:
    p = TunableParameter("SPEED", 0.5, "m/s", 0.1, 2.0)
    assert find_parameter_refusal_reason(p, "SPEED", 1.0) == ""
    assert "0.1 to 2 m/s" in find_parameter_refusal_reason(p, "SPEED", 3.0)
    assert find_parameter_refusal_reason(p, "SPEED", math.nan)
    assert find_parameter_refusal_reason(None, "X", 1.0)
    assert "integer" in find_parameter_refusal_reason(TunableParameter("N", 1, is_integer=True), "N", 1.5)


def test_a_file_of_parameters_comes_back_whole() -> None:
    known = {
        "A_B": TunableParameter("A_B", 0.1),
        "N": TunableParameter("N", 3, is_integer=True),
        "Z": TunableParameter("Z", -1e-7),
    }
    back = read_parameter_file(format_parameter_file(known, 1), "x.params")
    assert back == pytest.approx({n: p.value for n, p in known.items()}, rel=1e-8)
    # One that the vehicle calls no number is left out with a note, and does not spoil the file.
    odd = {
        **known,
        "B": TunableParameter("B", math.nan),
        "C": TunableParameter("C", math.nan, is_integer=True),
    }
    assert read_parameter_file(format_parameter_file(odd, 1), "x.params") == back
    assert "# B is nan" in format_parameter_file(odd, 1)
    assert read_parameter_file("RC1_MIN,1100\n# note\nB = 2\nC 3.5\n", "x.param") == {
        "RC1_MIN": 1100,
        "B": 2,
        "C": 3.5,
    }


def test_comments_behind_values_and_read_only_marks_are_no_part_of_them() -> None:
    text = (
        "\ufeffMNT1_TYPE        1           # Servo\n"
        "RC6_OPTION,212  # Mount1 Roll, 3\n"
        "FRAME_CLASS 2 @READONLY\n"
        "FS_THR=0.5 @readonly # as shipped\n"
        "LOG_BITMASK 0x1F // all\n"
        "  # a note\n"
        "COMPASS_USE\t1;on\n"
        "1\t1\tA\t3\t6  # from a ground station\n"
    )
    assert read_parameter_file(text, "x.parm") == {
        "MNT1_TYPE": 1, "RC6_OPTION": 212, "FRAME_CLASS": 2, "FS_THR": 0.5, "LOG_BITMASK": 31, "COMPASS_USE": 1, "A": 3,
    }  # fmt: skip


def test_parameters_of_a_gimbal_do_not_replace_those_of_the_vehicle() -> None:
    rows = "1\t1\tGAIN\t0.2\t9\n1\t154\tGAIN\t0.7\t9\n1\t154\tPAN\t2\t9\n"
    assert read_parameter_file(rows, "x.params") == {"GAIN": 0.2}
    assert read_parameter_file(rows, "x.params", 154) == {"GAIN": 0.7, "PAN": 2}
    with pytest.raises(InputError, match="of component 154, none of component 1"):
        read_parameter_file("1 154 GAIN 0.7 9\n", "x.params")
    with pytest.raises(InputError, match=r"line 2.*GAIN is 0.3, but 0.2 in line 1"):
        read_parameter_file("GAIN,0.2\nGAIN,0.3\n", "x.param")
    assert (
        format_parameter_file({"GAIN": TunableParameter("GAIN", 0.2)}, 1, 154)
        .splitlines()[1]
        .startswith("1\t154\tGAIN")
    )


@pytest.mark.parametrize("text", ["", "# nothing\n", "A,b\n", "one two three\n", "A # 3\n", "A 3 @WRITABLE\n"])
def test_a_file_that_is_none_is_refused_with_its_line(text: str) -> None:
    with pytest.raises(InputError):
        read_parameter_file(text, "x.params")


def test_recordings_of_other_flights_are_found_beside_this_one(tmp_path: Path) -> None:
    tmp_path = tmp_path / "flights"  # what lies beside the folder itself is found too: other tests' files
    for name in (
        "one/flight.mcap",
        "one/link.tlog",
        "two/station.mcap",
        "two/deep/er.csv",
        "notes/table.csv",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()

    def found(folder: str) -> set[str]:
        return {str(p.relative_to(tmp_path)) for p in find_recordings(tmp_path / folder)}

    assert found("one") == {
        "one/flight.mcap",
        "one/link.tlog",
        "two/station.mcap",
    }  # and no table of somebody's
    assert found("") == {
        "one/flight.mcap",
        "one/link.tlog",
        "two/station.mcap",
        "two/deep/er.csv",
        "notes/table.csv",
    }
    assert found("not there") == found("one")


def test_the_mark_of_where_it_was_sent_goes_when_it_does_not_fly_there_any_more() -> None:
    there = replace(HOVER, state="waypoint", estimate=Estimate(position=np.array([0.0, 0.0, -1.0])))

    def left(*seen: VehicleSnapshot, outcome: RequestOutcome = RequestOutcome.ACCEPTED, kind: str = "mufly") -> bool:
        vehicle = SimpleNamespace(kind=kind, snapshot=there)
        sent = SentDestination(vehicle, OperatorRequest("go", outcome), (2.0, 0.0, 1.0))  # type: ignore[arg-type]
        stays = True
        for vehicle.snapshot in seen:
            stays = stays and sent.is_under_way(vehicle)  # type: ignore[arg-type]
        return not stays

    assert not left(there, there)
    assert not left(replace(there, state="hover"), there)  # accepted, and not yet told
    assert left(there, replace(there, state="hover"))  # interrupted
    assert left(there, replace(there, state="landing"))
    assert left(there, replace(there, mission_running=True))  # the mission goes on
    assert left(replace(there, flying=False))
    assert left(there, replace(there, estimate=Estimate(position=np.array([1.9, 0.0, -1.0]))))  # it is there
    assert left(there, outcome=RequestOutcome.REFUSED)
    assert not left(there, outcome=RequestOutcome.WAITING)
    assert not left(there, replace(there, state="hover"), kind="other")  # a mode of a foreign autopilot says nothing
    elsewhere = SimpleNamespace(kind="mufly", snapshot=there)
    assert not SentDestination(elsewhere, OperatorRequest("go"), (2.0, 0.0, 1.0)).is_under_way(None)  # type: ignore[arg-type]
