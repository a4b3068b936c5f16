"""Checks before take-off: free air, free columns, and a battery that lasts."""

import pytest

from mufly.errors import InputError
from mufly.mission import check_mission_endurance, load_mission, parse_mission, plan_legs, prepare_mission_plan
from mufly.vehicle import load_vehicle

CRATE = {"name": "crate", "centre_m": [2.0, 0.0, -0.75], "size_m": [0.6, 0.6, 1.5]}

SHELF = {"name": "shelf", "centre_m": [2.0, 0.0, -1.75], "size_m": [1.0, 1.0, 0.1]}

HANGING = {"name": "lamp", "centre_m": [2.0, 0.0, -1.5], "size_m": [0.5, 0.5, 1.0]}


def go(*positions, **more):
    return {"waypoint": [{"position_m": list(p)} for p in positions], **more}


@pytest.mark.parametrize(
    ("tables", "key", "words"),
    [
        (go((1, 0, 1)), "waypoint[1].position_m", "[1, 0, 1] is under the floor; D counts downward"),
        (go((1, 0, -1), (1, 0, 0)), "waypoint[2].position_m", "is on the floor"),
        (go((1, 0, -0.1)), "waypoint[1].position_m", "is too low to fly"),
        (go((2, 0, -1), box=[CRATE]), "waypoint[1].position_m", "is inside the crate; keep 0.49 m"),
        (go((2.7, 0, -1), box=[CRATE]), "waypoint[1].position_m", "is 0.40 m from the crate"),
        (
            go((4, 0, -1), room={"north_m": [-3, 3], "east_m": [-3, 3]}),
            "waypoint[1].position_m",
            "is beyond the north wall",
        ),
        (
            go((2, 0, -2.8), room={"north_m": [-3, 3], "east_m": [-3, 3], "height_m": 3}),
            "waypoint[1].position_m",
            "0.20 m from the ceiling",
        ),
        (go((2, 0, -2.2), box=[CRATE]), "waypoint[1].position_m", "the landing passes [2, 0,"),
        (go((4, 0, -1), start_m=[2.0, 0.1], box=[CRATE]), "start_m", "the take-off passes"),
        (
            go(
                (4, 0, -2.5),
                (4, 0, -1),
                box=[{**CRATE, "centre_m": [4.0, 0.0, -1.75], "size_m": [1, 1, 0.1]}],
            ),
            "waypoint[2].position_m",
            "the change of height before it passes",
        ),
        (
            go((4, 0, -1.7), box=[CRATE]),
            "waypoint[1].position_m",
            "at a height of 1.70 m, passes the crate (from 0.00 m to 1.50 m high) where the level beams may miss",
        ),
        (go((4, 0, -1.4), box=[CRATE]), "waypoint[1].position_m", "where the level beams may miss it"),
        (go((4, 0, -1.5), box=[SHELF]), "waypoint[1].position_m", "passes the shelf (from 1.70 m to 1.80 m"),
        (go((4, 0, -2.0), box=[SHELF]), "waypoint[1].position_m", "passes the shelf (from 1.70 m to 1.80 m"),
        (
            go(
                (4, 0, -1.1),
                cylinder=[{"name": "post", "centre_m": [2, 0], "radius_m": 0.1, "height_m": 1.0}],
            ),
            "waypoint[1].position_m",
            "passes the post (from 0.00 m to 1.00 m high)",
        ),
    ],
)
def test_geometry(tables, key, words):
    with pytest.raises(InputError) as fault:
        parse_mission(tables, "file.toml")
    assert fault.value.key == key
    assert words in str(fault.value)


def test_an_obstacle_on_a_leg_is_allowed_where_the_beams_see_it():
    parse_mission(go((4, 0, -1), box=[CRATE]))
    parse_mission(go((4, 0, -1.9), box=[CRATE]))
    # Under a high shelf with room enough.
    parse_mission(go((4, 0, -1), box=[SHELF]))
    parse_mission(go((4, 0, -1.2), box=[HANGING]))
    with pytest.raises(InputError, match=r"passes the lamp \(from 1\.00 m to 2\.00 m high\)"):
        parse_mission(go((4, 0, -1.1), box=[HANGING]))
    # Low over the floor, past something that stands on it or reaches below.
    parse_mission(go((4, 0, -0.25), take_off={"height_m": 0.3}, box=[CRATE]))


def test_a_spline_that_swings_to_the_floor_is_refused():
    tables = go((2, 0, -0.21), (4, 0, -3), path={"kind": "spline"})
    with pytest.raises(InputError, match="descends to a height of"):
        parse_mission(tables)
    parse_mission(go((2, 0, -0.21), (4, 0, -3)))
    parse_mission(go((2, 0, -1), (4, 0, -3), path={"kind": "spline"}))


def test_estimate_of_the_demonstration():
    m = load_mission("demonstration")
    estimate = check_mission_endurance(m, hover_current_A=4.0, capacity_Ah=0.25)
    # By hand: 3 m, then three legs of 3 m with 1 m of height each, 1 m up and 2 m down.
    assert estimate.path_m == pytest.approx(3 + 3 * (3 + 1) + 1 + 2)
    assert 60.0 < estimate.duration_s < 100.0
    assert estimate.charge_Ah == pytest.approx(estimate.duration_s * 4.0 / 3600.0)
    assert estimate.charge_fraction == pytest.approx(estimate.charge_Ah / 0.25)
    times = [leg.reached_s for leg in plan_legs(m)]
    assert times == sorted(times)


FAST = {"speed_m_s": 1.1, "acceleration_m_s2": 1.0, "climb_m_s": 0.7, "climb_acceleration_m_s2": 0.6}
ZIGZAG = [(0.6 * (k % 3), 0.5 * (k % 4), -1.0 - 0.1 * (k % 3)) for k in range(1, 8)]


@pytest.mark.parametrize(
    "tables",
    [
        load_mission("demonstration").model_dump(exclude_none=True),
        load_mission("box-on-leg").model_dump(exclude_none=True),
        go((1.5, 0.5, -1), (1, 2, -1.2)),
        go(*ZIGZAG),
        go((14, 0, -1.5), (14, 9, -1.5), limits=FAST),
        go(*[(0.2 * k, 0.1 * (k % 2), -1) for k in range(1, 9)]),
        {"waypoint": [{"position_m": [0.5, 0.5 * k, -1.0], "heading_deg": 170.0 * (-1) ** k} for k in range(4)]},
        {"waypoint": [{"position_m": [1.0, k, -1.0], "wait_s": 4.0 * k} for k in range(3)]},
        go((0, 0, -3), (1, 0, -0.5), (1, 1, -5), (1, 1, -1)),
        go((2, 0, -1), (3, 2, -1.5), (1, 3, -1), path={"kind": "spline"}),
        go((2, 0, -4), at_end="return", take_off={"height_m": 3.0}),
        go((2, 0, -1), (2, 1, -1), limits={"speed_m_s": 0.3, "touchdown_m_s": 0.08, "descent_m_s": 0.2}),
        go((3, 0, -1), (3, 2, -1), avoidance={"scan": True}),
        go((5, 0, -1), cylinder=[{"centre_m": [2.5, 0.1], "radius_m": 0.2, "height_m": 2.5}]),
    ],
)
def test_a_mission_takes_as_long_as_is_expected(rig, tables):
    mission = parse_mission(tables)
    flight = rig.fly(mission)
    start = next(t for t, s in zip(flight.time, flight.states, strict=True) if s == "take-off")
    landed = next(e.time_s for e in flight.state.events if e.text == "landed")
    estimate = check_mission_endurance(mission, hover_current_A=4.0, capacity_Ah=1.0)
    assert estimate.duration_s == pytest.approx(landed - start, rel=0.05)


def test_four_metres_more_take_as_long_as_climbing_and_sinking_them():
    low, high = (
        parse_mission(go((0, 0, -h), take_off={"height_m": h}, limits={"climb_m_s": 0.5, "descent_m_s": 0.2}))
        for h in (2.0, 6.0)
    )
    one, other = (check_mission_endurance(m, hover_current_A=4.0, capacity_Ah=1.0).duration_s for m in (low, high))
    assert other - one == pytest.approx(4.0 / 0.5 + 4.0 / 0.2, abs=0.02)
    # The last 0.4 m are sunk at the speed of a touchdown.
    soft, hard = (low.replace_parts(limits=low.limits.model_copy(update={"touchdown_m_s": v})) for v in (0.1, 0.2))
    one, other = (check_mission_endurance(m, hover_current_A=4.0, capacity_Ah=1.0).duration_s for m in (soft, hard))
    # It brakes sooner to the slower one, and the reference goes on 3 cm below the floor.
    assert one - other == pytest.approx(0.43 / 0.1 - 0.43 / 0.2, abs=0.1)


def test_what_is_refused_says_how_long_it_would_take():
    """Also where only the way down, or the wait, is one too many."""

    def takes(tables):
        return check_mission_endurance(parse_mission(tables), hover_current_A=4.0, capacity_Ah=9.0).duration_s

    for tables, key in (
        (go((50, 0, -1)), "position_m"),
        ({"waypoint": [{"position_m": [1, 0, -1], "wait_s": 90}]}, "wait_s"),
    ):
        needed = takes(tables)
        one = parse_mission(tables)
        for seconds in (needed + 1.0, needed - 1.0):
            numbers = {"hover_current_A": 1.0, "capacity_Ah": seconds / 3600.0 / one.battery.usable}
            if seconds > needed:
                assert check_mission_endurance(one, **numbers).duration_s == needed
                continue
            with pytest.raises(InputError, match=rf"{key}.* {needed:.0f} s") as told:
                check_mission_endurance(one, **numbers)
            assert f"the battery lasts {seconds:.0f} s" in str(told.value)


def test_the_battery_has_to_last():
    weak = {"hover_current_A": 4.0, "capacity_Ah": 0.25}
    with pytest.raises(InputError, match=r"take_off.height_m: 50 m is out of reach.*the battery lasts 180 s"):
        check_mission_endurance(parse_mission(go((0, 0, -50), take_off={"height_m": 50.0})), **weak)
    with pytest.raises(InputError, match=r"waypoint\[2\].position_m: -90 m \(D\) is out of reach.*fly lower"):
        check_mission_endurance(parse_mission(go((1, 0, -1), (1, 0, -90))), **weak)
    with pytest.raises(InputError, match=r"waypoint\[1\].position_m: is out of reach.*shorten the path"):
        check_mission_endurance(parse_mission(go((200, 0, -1))), **weak)
    with pytest.raises(InputError, match=r"waypoint\[1\].wait_s: 600 is too long"):
        check_mission_endurance(parse_mission({"waypoint": [{"position_m": [1, 0, -1], "wait_s": 600}]}), **weak)


def test_the_same_mission_passes_with_more_of_the_battery():
    m = parse_mission(go((55, 0, -1)))
    with pytest.raises(InputError):
        check_mission_endurance(m, hover_current_A=4.0, capacity_Ah=0.1)
    assert check_mission_endurance(m, hover_current_A=4.0, capacity_Ah=0.2).charge_fraction < 0.8


def test_prepare_takes_the_vehicle_s_ring_and_battery():
    vehicle = load_vehicle("mufly-1.1")
    plan = prepare_mission_plan(load_mission("demonstration"), vehicle)
    assert plan.low_battery_V == float(vehicle.battery.low_voltage)
    assert len(plan.beam_ring.cos) == vehicle.range_ring.count
    assert prepare_mission_plan(parse_mission(go((1, 0, -1), battery={"low_V": 6.5})), vehicle).low_battery_V == 6.5
    with pytest.raises(InputError, match=r"battery\.low_V"):
        prepare_mission_plan(parse_mission(go((1, 0, -1), battery={"low_V": 12.0})), vehicle)


def test_the_way_home_is_checked_and_counted():
    numbers = {"hover_current_A": 4.0, "capacity_Ah": 0.25}
    there, back = parse_mission(go((3, 0, -1))), parse_mission(go((3, 0, -1), at_end="return"))
    one, two = check_mission_endurance(there, **numbers), check_mission_endurance(back, **numbers)
    assert two.path_m == pytest.approx(one.path_m + 3.0)
    assert two.duration_s > one.duration_s + 3.0 / 0.6
    with pytest.raises(InputError, match=r'at_end: "return" is out of reach.*end with "land"'):
        check_mission_endurance(parse_mission(go((60, 0, -1), at_end="return")), **numbers)
    check_mission_endurance(parse_mission(go((60, 0, -1))), **numbers)


def test_a_way_home_over_a_box_that_the_beams_miss_is_refused():
    table = {"centre_m": [1.5, 1.5, -0.5], "size_m": [0.8, 0.8, 1.0], "name": "table"}
    corners = ((3, 0, -1.2), (3, 3, -1.2))
    parse_mission(go(*corners, box=[table]))
    with pytest.raises(InputError, match=r"at_end: the path to it, at a height of 1\.20 m, passes the table"):
        parse_mission(go(*corners, box=[table], at_end="return"))


def test_a_slower_leg_takes_longer():
    m = load_mission("demonstration")
    tables = m.model_dump(exclude_none=True)
    tables["waypoint"] = [{**w, "speed_m_s": 0.2} for w in tables["waypoint"]]
    slow = check_mission_endurance(parse_mission(tables), hover_current_A=4.0, capacity_Ah=0.25)
    quick = check_mission_endurance(m, hover_current_A=4.0, capacity_Ah=0.25)
    # A leg d from rest to rest takes d / V and one ramp of 15 V / (8 a).
    at = {v: 4 * (3.0 / v + 15.0 * v / (8.0 * 0.4)) for v in (0.2, 0.6)}
    assert slow.duration_s - quick.duration_s == pytest.approx(at[0.2] - at[0.6], abs=1e-6)
