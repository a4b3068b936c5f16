"""A mission that is drawn: edits, undo, the check, files, and what a vehicle holds; without a browser."""

import asyncio
import math
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.mission import Mission, format_mission_toml, load_mission, parse_mission
from mufly.mission.files.mission_items import mission_to_items
from mufly.station.page.mission_draft import (
    NEW_MISSION_NAME,
    MissionDraft,
    SharedDraft,
    apply_draft_edit,
    check_draft,
    encode_draft,
    find_untransmitted_keys,
    mission_from_vehicle,
    parse_mission_draft,
)

BASE = load_mission("box-on-leg")
EMPTY = MissionDraft(Mission(name="new"))


def after(draft: MissionDraft, *orders: dict[str, object]) -> MissionDraft:
    for order in orders:
        draft = apply_draft_edit(draft, order)
    return draft


def places(draft: MissionDraft) -> list[tuple[float, float, float]]:
    return [w.position_m for w in draft.mission.waypoint]


def test_points_are_added_inserted_moved_turned_round_and_deleted() -> None:
    d = after(EMPTY, {"op": "add", "at": [2, 0, -1]}, {"op": "add", "at": [2, 3, -1.5]})
    d = after(d, {"op": "add", "at": [9, 9, -1], "after": 1})
    assert places(d) == [(2, 0, -1), (9, 9, -1), (2, 3, -1.5)]
    d = after(d, {"op": "delete", "row": 2}, {"op": "insert", "row": 2}, {"op": "insert", "row": 1})
    assert places(d) == [
        (1, 0, -1),
        (2, 0, -1),
        (2, 1.5, -1.25),
        (2, 3, -1.5),
    ]  # half way, from the take-off too
    d = after(d, {"op": "move", "row": 3, "at": [0, 1, -2]}, {"op": "shift", "row": 1, "by": 1})
    assert places(d) == [(2, 0, -1), (1, 0, -1), (0, 1, -2), (2, 3, -1.5)]
    assert after(d, {"op": "shift", "row": 4, "by": 1}) is d  # nothing is later than the last: no step of undo
    d = after(d, {"op": "move", "row": 0, "at": [0.5, 0.25, -0.8]}, {"op": "end", "value": "return"})
    assert (d.mission.start_m, d.mission.take_off.height_m, d.mission.at_end) == ((0.5, 0.25), 0.8, "return")


def test_fields_are_those_of_the_file_and_empty_ones_go_back_to_their_default() -> None:
    d = MissionDraft(BASE)
    for name, value in (
        ("wait_s", 4.0),
        ("heading_deg", -90.0),
        ("speed_m_s", 0.2),
        ("height", 1.4),
        ("east", -1.0),
    ):
        d = after(d, {"op": "put", "row": 1, "name": name, "value": value})
    w = d.mission.waypoint[0]
    assert (w.wait_s, w.heading_deg, w.speed_m_s, w.position_m) == (4.0, -90.0, 0.2, (4.0, -1.0, -1.4))
    for name in ("wait_s", "heading_deg", "speed_m_s"):
        d = after(d, {"op": "put", "row": 1, "name": name, "value": None})
    w = d.mission.waypoint[0]
    assert (w.wait_s, w.heading_deg, w.speed_m_s) == (0.0, None, None)
    d = after(d, {"op": "put", "row": 0, "name": "wait_s", "value": 7.0})
    assert d.mission.take_off.wait_s == 7.0
    assert d.mission.box == BASE.box  # the world is none of it


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ({"op": "put", "row": 1, "name": "wait_s", "value": -1}, "waypoint[1].wait_s"),
        ({"op": "put", "row": 1, "name": "speed_m_s", "value": 99}, "waypoint[1].speed_m_s"),
        ({"op": "put", "row": 1, "name": "name", "value": 1}, "use north, east, height"),
        ({"op": "put", "row": 1, "name": "north", "value": None}, "give metres"),
        ({"op": "put", "row": 1, "name": "north", "value": "1"}, "is not a number"),
        ({"op": "put", "row": 0, "name": "speed_m_s", "value": 1}, "take_off"),
        ({"op": "put", "row": 0, "name": "height", "value": 0.05}, "take_off.height_m"),
        ({"op": "move", "row": 3, "at": [0, 0, -1]}, "there is no waypoint 3"),
        ({"op": "move", "row": 1, "at": [0, math.nan, -1]}, "give a finite number"),
        ({"op": "move", "row": True, "at": [0, 0, -1]}, "not a whole number"),
        ({"op": "add", "at": [0, 1]}, "give N, E and D"),
        ({"op": "delete", "row": 0}, "there is no waypoint 0"),
        ({"op": "end", "value": "crash"}, "at_end"),
        ({"op": "fly"}, "not an operation on a mission"),
    ],
)
def test_what_the_schema_refuses_changes_nothing_and_names_the_item(order: dict[str, object], words: str) -> None:
    draft = MissionDraft(BASE)
    with pytest.raises(InputError) as caught:
        apply_draft_edit(draft, order)
    assert words in str(caught.value)
    assert draft.mission is BASE


_ORDERS = st.one_of(
    st.builds(lambda n, h: {"op": "add", "at": [n, 0.0, -h]}, st.floats(-3, 3), st.floats(0.3, 2)),
    st.builds(lambda k: {"op": "delete", "row": k}, st.integers(1, 4)),
    st.builds(lambda k, by: {"op": "shift", "row": k, "by": by}, st.integers(1, 4), st.integers(-2, 2)),
    st.builds(lambda k, e: {"op": "move", "row": k, "at": [0.0, e, -1.0]}, st.integers(0, 4), st.floats(-2, 2)),
)


@settings(max_examples=40, deadline=None)
@given(st.lists(_ORDERS, max_size=12))
def test_undo_of_everything_is_the_beginning_and_redo_the_end(orders: list[dict[str, object]]) -> None:
    draft = MissionDraft(BASE)
    for order in orders:
        with suppress(InputError):
            draft = apply_draft_edit(draft, order)
    steps, back = len(draft.undo_stack), draft
    for _ in range(steps):
        back = apply_draft_edit(back, {"op": "undo"})
    assert back.mission == BASE
    assert apply_draft_edit(back, {"op": "undo"}) is back
    for _ in range(steps):
        back = apply_draft_edit(back, {"op": "redo"})
    assert back.mission == draft.mission
    assert back.redo() is back
    again = back.undo().with_mission(Mission()) if steps else back
    assert not again.redo_stack  # what was undone before another edit is gone


def test_a_drag_is_one_step_of_undo() -> None:
    drag = [{"op": "move", "row": 1, "at": [4, 0.1 * k, -1], "gesture": "a"} for k in range(1, 9)]
    d = after(MissionDraft(BASE), *drag)
    assert len(d.undo_stack) == 1
    d = after(d, {"op": "move", "row": 1, "at": [4, 1, -1], "gesture": "b"})
    assert len(d.undo_stack) == 2
    assert d.undo().undo().mission == BASE


def test_the_check_is_that_of_a_mission_file_and_names_the_row() -> None:
    """The line under the table is the one that the command line prints for the same mission in a file."""
    good = check_draft(BASE)
    assert good.fault == ""
    assert good.estimate is not None
    assert math.isnan(good.estimate.charge_fraction)  # of what battery?
    with_battery = check_draft(BASE, (3.0, 0.3)).estimate
    assert with_battery is not None
    assert with_battery.charge_Ah == pytest.approx(with_battery.duration_s * 3.0 / 3600.0)
    faults = [
        ({"op": "move", "row": 2, "at": [2.0, 0.1, -1.0]}, 2, "inside the crate"),
        ({"op": "move", "row": 1, "at": [4.0, 0.0, 0.0]}, 1, "on the floor"),
        ({"op": "move", "row": 1, "at": [8.0, 0.0, -1.0]}, 1, "beyond the north wall"),
        ({"op": "move", "row": 0, "at": [2.0, 0.1, -1.0]}, 0, "take-off"),
        ({"op": "empty"}, None, "no waypoint"),
    ]
    for order, row, words in faults:
        bad = after(MissionDraft(BASE), order).mission
        found = check_draft(bad)
        assert found.fault_row == row
        assert words in found.fault
        with pytest.raises(InputError) as caught:
            parse_mission(bad.model_dump(exclude_none=True), bad.name)
        assert str(caught.value) == f"{bad.name}: {found.fault}"
    long = after(MissionDraft(BASE), {"op": "put", "row": 2, "name": "wait_s", "value": 3000.0}).mission
    assert check_draft(long).fault == ""
    assert check_draft(long, (3.0, 0.3)).fault_row == 2
    there = after(MissionDraft(BASE), {"op": "delete", "row": 2})
    lands = check_draft(there.mission).estimate
    assert lands is not None
    capacity_Ah = (lands.duration_s + 1.0) * 3.0 / 3600.0 / there.mission.battery.usable
    assert check_draft(there.mission, (3.0, capacity_Ah)).fault == ""
    home = after(there, {"op": "end", "value": "return"}).mission
    assert check_draft(home).fault == ""
    assert check_draft(home, (3.0, capacity_Ah)).fault_row == 2  # the end is a row too


def test_a_file_with_a_fault_in_its_geometry_is_opened_to_be_mended_and_comes_back_equal() -> None:
    broken = after(MissionDraft(BASE), {"op": "move", "row": 2, "at": [2.0, 0.1, -1.0]}).mission
    mission = parse_mission_draft(format_mission_toml(broken), "mine.toml")
    assert mission == broken
    with pytest.raises(InputError, match=r"mine\.toml: waypoint\[1\]\.wait"):
        parse_mission_draft("[[waypoint]]\nposition_m=[1.0, 0.0, -1.0]\nwait = 2", "mine.toml")
    with pytest.raises(InputError, match="is not valid TOML"):
        parse_mission_draft("[[", "mine.toml")
    assert parse_mission_draft("[[waypoint]]\nposition_m=[1.0, 0.0, -1.0]", "mine.toml").name == "mine"


def test_what_a_vehicle_holds_comes_back_with_speeds_headings_and_end() -> None:
    d = after(
        MissionDraft(BASE),
        {"op": "put", "row": 1, "name": "speed_m_s", "value": 0.25},
        {"op": "put", "row": 2, "name": "heading_deg", "value": 90.0},
        {"op": "end", "value": "return"},
    )
    sent = mission_to_items(d.mission).items
    assert mission_from_vehicle(sent, BASE, None) == d.mission
    with pytest.raises(InputError, match=r"item 0: frame"):
        mission_from_vehicle([sent[0].__class__(0, 3, 16, z=1.0)], BASE, None)
    assert find_untransmitted_keys(d.mission, BASE) == []  # all that differs is carried
    other = d.mission.replace_parts(take_off=d.mission.take_off.model_copy(update={"wait_s": 9.0, "height_m": 2.0}))
    other = other.replace_parts(room=None, limits=other.limits.model_copy(update={"speed_m_s": 0.3}))
    assert find_untransmitted_keys(other, BASE) == ["take_off.wait_s", "limits", "room"]
    assert find_untransmitted_keys(Mission(), None) == []


def test_the_newest_state_is_judged_while_one_draws_on() -> None:
    async def draw() -> SharedDraft:
        sketch = SharedDraft()
        sketch.set_draft(MissionDraft(BASE))
        checks = []
        for k in range(5):
            sketch.set_draft(after(sketch.draft, {"op": "move", "row": 1, "at": [2.0 + 0.5 * k, 0.1, -1.0]}))
            checks.append(asyncio.create_task(sketch.check_draft(None)))
            await asyncio.sleep(0)
        verdicts = await asyncio.gather(*checks)
        assert len({v.fault for v in verdicts}) == 1
        return sketch

    sketch = asyncio.run(draw())
    assert sketch.verdict == check_draft(sketch.draft.mission)
    state = encode_draft(sketch.draft, sketch.verdict, "")
    assert (state["undo"], state["bad"], state["checked"], len(state["rows"])) == (5, None, True, 2)
    assert state["rows"][0]["at"] == [4.0, 0.1, 1.0]  # a person reads heights


def test_a_mission_that_is_begun_anew_has_a_name_of_its_own() -> None:
    """Saved, it must not replace the file of the one before."""
    new = after(MissionDraft(BASE), {"op": "empty"})
    assert new.mission.name == NEW_MISSION_NAME != BASE.name
    assert new.mission.world == BASE.world
    named = after(new, {"op": "name", "value": "two laps"})
    assert (named.mission.name, named.undo().mission.name) == ("two laps", NEW_MISSION_NAME)
