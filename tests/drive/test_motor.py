"""Motor with gear and rotor against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.drive import armature_current, rotor_acceleration

KE, KM, R, GEAR, ETA, DR, J, MF = 0.0045, 0.0035, 1.3811, 1.5, 0.84, 5.2107e-7, 2.11e-5, 2e-4


def test_stall_and_no_load() -> None:
    assert armature_current(0.5, 7.2, 0.0, KE, R, GEAR) == pytest.approx(3.6 / R)
    free = 0.5 * 7.2 / (KE * GEAR)
    assert armature_current(0.5, 7.2, free, KE, R, GEAR) == pytest.approx(0.0, abs=1e-12)


@given(duty=st.floats(0.1, 1.0), drag=st.floats(1e-8, 2e-7), gear=st.floats(1.0, 4.0))
def test_steady_speed_solves_the_quadratic(duty, drag, gear) -> None:
    # kM (d U - kE i W) / (i R) - dR W - c W^2 / (i^2 eta) = 0
    a, b, c = drag / (gear**2 * ETA), DR + KM * KE / R, -KM * duty * 7.2 / (gear * R)
    speed = (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a)
    current = armature_current(duty, 7.2, speed, KE, R, gear)
    found = rotor_acceleration(current, speed, drag * speed**2, KM, DR, 0.0, gear, ETA, J)
    assert found == pytest.approx(0.0, abs=1e-7 * KM * 5 / J)


def test_acceleration_is_eq_4_29() -> None:
    speed, torque, current = 376.0, 0.0068, 1.6
    expected = (KM * current / GEAR - DR * speed - torque / (GEAR**2 * ETA)) / J
    assert rotor_acceleration(current, speed, torque, KM, DR, 0.0, GEAR, ETA, J) == pytest.approx(expected, rel=1e-14)
    rubbing = [rotor_acceleration(0.0, w, 0.0, KM, 0.0, MF, GEAR, ETA, J) for w in (speed, 3.0, 0.0, -3.0)]
    assert rubbing == pytest.approx(np.array([-1, -1, 0, 1]) * MF / (GEAR * J), rel=1e-12)


def test_in_shaft_terms_the_gear_trades_speed_for_torque() -> None:
    # Times i^2 it is the rotor's own balance: i^2 J dW/dt = i kM I - i^2 dR W - Q / eta.
    speed, torque, current = 300.0, 0.005, 1.2
    rotor = (GEAR * KM * current - GEAR**2 * DR * speed - torque / ETA) / (GEAR**2 * J)
    assert rotor_acceleration(current, speed, torque, KM, DR, 0.0, GEAR, ETA, J) == pytest.approx(rotor, rel=1e-12)
