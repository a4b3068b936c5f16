"""Fig. 4.4: tilted 20 degrees with the bar level, the helicopter rights itself by the bar alone."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.dynamics import find_trim, initial_state, simulate_open_loop
from mufly.vehicle import replace_parameters


def released(vehicle, time_constant, roll_deg=0.0, pitch_deg=0.0, heading=0.0):
    v = replace_parameters(vehicle, {"stabiliser_bar.time_constant": time_constant})
    t = find_trim(v)
    x = initial_state(
        position=(0, 0, -5),
        attitude=(np.radians(roll_deg), np.radians(pitch_deg), heading),
        bar_attitude=(0, 0),
        rotor_speed=t.rotor_speed,
    )
    flight = simulate_open_loop(v, x, t.input, duration_s=3.0, voltage=7.2)
    return flight.time.values, np.degrees(flight.truth_attitude.values)


@pytest.mark.parametrize("time_constant", [0.2, 0.24])  # the figure's and Table 5.3's
def test_initial_roll_decays_by_the_bar_alone(published, time_constant) -> None:
    time, angle = released(published, time_constant, roll_deg=20.0)
    roll = angle[:, 0]
    assert roll[0] == pytest.approx(20.0)
    assert np.max(np.abs(angle[:, 1:])) < 1e-9  # pitch and yaw stay zero
    assert np.max(np.abs(roll[time >= 2.0])) < 0.5
    assert roll.min() > -13.0
    # The envelope is exp(-t / (2 T)): poles at -1 / (2 T).
    swing = np.abs(roll)
    peaks = [k for k in range(1, len(roll) - 1) if swing[k] > swing[k - 1] and swing[k] > swing[k + 1]]
    rate = -np.polyfit(time[peaks[2:9]], np.log(swing[peaks[2:9]]), 1)[0]
    assert rate == pytest.approx(1 / (2 * time_constant), rel=0.03)


def test_initial_pitch_decays_too_and_slower(published) -> None:
    _, roll = released(published, 0.2, roll_deg=20.0)
    time, pitch = released(published, 0.2, pitch_deg=20.0)
    assert np.max(np.abs(pitch[time >= 2.0, 1])) < 0.6
    # Iyy > Ixx: the pitch swing crosses zero later.
    assert np.argmax(pitch[:, 1] < 0) > np.argmax(roll[:, 0] < 0)


def test_heading_makes_no_difference(published) -> None:
    _, north = released(published, 0.24, roll_deg=20.0)
    _, elsewhere = released(published, 0.24, roll_deg=20.0, heading=2.0)
    assert_allclose(elsewhere[:, 0], north[:, 0], atol=1e-9)
    assert_allclose(elsewhere[:, 2], np.degrees(2.0), atol=1e-9)


def test_without_linkage_nothing_rights_it(published) -> None:
    _, angle = released(replace_parameters(published, {"stabiliser_bar.linkage": 0.0}), 0.24, roll_deg=20.0)
    assert_allclose(angle[:, 0], 20.0, atol=1e-9)
