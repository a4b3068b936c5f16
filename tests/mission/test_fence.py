"""Geofences: what lies inside, what a mission file may say, and what a vehicle does that leaves one."""

import math
import tomllib

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.flight import Flight
from mufly.mission import (
    Fence,
    SetPoint,
    describe_fence_violation,
    fence_from_items,
    fence_to_items,
    format_mission_toml,
    parse_mission,
)
from mufly.mission.files.geofence import describe_path_fence_violation, fence_margins
from mufly.mission.files.mission_items import GlobalOrigin, MissionItem, MissionRefusedError, MissionResultCode

SQUARE = [[-3, -3], [3, -3], [3, 3], [-3, 3]]
L_SHAPE = ((0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (1.0, 1.0), (1.0, 4.0), (0.0, 4.0))


def go(*positions, **fence):
    return {"waypoint": [{"position_m": list(p)} for p in positions], "fence": fence}


@pytest.mark.parametrize(
    ("place", "depth"),
    [((0.5, 2.0), 0.5), ((2.0, 0.5), 0.5), ((2.0, 2.0), -1.0), ((-1.0, 0.5), -1.0), ((0.5, 0.5), 0.5)],
)
def test_depth_in_a_polygon_with_a_bay(place, depth):
    for corners in (L_SHAPE, L_SHAPE[::-1]):
        margins, _ = fence_margins(Fence(polygon_m=corners), [(*place, -1.0)])
        assert margins[0, 0] == pytest.approx(depth)


def test_every_bound_counts_and_the_worst_is_named():
    fence = Fence(polygon_m=SQUARE, centre_m=(0.0, 0.0), radius_m=2.0, ceiling_m=1.5, keep_out_m=(L_SHAPE,),
                  keep_out_circles_m=((-1.0, -1.0, 0.5),))  # fmt: skip
    for place, words in (
        ((0.0, -2.5, -1.0), "0.50 m outside the fence's circle"),
        ((-0.5, 0.5, -2.0), "0.50 m above the fence's ceiling"),
        ((0.5, 0.5, -1.0), "0.50 m inside a keep-out zone"),
        ((-1.0, -1.0, -1.0), "0.50 m inside a keep-out circle"),
        ((0.0, 500.0, -1.0), "498 m outside the fence's circle"),
        ((math.nan, 0.0, -1.0), "outside"),
        ((-1.0, 0.5, -1.0), ""),
    ):
        assert words in describe_fence_violation(fence, place)
        assert bool(describe_fence_violation(fence, place)) == bool(words)
    assert describe_fence_violation(None, (0.0, 500.0, -1.0)) == ""


@pytest.mark.parametrize(
    ("tables", "key", "words"),
    [
        (go((1, 0, -1), (5, 0, -1), polygon_m=SQUARE), "waypoint[2].position_m", "2.00 m outside the fence"),
        (go((2.9, 0, -1), polygon_m=SQUARE), "waypoint[1].position_m", "0.10 m from the fence, less than the required"),
        (go((1, 0, -1), ceiling_m=0.9), "take_off.height_m", "above the fence's ceiling"),
        (go((1, 0, -1), centre_m=[9, 9], radius_m=3.0), "start_m", "outside the fence's circle"),
        # Both ends are free; the way between them is not.
        (go((2, 0, -1), keep_out_circles_m=[[1.0, 0.1, 0.3]]), "waypoint[1].position_m", "keep-out circle"),
        ({**go((2, 2, -1), keep_out_m=[[[0.8, 0.8], [1.2, 0.8], [1.2, 1.2], [0.8, 1.2]]]), "at_end": "return",
          "waypoint": [{"position_m": [2, 0, -1]}, {"position_m": [2, 2, -1]}]}, "at_end", "keep-out zone"),
        (go((1, 0, -1), polygon_m=[[0, 0], [1, 0]]), "fence", "2 corners"),
        (go((1, 0, -1), polygon_m=[[-2, -2], [2, 2], [2, -2], [-2, 2]]), "fence", "crosses itself"),
        (go((1, 0, -1), radius_m=2.0), "fence", "centre_m"),
        (go((1, 0, -1), action="land"), "fence", "bounds nothing"),
        (go((1, 0, -1), keep_out_circles_m=[[1, 1, -1]]), "fence", "not above 0"),
    ],
)  # fmt: skip
def test_a_mission_that_leaves_its_fence_or_has_none_is_refused(tables, key, words):
    with pytest.raises(InputError) as caught:
        parse_mission(tables, "hall.toml")
    assert caught.value.key == key
    assert words in str(caught.value)


def test_a_fence_survives_the_file():
    tables = go((1, 0, -1), polygon_m=SQUARE, ceiling_m=2.5, keep_out_circles_m=[[2.0, 2.0, 0.3]], action="land")
    mission = parse_mission(tables, "hall.toml")
    assert parse_mission(tomllib.loads(format_mission_toml(mission))) == mission


@pytest.mark.parametrize("origin", [None, GlobalOrigin(46.5, 7.5, 400.0)])
def test_a_fence_survives_the_link(origin):
    fence = Fence(polygon_m=SQUARE, centre_m=(1.0, -1.0), radius_m=5.5, keep_out_m=(L_SHAPE, L_SHAPE[::-1]),
                  keep_out_circles_m=((2.0, 2.0, 0.25),), ceiling_m=2.0, action="land")  # fmt: skip
    items = fence_to_items(fence, origin)
    assert [i.seq for i in items] == list(range(len(items)))
    again = fence_from_items(items, fence, origin)
    assert (again.ceiling_m, again.action) == (2.0, "land")
    for name in ("polygon_m", "centre_m", "radius_m", "keep_out_circles_m"):
        assert np.array(getattr(again, name)) == pytest.approx(np.array(getattr(fence, name)), abs=0.02)
    assert np.array(again.keep_out_m) == pytest.approx(np.array(fence.keep_out_m), abs=0.02)


def vertex(first, n=0, e=0, command=5001, frame=1):
    return (command, first, n, e, frame)


@pytest.mark.parametrize(
    ("items", "result", "words"),
    [
        ([vertex(3), vertex(3, 1)], MissionResultCode.INVALID_SEQUENCE, "1 vertices of its polygon are missing"),
        ([vertex(2), vertex(2, 1)], MissionResultCode.INVALID_PARAM1, "give 3 or more"),
        ([vertex(3), vertex(4, 1), vertex(3, 1, 1)], MissionResultCode.INVALID_PARAM1, "state different counts"),
        ([vertex(3), vertex(3, 1), vertex(2.0, 1, 1, 5003)], MissionResultCode.INVALID_SEQUENCE, "missing"),
        ([vertex(0.0, command=5003)], MissionResultCode.INVALID_PARAM1, "a radius of 0 m"),
        ([vertex(math.nan, command=5004)], MissionResultCode.INVALID_PARAM1, "radius"),
        (
            [vertex(5.0, command=5003), vertex(6.0, command=5003)],
            MissionResultCode.UNSUPPORTED,
            "one inclusion polygon",
        ),
        ([vertex(5.0, command=5003, frame=0)], MissionResultCode.INVALID_PARAM5_X, "origin"),
        ([vertex(5.0, command=16)], MissionResultCode.UNSUPPORTED, "not a fence item"),
    ],
)
def test_items_that_are_no_fence_are_refused_with_the_field(items, result, words):
    made = [
        MissionItem(k, frame, command, params=(first, 0, 0, 0), x=round(1e4 * n), y=round(1e4 * e), mission_type=1)
        for k, (command, first, n, e, frame) in enumerate(items)
    ]
    with pytest.raises(MissionRefusedError, match=words) as caught:
        fence_from_items(made, None, None)
    assert caught.value.result == result


@pytest.mark.parametrize(("action", "ends"), [("hold", "hover"), ("return", "waypoint"), ("land", "landing")])
def test_outside_its_fence_a_vehicle_does_what_the_fence_says(action, ends):
    mission = parse_mission(go((0.3, 0, -0.5), centre_m=[0, 0], radius_m=0.9, action=action))
    with Flight(
        "mufly-1.1", mission.replace_parts(take_off=mission.take_off.model_copy(update={"height_m": 0.5}))
    ) as f:
        pilot, told = f.autopilot, []
        pilot.listeners.append(lambda e: told.append(e.text))
        f.step_period()
        assert pilot.arm(force=True)
        assert pilot.take_off(0.5)
        while pilot.status.state != "hover":
            f.step_period()
        refused = pilot.go_to((0.0, 500.0, -0.5))
        assert not refused
        assert "499 m outside the fence's circle" in refused.reason
        assert "outside the fence" in pilot.send_set_point(SetPoint(position_m=(1.5, 0.0, math.nan))).reason
        while not pilot.status.fence_breach_count:
            pilot.send_set_point(SetPoint(velocity_m_s=(0.5, 0.0, 0.0)))
            if not pilot.status.offboard_active:
                assert pilot.set_offboard(True)
            f.step_period()
        assert pilot.status.fence_breach_text
        for _ in range(1600):
            f.step_period()
            if pilot.status.state == ends:
                break
        assert pilot.status.state == ends
        words = {"hold": "holding", "return": "returning", "land": "landing"}[action]
        assert any(text.startswith("fence breached") and words in text for text in told)
        if action == "hold":
            assert "fence refused" in pilot.load_fence(mission.fence).reason
            assert pilot.go_to((0.3, 0.0, -0.5))
            assert pilot.load_fence(None)


def test_sticks_that_stay_out_are_stopped_and_may_fly_back():
    """After a breach it holds for two seconds; the pilot may then fly back, and a metre further out it acts again."""
    mission = parse_mission(go((0.3, 0, -0.5), centre_m=[0, 0], radius_m=0.6))
    with Flight(
        "mufly-1.1", mission.replace_parts(take_off=mission.take_off.model_copy(update={"height_m": 0.5}))
    ) as f:
        pilot = f.autopilot
        f.step_period()
        assert pilot.arm(force=True)
        assert pilot.take_off(0.5)
        while pilot.status.state != "hover":
            f.step_period()

        def fly(pitch: float, until, most=3000):
            for _ in range(most):
                pilot.set_sticks(0.0, pitch, 0.0, 0.0)
                f.step_period()
                if until():
                    return True
            return False

        assert fly(-0.06, lambda: pilot.status.fence_breach_count == 1)
        assert "wait until it hovers" in pilot.set_sticks(0.0, -0.06, 0.0, 0.0).reason
        for _ in range(8):  # the mission's logic runs in every fourth
            f.step_period()
        assert pilot.status.state == "hover"
        assert fly(-0.06, lambda: pilot.status.fence_breach_count == 2)
        assert fly(0.08, lambda: not pilot.status.fence_breach_text)


def test_a_way_through_a_keep_out_zone_is_refused_and_the_way_back_is_not():
    fence = Fence(centre_m=(0.0, 0.0), radius_m=5.0, keep_out_circles_m=((2.0, 0.0, 0.5),))
    assert "the path leads" in describe_path_fence_violation(fence, (0.0, 0.0, -1.0), (4.0, 0.0, -1.0))
    assert describe_path_fence_violation(fence, (0.0, 0.0, -1.0), (0.0, 4.0, -1.0)) == ""
    assert describe_path_fence_violation(fence, (7.0, 0.0, -1.0), (4.0, 0.0, -1.0)) == ""
    assert describe_path_fence_violation(None, (0.0, 0.0, -1.0), (99.0, 0.0, -1.0)) == ""


def test_a_place_that_a_full_battery_does_not_reach_is_refused():
    with Flight("mufly-1.1", parse_mission({"waypoint": [{"position_m": [1.0, 0.0, -1.0]}]})) as f:
        f.step_period()
        answer = f.autopilot.go_to((0.0, 500.0, -1.0))
    assert not answer
    assert "out of reach" in answer.reason
