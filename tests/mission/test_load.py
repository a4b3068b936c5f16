"""Mission files: what they hold, what is refused and how, and the way back."""

import copy
import json
import math
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from mufly.errors import InputError
from mufly.files.input_files import find_model_in_annotation
from mufly.mission import Mission, format_mission_toml, list_builtin_missions, load_mission, parse_mission

GOOD = {"waypoint": [{"position_m": [1.0, 0.0, -1.0], "wait_s": 1.0}, {"position_m": [1.0, 2.0, -1.5]}]}
DOCS = Path(__file__).parents[2] / "docs" / "reference" / "missions.md"


def test_the_demonstration_is_that_of_the_thesis():
    m = load_mission("demonstration")
    assert [w.position_m for w in m.waypoint] == [(-3, 0, -1), (-3, 3, -2), (0, 3, -1), (0, 0, -2)]
    assert [w.wait_s for w in m.waypoint] == [2.5] * 4
    assert m.take_off.height_m == 1.0
    assert m.take_off.wait_s == 2.5
    assert m.name == "demonstration"
    assert m.world.is_empty


@pytest.mark.parametrize("name", list_builtin_missions())
def test_a_mission_written_out_reads_back_equal(name, tmp_path):
    m = load_mission(name)
    file = tmp_path / "again.toml"
    file.write_text(format_mission_toml(m), encoding="utf-8")
    assert load_mission(file) == m


@given(
    st.text(max_size=30),
    st.lists(
        st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-9, -0.2), st.floats(0, 99)),
        min_size=1,
        max_size=5,
    ),
)
def test_any_mission_reads_back_equal(name, waypoints):
    m = parse_mission({"name": name, "waypoint": [{"position_m": list(w[:3]), "wait_s": w[3]} for w in waypoints]})
    assert parse_mission(tomllib.loads(format_mission_toml(m))) == m


def test_obstacles_come_out_in_si(tmp_path):
    m = parse_mission(
        {
            **GOOD,
            "box": [{"centre_m": [4, 0, -1], "size_m": [1, 1, 2], "yaw_deg": 90}],
            "cylinder": [{"centre_m": [-3, 0], "radius_m": 0.2, "height_m": 2, "name": "post"}],
            "wall": [{"start_m": [-5, 5], "end_m": [5, 5], "height_m": 2, "name": "partition"}],
            "room": {"north_m": [-8, 8], "east_m": [-8, 8]},
            "start_heading_deg": 90,
        }
    )
    assert m.world.boxes[0].yaw == pytest.approx(math.pi / 2)
    assert m.world.obstacle_names[:3] == ("box", "partition", "post")
    assert m.world.room.height == math.inf
    assert m.scans_by_yawing
    assert m.trajectory_limits.speed == m.avoidance.speed_m_s
    assert m.trajectory_limits.yaw_rate == pytest.approx(math.radians(60))
    assert parse_mission(tomllib.loads(format_mission_toml(m))) == m


def test_scanning_can_be_chosen():
    assert not parse_mission(GOOD).scans_by_yawing
    assert parse_mission({**GOOD, "avoidance": {"scan": True}}).scans_by_yawing
    assert not parse_mission({**GOOD, "avoidance": {"scan": True, "enabled": False}}).scans_by_yawing


def waypoint(**changes):
    return {"waypoint": [{"position_m": [1.0, 0.0, -1.0], **changes}]}


@pytest.mark.parametrize(
    ("tables", "key", "words"),
    [
        ({"waypoints": GOOD["waypoint"]}, "waypoints", "did you mean 'waypoint'?"),
        (waypoint(wait=2.0), "waypoint[1].wait", "did you mean 'wait_s'?"),
        ({"waypoint": [{"wait_s": 1.0}]}, "waypoint[1].position_m", "is missing"),
        (waypoint(position_m=[1.0, 0.0]), "waypoint[1].position_m", "has the wrong length; give 3 numbers"),
        (waypoint(position_m=[1.0, 0.0, -1.0, 0.0]), "waypoint[1].position_m", "give 3 numbers"),
        (waypoint(position_m=[1.0, math.nan, -1.0]), "waypoint[1].position_m[2]", "nan is not a finite number"),
        (waypoint(position_m=[1.0, math.inf, -1.0]), "waypoint[1].position_m[2]", "inf is not a finite number"),
        (waypoint(position_m=["a", 0.0, -1.0]), "waypoint[1].position_m[1]", '"a" is not a number'),
        (waypoint(position_m=3.0), "waypoint[1].position_m", "3.0 is not a list; give numbers in brackets"),
        (waypoint(wait_s=-1.0), "waypoint[1].wait_s", "-1.0 is out of range; give a number at least 0"),
        (waypoint(wait_s="2"), "waypoint[1].wait_s", '"2" is not a number; give a number without quotes'),
        (waypoint(wait_s=True), "waypoint[1].wait_s", "true is not a number"),
        (waypoint(heading_deg=1000.0), "waypoint[1].heading_deg", "at most 360"),
        ({"waypoint": {"position_m": [1, 0, -1]}}, "waypoint", "one table [[waypoint]] for each"),
        ({**GOOD, "limits": {"speed_m_s": 50.0}}, "limits.speed_m_s", "50.0 is out of range"),
        ({**GOOD, "limits": {"speed_m_s": math.nan}}, "limits.speed_m_s", "nan is not a finite number"),
        ({**GOOD, "limits": 3}, "limits", "is not a table"),
        ({**GOOD, "path": {"kind": "spiral"}}, "path.kind", "'straight' or 'spline'"),
        ({**GOOD, "take_off": {"height_m": 0.0}}, "take_off.height_m", "at least 0.2"),
        ({**GOOD, "take_off": {"heigth_m": 1.0}}, "take_off.heigth_m", "did you mean 'height_m'?"),
        ({**GOOD, "box": [{"centre_m": [5, 5, -1]}]}, "box[1].size_m", "is missing"),
        (
            {**GOOD, "box": [{"centre_m": [5, 5, -1], "size_m": [1, -1, 1]}]},
            "box[1].size_m[2]",
            "at least 0.001",
        ),
        ({**GOOD, "avoidance": {"scan": 1}}, "avoidance.scan", "is not true or false"),
        ({}, "waypoint", "the mission has no waypoint"),
        ({**GOOD, "wind": {"steady_m_s": [1e9, 0, 0]}}, "wind.steady_m_s[1]", "give a number at most 50"),
        ({**GOOD, "wind": {"steady_m_s": [0, 0, -1e9]}}, "wind.steady_m_s[3]", "give a number at least -50"),
        (
            waypoint(wait_s=10**400),
            "waypoint[1].wait_s",
            "whole number of more than 300 digits; give a value of",
        ),
        (waypoint(position_m=[10**400, 0, -1]), "waypoint[1].position_m[1]", "of more than 300 digits"),
    ],
)
def test_faults_are_named(tables, key, words):
    with pytest.raises(InputError) as fault:
        parse_mission(tables, "file.toml")
    assert fault.value.key == key
    message = str(fault.value)
    assert message.startswith(f"file.toml: {key}: ")
    assert words in message
    assert "\n" not in message


def test_a_misspelt_key_is_one_fault():
    with pytest.raises(InputError, match=r"did you mean 'position_m'\?$"):
        parse_mission({"waypoint": [{"position": [1.0, 0.0, -1.0]}]})


def test_several_faults_are_counted():
    with pytest.raises(InputError, match=r"\(1 more fault in this file\)"):
        parse_mission({**waypoint(wait_s=-1.0), "limits": {"climb_m_s": -1.0}})


def test_no_such_file():
    with pytest.raises(InputError, match="no such mission or file; give a mission file, or one of the built-in: box"):
        load_mission("nowhere.toml")


def test_not_toml(tmp_path):
    file = tmp_path / "bad.toml"
    file.write_text("waypoint = [")
    with pytest.raises(InputError, match="is not valid TOML"):
        load_mission(file)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        load_mission(file)


def test_a_file_without_a_name_is_called_after_itself(tmp_path):
    file = tmp_path / "survey.toml"
    file.write_text("[[waypoint]]\nposition_m = [1, 0, -1]\n")
    assert load_mission(file).name == "survey"


def every_key(model: type[BaseModel] = Mission):
    for name, field in model.model_fields.items():
        inner = find_model_in_annotation(field.annotation)
        if inner is None and field.annotation is not None:
            for kind in getattr(field.annotation, "__args__", ()):
                inner = inner or find_model_in_annotation(kind)
        if inner is not None:
            yield name
            yield from every_key(inner)
        else:
            assert field.description, f"{name} has no description"
            yield name


def test_every_key_is_documented():
    text = DOCS.read_text(encoding="utf-8")
    missing = [key for key in every_key() if f"`{key}`" not in text and f"[{key}]" not in text]
    assert not missing


def test_the_examples_in_the_documentation_are_missions():
    blocks = DOCS.read_text(encoding="utf-8").split("```toml\n")[1:]
    whole = [b.split("```")[0] for b in blocks if "[[waypoint]]" in b.split("```")[0]]
    assert whole
    for text in whole:
        parse_mission(tomllib.loads(text), "docs/reference/missions.md")


def numbers(model: type[BaseModel] = Mission, key: str = ""):
    """Every number of a mission file: its key, whether in brackets, and how many."""
    for name, field in model.model_fields.items():
        inner = find_model_in_annotation(field.annotation)
        here = f"{key}.{name}" if key else name
        if inner is not None:
            yield from numbers(inner, here)
        elif "float" in str(field.annotation):
            yield (
                here,
                str(field.annotation).count("Annotated") or (2 if "tuple" in str(field.annotation) else 0),
            )


BASE = {
    "waypoint": [{"position_m": [1.0, 0.0, -1.0]}],
    "box": [{"centre_m": [50.0, 5.0, -1.0], "size_m": [1.0, 1.0, 1.0]}],
    "cylinder": [{"centre_m": [50.0, -5.0], "radius_m": 0.2, "height_m": 2.0}],
    "wall": [{"start_m": [60.0, 1.0], "end_m": [60.0, 2.0], "height_m": 2.0}],
    "room": {"north_m": [-100.0, 100.0], "east_m": [-100.0, 100.0]},
    "floor": {"texture": "rich"},
}


@pytest.mark.parametrize("odd", [1e12, -1e12, 10**400, math.nan, math.inf, "2", True])
def test_every_absurd_number_is_refused_by_its_key(odd):
    """Every number of the file, from the models themselves: what no flight could mean is one line with its key."""
    listed = dict(numbers())
    assert {"limits.speed_m_s", "wind.steady_m_s", "box.centre_m", "room.height_m", "battery.low_V"} <= set(listed)
    for key, length in listed.items():
        tables = copy.deepcopy(BASE)
        *path, name = key.split(".")
        table = tables
        for part in path:
            table = table.setdefault(part, {})
            table = table[0] if isinstance(table, list) else table
        table[name] = [odd, *[1.0] * (length - 1)] if length else odd
        with pytest.raises(InputError) as fault:
            parse_mission(tables, "file.toml")
        assert name in fault.value.key, key
        assert "\n" not in str(fault.value)


# ---- files of other ground stations

HOME = [46.5, 7.5, 500.0]
NORTH = 1e-5 * 111170.0
"""Metres that 1e-5 degrees of latitude are at 46.5 degrees north."""


def simple(command, *params, frame=3):
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "frame": frame,
        "params": list(params),
    }


def plan_text(*items, **parts):
    mission = {"items": list(items), "plannedHomePosition": HOME, "version": 2}
    content = {"fileType": "Plan", "mission": mission, "rallyPoints": {"points": []}, "version": 1}
    return json.dumps({**content, **parts})


TAKE_OFF = simple(22, 0, 0, 0, None, 46.5, 7.5, 1.5)
THERE = simple(16, 3, 0, 0, None, 46.50001, 7.5, 2)


def test_a_plan_is_flown_from_its_planned_home(tmp_path):
    path = tmp_path / "hall.plan"
    path.write_text(plan_text(TAKE_OFF, THERE, simple(20, 0, 0, 0, 0, 0, 0, 0)))
    m = load_mission(path)
    assert (m.name, m.take_off.height_m, m.at_end) == ("hall", 1.5, "return")
    assert m.waypoint[0].position_m == pytest.approx((NORTH, 0.0, -2.0), abs=0.01)
    assert (m.waypoint[0].wait_s, m.waypoint[0].heading_deg) == (3.0, None)
    assert "planned home" in m.description


def test_heights_above_the_sea_count_from_home_and_local_places_stay(tmp_path):
    path = tmp_path / "mixed.plan"
    path.write_text(plan_text(TAKE_OFF, simple(16, 0, 0, 0, 90, 46.50001, 7.5, 502.5, frame=0),
                              simple(16, 0, 0, 0, None, 1.0, -2.0, -1.25, frame=1)))  # fmt: skip
    first, second = load_mission(path).waypoint
    assert first.position_m[2] == pytest.approx(-2.5)
    assert first.heading_deg == 90.0
    assert second.position_m == (1.0, -2.0, -1.25)


WPL = "QGC WPL 110\r\n0\t1\t0\t16\t0\t0\t0\t0\t46.5\t7.5\t500\t1\r\n1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t2\t1\r\n"


def test_a_waypoint_file_begins_with_its_home(tmp_path):
    path = tmp_path / "hall.waypoints"
    path.write_bytes((WPL + "2\t0\t3\t16\t0\t0\t0\t0\t46.50001\t7.5\t2\t1\r\n").encode())
    m = load_mission(path)
    assert m.waypoint[0].position_m == pytest.approx((NORTH, 0.0, -2.0), abs=0.01)
    assert m.waypoint[0].heading_deg is None
    assert m.take_off.height_m == 2.0


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        (WPL + "2\t0\t10\t16\t0\t0\t0\t0\t46.5\t7.5\t2\t1", "line 4", "relative to launch"),
        (WPL + "2\t0\t3\t16\t0\t0\t0\t0\t46.5\t7.5", "line 4", "has 10 columns"),
        (WPL, "", "no waypoint"),
        (plan_text(TAKE_OFF, THERE, simple(206, 0, 0, 0, 0, 0, 0, 0, frame=2)), "item 3", "DO_SET_CAM_TRIGG_DIST"),
        (plan_text(TAKE_OFF, {"type": "ComplexItem", "complexItemType": "fwLandingPattern"}), "item 2", "fwLanding"),
        (plan_text(TAKE_OFF, simple(16, 0, 0, 0, None, 46.6, 7.5, 2)), "item 2", "position_m"),
        (plan_text(TAKE_OFF, simple(16, 0, 0, 0, None, 1e300, 7.5, 2)), "item 2", "invalid coordinate"),
        (plan_text(TAKE_OFF, simple(16, 0, 0, 0, None, "north", 7.5, 2)), "item 2", "not numbers"),
        (plan_text(), "mission", "contains no items"),
        (plan_text(fileType="GeoFence"), "fileType", "not a plan"),
        ('{"fileType": "Plan"}', "mission", "is missing"),
        ("{not json", "", "is not valid JSON"),
    ],
)  # fmt: skip
def test_a_ground_stations_file_that_cannot_be_flown_says_what_to_do(tmp_path, text, key, words):
    path = tmp_path / "hall.plan"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_mission(path)
    assert caught.value.key == key
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_plans_geofence_is_kept_and_its_rally_points_are_left_out_and_said(tmp_path):
    corners = [[46.4999, 7.4999], [46.5001, 7.4999], [46.5001, 7.5001], [46.4999, 7.5001]]
    fence = {"polygons": [{"inclusion": True, "polygon": corners}],
             "circles": [{"inclusion": False, "circle": {"center": [46.5, 7.50005], "radius": 1.0}}]}  # fmt: skip
    rally = {"points": [[46.5, 7.5, 3.0]]}
    path = tmp_path / "hall.plan"
    path.write_text(plan_text(TAKE_OFF, THERE, geoFence=fence, rallyPoints=rally))
    m = load_mission(path)
    assert m.fence.polygon_m[0] == pytest.approx((-10 * NORTH, -7.67), abs=0.02)
    assert m.fence.keep_out_circles_m[0] == pytest.approx((0.0, 3.84, 1.0), abs=0.02)
    assert "1 rally points not used" in m.description
    fence["polygons"][0]["polygon"] = corners[:2]
    path.write_text(plan_text(TAKE_OFF, THERE, geoFence=fence))
    with pytest.raises(InputError, match="give 3 or more"):
        load_mission(path)


def test_a_survey_is_flown_as_the_items_it_was_made_into(tmp_path):
    survey = {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "TransectStyleComplexItem": {"Items": [THERE, THERE]},
    }
    path = tmp_path / "survey.plan"
    path.write_text(plan_text(TAKE_OFF, survey))
    assert len(load_mission(path).waypoint) == 2
