"""A stand-in for helicopter and controllers: each axis follows its reference as a critically damped lag."""

import math
import random
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from mufly.estimate import Estimate
from mufly.mission import Command, MissionPlan, initial_mission_state, step_mission, update_obstacle_map
from mufly.mission.avoidance import make_beam_ring
from mufly.world import cast_ranges, find_nearest_obstacle

STANDING = -0.07
RING = make_beam_ring(8, np.pi / 8, 1.5)
NO_SIGNAL = Command()


def plan_for(mission, low_V=6.0, beams=RING):
    return MissionPlan(mission, beams, low_V)


@dataclass
class Flight:
    """What happened, one row a step."""

    time: list = field(default_factory=list)
    position: list = field(default_factory=list)
    velocity: list = field(default_factory=list)
    reference: list = field(default_factory=list)
    states: list = field(default_factory=list)
    clearance: float = np.inf
    state: object = None

    def arrays(self):
        return np.array(self.time), np.array(self.position), np.array(self.velocity)

    @property
    def visited(self):
        return [e.state for e in self.state.events]

    @property
    def text(self):
        return " | ".join(f"{e.time_s:.1f} {e.state}: {e.text}" for e in self.state.events)


def beams_from(x, attitude, beams):
    c, s = np.cos(attitude[2]), np.sin(attitude[2])
    return np.stack([c * beams.cos - s * beams.sin, s * beams.cos + c * beams.sin, np.zeros(len(beams.cos))], axis=1)


def fly(
    mission,
    *,
    limit_s=400.0,
    dt=0.02,
    lag_s=0.3,
    height_lag_s=0.5,
    signals=None,
    disturb=None,
    world=None,
    voltage=None,
    plan=None,
    lift=True,
    roll=None,
):
    """Fly a mission to its end. ``signals(t, state)`` gives commands, ``disturb(t)`` an acceleration (3,)."""
    plan = plan or plan_for(mission)
    world = world or mission.world
    x = np.array([*mission.start_m, STANDING])
    v = np.zeros(3)
    psi, rate = np.radians(mission.start_heading_deg), 0.0
    omega = np.array([2.0 / lag_s, 2.0 / lag_s, 2.0 / height_lag_s])
    flight = Flight()

    def measure(t):
        attitude = np.array([roll(t) if roll else 0.0, 0.0, psi])
        seen = cast_ranges(
            world() if callable(world) else world, x, beams_from(x, attitude, plan.beam_ring), plan.beam_ring.max_range
        )
        volts = voltage(t) if voltage else 7.4
        return Estimate(t, x.copy(), v.copy(), attitude, np.zeros(3), seen, volts)

    m = measure(0.0)
    s = initial_mission_state(plan, m)
    for k in range(int(limit_s / dt)):
        t = k * dt
        m = measure(t)
        command = signals(t, s) if signals else Command(start=k == 5)
        s, r = step_mission(plan, s, m, command or NO_SIGNAL)
        for part in (1, 2, 3):
            s = update_obstacle_map(plan, s, m, part, 3)
        flight.time.append(t)
        flight.position.append(x.copy())
        flight.velocity.append(v.copy())
        flight.reference.append(r)
        flight.states.append(s.state.value)
        if x[2] < -0.3:
            around = world() if callable(world) else world
            flight.clearance = min(flight.clearance, find_nearest_obstacle(around, x)[0])
        if s.finished:
            break
        if r.motors == "fly" and lift:
            a = omega**2 * (r.position - x) - 2.0 * omega * v
            if r.rc_active:
                a[:2] = (9.81 * -np.sin(r.pitch), 9.81 * np.sin(r.roll))
            if disturb is not None:
                a = a + disturb(t)
            v = v + dt * a
            x = x + dt * v
            yaw_omega = 8.0
            rate += dt * (yaw_omega**2 * (r.heading - psi) - 2.0 * yaw_omega * rate)
            psi += dt * rate
        else:
            v = np.zeros(3)
        if x[2] > STANDING:
            x[2] = STANDING
            v = np.zeros(3)
    flight.state = s
    return flight


def scene(seed):
    """A leg in a random direction with something on it: kind and tables of a mission."""
    r = random.Random(seed)
    psi, length = r.uniform(-math.pi, math.pi), r.uniform(2.5, 6.0)
    along, across = (math.cos(psi), math.sin(psi)), (-math.sin(psi), math.cos(psi))

    def place(share, off):
        return [share * length * along[k] + off * across[k] for k in range(2)]

    kind = r.choice(["box", "box", "post", "wall", "two", "corner"])
    tables = {
        "name": f"scene {seed}",
        "start_heading_deg": r.uniform(-180.0, 180.0),
        "waypoint": [{"position_m": [*place(1.0, 0.0), -1.0]}],
    }
    centre = place(r.uniform(0.3, 0.7), r.uniform(-0.5, 0.5))
    if kind in ("box", "two"):
        size = [r.uniform(0.1, 1.2), r.uniform(0.1, 1.2), 2.0]
        tables["box"] = [{"centre_m": [*centre, -1.0], "size_m": size, "yaw_deg": r.uniform(-90.0, 90.0)}]
    if kind in ("post", "two"):
        foot = centre if kind == "post" else place(r.uniform(0.2, 0.8), r.uniform(-1.2, 1.2))
        widest = 0.3 if kind == "post" else 0.4
        tables["cylinder"] = [{"centre_m": foot, "radius_m": r.uniform(0.02, widest), "height_m": 2.0}]
    if kind in ("wall", "corner"):
        turn, half = psi + math.pi / 2 + r.uniform(-1.0, 1.0), r.uniform(0.3, 1.5)
        a, b = ([centre[k] + s * half * (math.cos, math.sin)[k](turn) for k in range(2)] for s in (1, -1))
        tables["wall"] = [{"start_m": a, "end_m": b, "height_m": 2.0}]
        if kind == "corner":
            back = [a[k] - along[k] for k in range(2)]
            tables["wall"].append({"start_m": a, "end_m": back, "height_m": 2.0, "name": "side wall"})
    return kind, tables


def gusty(seed=0):
    """Horizontal accelerations up to about 1 m/s2 at 0.15 to 0.5 Hz, which move the point mass by 3 to 5 cm."""
    a, b, c, d = np.random.default_rng(seed).uniform(0.0, 6.0, 4)

    def push(t):
        north = 0.6 * math.sin(0.9 * t + a) + 0.4 * math.sin(2.7 * t + b)
        return np.array([north, 0.6 * math.sin(1.1 * t + c) + 0.4 * math.sin(3.1 * t + d), 0.0])

    return push


@pytest.fixture(scope="session")
def rig():
    """The point mass and what belongs to it."""
    return SimpleNamespace(fly=fly, plan_for=plan_for, RING=RING, STANDING=STANDING, scene=scene, gusty=gusty)
