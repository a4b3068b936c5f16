"""What does it intend? Mission files, trajectories, obstacle avoidance and the mission state machine."""

from mufly.mission.check import Estimate, check_geometry, check_mission
from mufly.mission.landing import RAMP_DOWN_S, blind, down_blind
from mufly.mission.load import builtin_missions, dump_mission, load_mission, mission_from
from mufly.mission.machine import step
from mufly.mission.offboard import HIGHEST_M, SetPoint, fault_of, wants_up
from mufly.mission.pace import SHARE, slowed
from mufly.mission.plan import SPIN_UP_S, Leg, legs
from mufly.mission.preflight import preflight
from mufly.mission.schema import LOWEST_M, Mission, Waypoint
from mufly.mission.signals import NO_SIGNAL, Command, Event, Reference, State
from mufly.mission.spline import Spline, spline
from mufly.mission.state import MissionPlan, MissionState, begin, log, prepare
from mufly.mission.trajectory import Limits, Trajectory, curved, straight
from mufly.mission.user import GO_AROUND_M, OFF_FLOOR_M, stop_at_once, waypoint_fault

__all__ = [
    "GO_AROUND_M",
    "HIGHEST_M",
    "LOWEST_M",
    "NO_SIGNAL",
    "OFF_FLOOR_M",
    "RAMP_DOWN_S",
    "SHARE",
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
    "SetPoint",
    "Spline",
    "State",
    "Trajectory",
    "Waypoint",
    "begin",
    "blind",
    "builtin_missions",
    "check_geometry",
    "check_mission",
    "curved",
    "down_blind",
    "dump_mission",
    "fault_of",
    "legs",
    "load_mission",
    "log",
    "mission_from",
    "preflight",
    "prepare",
    "slowed",
    "spline",
    "step",
    "stop_at_once",
    "straight",
    "wants_up",
    "waypoint_fault",
]
