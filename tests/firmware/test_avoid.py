"""Obstacle avoidance on board: the C code is Python's, bit for bit, whatever beams say and around whole obstacles."""

from __future__ import annotations

import importlib.util
import math
import shutil
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from mufly.compiled.portable_math import exp_decay
from mufly.control import design_flight_controller
from mufly.errors import InputError
from mufly.firmware import Firmware
from mufly.firmware.compiled_software import diff_fields
from mufly.firmware.software_instance import read_path_check
from mufly.mission import avoidance, detour, load_mission, parse_mission
from mufly.mission.machine import phases, state_machine
from mufly.vehicle import load_vehicle

pytestmark = pytest.mark.skipif(
    not (shutil.which("gcc") or shutil.which("clang")), reason="there is no C compiler on this machine"
)

_spec = importlib.util.spec_from_file_location("mission_rig", Path(__file__).parents[1] / "mission" / "conftest.py")
rig = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(rig)


class Twin:
    """What Python asks, asked of the C code too; every answer is compared bit by bit."""

    def __init__(self, monkeypatch=None) -> None:
        f = Firmware(design_flight_controller(load_vehicle("mufly-1.1")))
        self.ffi, self.lib = f.ffi, f.lib
        self.asked = dict.fromkeys(
            (
                "begin_path_check",
                "insert_beam_hits",
                "check_map_part",
                "is_path_blocked",
                "limit_approach_velocity",
                "begin_detour",
                "follow_contour",
            ),
            0,
        )
        for name in self.asked:
            for module in (state_machine, phases):
                if monkeypatch is not None and hasattr(module, name):
                    monkeypatch.setattr(module, name, getattr(self, name))

    def ring(self, beams: avoidance.BeamRing):
        r = self.ffi.new("beam_ring_t *")
        r.count, r.max_range = len(beams.cos), beams.max_range
        r.cos[0 : r.count], r.sin[0 : r.count] = beams.cos.tolist(), beams.sin.tolist()
        return r

    def memory(self, m: avoidance.ObstacleMap):
        c = self.ffi.new("obstacle_map_t *")
        c.point_count, c.next_replaced_row = m.point_count, m.next_replaced_row
        self.ffi.memmove(c.points, m.points.tobytes(), m.points.nbytes)
        return c

    def detour(self, d: detour.Detour | None):
        if d is None:
            return self.ffi.NULL
        c = self.ffi.new("detour_t *")
        for name in d.__slots__:
            if name != "lap_start_point":
                setattr(c, name, getattr(d, name))
        c.has_lap_start = d.lap_start_point is not None
        c.lap_start_point = d.lap_start_point or (0.0, 0.0)
        return c

    def same_detour(self, d: detour.Detour, c) -> None:
        told = {n: getattr(c, n) for n in d.__slots__}
        told = {n: v if isinstance(v, (float, int)) else tuple(v) for n, v in told.items()}
        told["lap_start_point"] = told["lap_start_point"] if c.has_lap_start else None
        assert repr(told) == repr({n: getattr(d, n) for n in d.__slots__})
        assert bool(self.lib.is_detour_finished(c)) == d.is_finished

    def _floats(self, values):
        return self.ffi.new("real_t[]", [float(v) for v in values])

    def sight(self, s: avoidance.PathCheck):
        c = self.ffi.new("path_check_t *")
        names = ("look_ahead_m", "checked_point_count", "path_clearance_sq", "path_start_clearance_sq",
                 "lateral_offset_sum", "blocking_point_count", "nearest_blocking_distance_sq")  # fmt: skip
        for name in names:
            setattr(c, name, getattr(s, name))
        c.from_point, c.goal_point, c.goal_clearance_sq = s[:3], s[3:5], s.goal_clearance_sq
        c.nearest_blocking_point = (s.nearest_blocking_north, s.nearest_blocking_east)
        self.ffi.memmove(
            c.nearest_point_by_sector, s.nearest_point_by_sector.tobytes(), s.nearest_point_by_sector.nbytes
        )
        return c

    def same_sight(self, s: avoidance.PathCheck, c) -> None:
        assert diff_fields(s, read_path_check(c)) == []

    def insert_beam_hits(self, memory, beams, time_s, position, attitude, ranges, first=0, count=None):
        self.asked["insert_beam_hits"] += 1
        c, count = self.memory(memory), len(beams.cos) if count is None else count
        self.lib.insert_beam_hits(
            c,
            self.ring(beams),
            time_s,
            position.tolist(),
            attitude.tolist(),
            self._floats(ranges),
            first,
            count,
        )
        right = avoidance.insert_beam_hits(memory, beams, time_s, position, attitude, ranges, first, count)
        assert (c.point_count, c.next_replaced_row) == (right.point_count, right.next_replaced_row)
        assert bytes(self.ffi.buffer(c.points)) == right.points.tobytes()
        return right

    def begin_path_check(self, position, goal, ahead=avoidance.PATH_LOOK_AHEAD_M):
        self.asked["begin_path_check"] += 1
        c = self.ffi.new("path_check_t *")
        self.lib.begin_path_check(position, goal[:2], ahead, c)
        right = avoidance.begin_path_check(position, goal, ahead)
        self.same_sight(right, c)
        return right

    def check_map_part(self, memory, sight, time_s, clearance, part=1, parts=1):
        self.asked["check_map_part"] += 1
        m, c = self.memory(memory), self.sight(sight)
        self.lib.check_map_part(m, c, time_s, clearance, part, parts)
        known, right = avoidance.check_map_part(memory, sight, time_s, clearance, part, parts)
        assert m.point_count == known.point_count
        assert bytes(self.ffi.buffer(m.points)) == known.points.tobytes()
        self.same_sight(right, c)
        assert bool(self.lib.is_path_blocked(c, clearance)) == avoidance.is_path_blocked(right, clearance)
        for place in ((right.from_north, right.from_east), (right.goal_north + 0.1, 0.3)):
            unit = self.ffi.new("real_t[2]")
            far = self.lib.find_nearest_point_distance(c, place, unit)
            assert (far, *unit) == right.find_nearest_point_distance(place)
        return known, right

    def is_path_blocked(self, sight, clearance):
        self.asked["is_path_blocked"] += 1
        return avoidance.is_path_blocked(sight, clearance)  # look_around has compared it

    def limit_approach_velocity(self, sight, position, velocity, keep):
        self.asked["limit_approach_velocity"] += 1
        c = self._floats(velocity)
        self.lib.limit_approach_velocity(self.sight(sight), position[:2], keep, c)
        right = avoidance.limit_approach_velocity(sight, position, velocity, keep)
        assert tuple(c) == right
        return right

    def begin_detour(self, position, velocity, acceleration, goal, sight, before):
        self.asked["begin_detour"] += 1
        c, s, b = self.ffi.new("detour_t *"), self.sight(sight), self.detour(before)
        self.lib.begin_detour(c, position, velocity, acceleration, goal, s, b)
        right = detour.begin_detour(position, velocity, acceleration, goal, sight, before)
        self.same_detour(right, c)
        if before is not None:  # in its own place
            self.lib.begin_detour(b, position, velocity, acceleration, goal, s, b)
            self.same_detour(right, b)
        return right

    def follow_contour(self, before, sight, beams, position, heading, ranges, goal, *, clearance, speed, dt):
        self.asked["follow_contour"] += 1
        c = self.detour(before)
        self.lib.follow_contour(
            c, self.sight(sight), self.ring(beams), position, heading, self._floats(ranges), goal,
            clearance, speed, dt,
        )  # fmt: skip
        right = detour.follow_contour(
            before, sight, beams, position, heading, ranges, goal, clearance=clearance, speed=speed, dt=dt
        )
        self.same_detour(right, c)
        return right


@pytest.fixture(scope="module")
def twin():
    return Twin()


def wall(a, b):
    return {"start_m": a, "end_m": b, "height_m": 2.5}


def test_flights_around_obstacles_are_the_same_in_both_languages(monkeypatch) -> None:
    """The built-in box, with pushes; a goal shut in, which takes whole laps before it is given up."""
    twin = Twin(monkeypatch)
    flight = rig.fly(load_mission("box-on-leg"), disturb=rig.gusty())
    assert flight.visited.count("obstacle") >= 2
    shut = [wall([2, -1], [2, 1]), wall([4, -1], [4, 1]), wall([2, -1], [4, -1]), wall([2, 1], [4, 1])]
    flight = rig.fly(
        parse_mission({"waypoint": [{"position_m": [3, 0, -1]}], "wall": shut, "avoidance": {"give_up_s": 80.0}})
    )
    assert "blocked by an obstacle" in flight.state.reason
    assert flight.state.detour.lap_count >= 1
    assert all(
        twin.asked[n] > 0 for n in ("insert_beam_hits", "check_map_part", "is_path_blocked", "follow_contour")
    ), twin.asked


def test_scenes_drawn_at_random(monkeypatch) -> None:
    twin = Twin(monkeypatch)
    flown = 0
    for seed in range(2000, 2012):
        try:
            mission = parse_mission(rig.scene(seed)[1])
        except InputError:
            continue
        rig.fly(mission, disturb=rig.gusty(seed) if seed % 2 else None, limit_s=60.0)
        flown += 1
    assert flown >= 8
    assert twin.asked["follow_contour"] > 1000


def _points(rng, count):
    table = avoidance.ObstacleMap.make_empty_map().points
    table[:count, :2] = rng.uniform(-2.5, 2.5, (count, 2))
    table[:count, 2] = rng.uniform(-2.0, 0.0, count)
    table[:count, 3] = rng.uniform(0.0, 40.0, count)
    return avoidance.ObstacleMap(table, count)


def test_any_memory_any_ring_any_detour(twin) -> None:
    """Numbers of every size, full and empty memories, rings of 1 to 64 beams, points on the spot."""
    rng = np.random.default_rng(5)
    for k in range(400):
        size = 10.0 ** rng.uniform(-4, 3)
        count = int(rng.choice([0, 1, 40, avoidance.MAP_CAPACITY]))
        memory, beams = (
            _points(rng, count),
            avoidance.make_beam_ring(int(rng.integers(1, 65)), rng.uniform(-7, 7), 1.5),
        )
        ranges = rng.uniform(-0.1, 2.0, len(beams.cos))
        here, velocity, acceleration, goal = (tuple(v) for v in rng.normal(0.0, size, (4, 3)).tolist())
        if k % 7 == 0 and count:
            here = goal = tuple(memory.points[0, :3].tolist())
        attitude = rng.normal(0.0, 0.3, 3)
        memory = twin.insert_beam_hits(memory, beams, rng.uniform(0.0, 60.0), np.array(here), attitude, ranges)
        memory = twin.insert_beam_hits(
            memory, beams, 50.0, np.array(goal), attitude, ranges, len(ranges) // 2, len(ranges) // 3
        )
        sight = twin.begin_path_check(here, goal, float(rng.choice([0.0, 1.2, math.inf])))
        now = rng.uniform(0.0, 80.0)
        for part in range(1, 1 + k % 4):
            memory, sight = twin.check_map_part(memory, sight, now, 0.39, part, 3)
        twin.limit_approach_velocity(sight, here, velocity[:2], rng.uniform(0.0, 1.0))
        way_round = twin.begin_detour(here, velocity, acceleration, goal, sight, None)
        way_round = replace(
            way_round, lap_count=int(rng.integers(0, 2)), lap_start_point=here[:2] if k % 2 else None,
            lap_distance_m=2.0 * (k % 3),
            stuck_duration_s=5.0 * (k % 2), hit_goal_distance=way_round.hit_goal_distance + rng.uniform(-1, 3),
            obstacle_count=k % 4,
        )  # fmt: skip
        for _ in range(3):
            way_round = twin.follow_contour(
                way_round, sight, beams, tuple(np.add(here, rng.normal(0, 0.1, 3)).tolist()), attitude[2],
                ranges.tolist(), goal, clearance=0.39, speed=0.3, dt=float(rng.choice([0.0, 0.02, 0.5])),
            )  # fmt: skip
        twin.begin_detour(here, velocity, acceleration, goal, sight, way_round)
    empty = twin.ffi.new("obstacle_map_t *", {"point_count": 7})
    twin.lib.clear_obstacle_map(empty)
    assert bytes(twin.ffi.buffer(empty)) == bytes(twin.ffi.sizeof("obstacle_map_t"))
    assert astuple(avoidance.ObstacleMap.make_empty_map())[1] == 0


def test_decay_is_the_exponential_and_the_same_in_both_languages(twin) -> None:
    xs = [*np.random.default_rng(0).uniform(0.0, 40.0, 2000).tolist(), 0.0, -0.0, 1e-300, 40.0]
    for x in xs:
        assert exp_decay(x) == twin.lib.exp_decay(x)
        assert abs(exp_decay(x) - math.exp(-x)) <= 2 * math.ulp(math.exp(-x))
    for x, right in ((-1.0, 1.0), (41.0, 0.0), (math.inf, 0.0), (math.nan, 1.0), (-math.inf, 1.0)):
        assert exp_decay(x) == twin.lib.exp_decay(x) == right
