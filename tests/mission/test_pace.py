"""A mission brought down to what its helicopter can follow."""

import math
from dataclasses import replace

import pytest

from mufly.mission import TrajectoryLimits, parse_mission, reduce_mission_limits

MISSION = parse_mission({"waypoint": [{"position_m": [1.0, 0.0, -1.0]}], "limits": {"climb_m_s": 1.0}})
ABLE = TrajectoryLimits(10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 100.0)


def test_what_can_be_followed_stays() -> None:
    mission, changes = reduce_mission_limits(MISSION, ABLE)
    assert mission is MISSION
    assert changes == ""


def test_what_cannot_is_slowed_and_said() -> None:
    weak = TrajectoryLimits(10.0, 0.5, 10.0, 10.0, 0.2, math.radians(50.0), 100.0)
    mission, changes = reduce_mission_limits(MISSION, weak)
    assert mission.limits.climb_m_s == pytest.approx(0.4)
    assert mission.limits.climb_acceleration_m_s2 == pytest.approx(0.16)
    assert mission.limits.yaw_rate_deg_s == pytest.approx(40.0)
    assert mission.limits.speed_m_s == MISSION.limits.speed_m_s
    assert "climb_m_s 0.4 in place of 1" in changes
    # Just what it could follow leaves nothing to catch up with.
    assert reduce_mission_limits(MISSION, replace(ABLE, speed=MISSION.limits.speed_m_s))[
        0
    ].limits.speed_m_s == pytest.approx(0.48)
    assert MISSION.limits.climb_m_s == 1.0
    # What is derived from the limits follows them.
    assert MISSION.trajectory_limits.climb == 1.0
    assert mission.trajectory_limits.climb == pytest.approx(0.4)
    assert mission.waypoint == MISSION.waypoint


def test_a_waypoint_s_own_speed_is_brought_down_too() -> None:
    hasty = parse_mission(
        {
            "waypoint": [
                {"position_m": [1.0, 0.0, -1.0], "speed_m_s": 2.5},
                {"position_m": [2.0, 0.0, -1.0], "speed_m_s": 0.4},
                {"position_m": [3.0, 0.0, -1.0]},
            ]
        }
    )
    mission, changes = reduce_mission_limits(hasty, TrajectoryLimits(1.0, 10.0, 10.0, 10.0, 10.0, 100.0, 1000.0))
    assert [w.speed_m_s for w in mission.waypoint] == [pytest.approx(0.8), 0.4, None]
    assert changes == "waypoint[1].speed_m_s 0.8 in place of 2.5"
