"""What does it intend? Mission files, trajectories, obstacle avoidance and the mission state machine."""

from mufly.mission.check import Estimate, check_mission
from mufly.mission.load import builtin_missions, dump_mission, load_mission, mission_from
from mufly.mission.machine import step
from mufly.mission.pace import slowed
from mufly.mission.phases import RAMP_DOWN_S, blind, down_blind
from mufly.mission.plan import SPIN_UP_S, Leg, legs
from mufly.mission.preflight import preflight
from mufly.mission.schema import Mission, Waypoint
from mufly.mission.signals import Command, Event, MissionPlan, MissionState, Reference, State, begin, prepare
from mufly.mission.spline import Spline, spline
from mufly.mission.trajectory import Limits, Trajectory, curved, straight

__all__ = [
    "RAMP_DOWN_S",
    "SPIN_UP_S",
    "Command",
    "Estimate",
    "Event",
    "Leg",
    "Limits",
    "Mission",
    "MissionPlan",
    "MissionState",
    "Reference",
    "Spline",
    "State",
    "Trajectory",
    "Waypoint",
    "begin",
    "blind",
    "builtin_missions",
    "check_mission",
    "curved",
    "down_blind",
    "dump_mission",
    "legs",
    "load_mission",
    "mission_from",
    "preflight",
    "prepare",
    "slowed",
    "spline",
    "step",
    "straight",
]
