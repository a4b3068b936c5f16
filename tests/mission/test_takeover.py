"""The pilot lets go of the sticks while it falls or shoots up."""

from dataclasses import replace

import numpy as np
import pytest

from mufly.estimate import Estimate
from mufly.mission import MissionState, State
from mufly.mission.external_control import exit_manual

FLYING = MissionState(
    state=State.RC, motors="fly", has_taken_off=True, home_position=(0.0, 0.0, -0.07), user_in_control=True
)


def measured(height, sink):
    zero = np.zeros(3)
    return Estimate(0.0, np.array([0.0, 0.0, -height]), np.array([0.1, 0.0, sink]), zero, zero, np.ones(8), 8.0)


@pytest.mark.parametrize("height", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("sink", [-3.0, 0.2, 1.0, 5.0])
def test_the_reference_never_leads_below_the_floor(height, sink):
    s = exit_manual(FLYING, measured(height, sink))
    assert s.state is State.HOVER
    way = np.array([s.motion.evaluate(t).position[2] for t in np.linspace(0.0, s.motion.rest_time_s, 50)])
    assert way[0] == pytest.approx(-height)
    assert way.max() <= -0.07 + 0.01  # the level speed lengthens the stop by millimetres
    assert s.hold_position[2] == pytest.approx(way[-1])
    fast = s.motion.evaluate(0.0).velocity[2]
    assert abs(fast) <= abs(sink) + 1e-12
    if sink < 0.5:
        assert fast == pytest.approx(sink)  # where there is room, it brakes from the speed that it has


def test_on_the_floor_it_stays_there():
    assert exit_manual(replace(FLYING), measured(0.07, 0.0)).state is State.INIT
