"""Flight maps: loads of a pair over edgewise velocity, climb and rates."""

import numba
import numpy as np
import pytest

from mufly.rotor import load_rotor, prepare_blading
from mufly.rotor.forward import ForwardCondition, make_flap_mode, solve_forward_pair
from mufly.rotor.forward.edgewise_map import compute_flight_map_loads, make_edgewise_axis
from mufly.rotor.forward.row_sums import sum_flow_rows, sum_rate_rows

KNEE, MEAN, PITCH, RADIUS = 0.1125, 410.0, (0.2636, 0.2627), 0.0875


@pytest.fixture(scope="module")
def blading():
    return prepare_blading(load_rotor("walkera-5g6"), n_crit=0.1)


def compute(blading, ratio=1.6, **changes):
    flap = make_flap_mode(blading.rotors[0], ratio)
    given = {
        "pitch_rad": PITCH, "spacing_m": 0.04, "mean_speed_rad_s": MEAN, "ratio": [1.18], "climb_ratio": [0.0],
        "knee": KNEE, "edgewise": make_edgewise_axis(KNEE, 4)[:3], **changes,
    }  # fmt: skip
    tables, missing = compute_flight_map_loads(blading, blading, (flap, flap), **given)
    assert missing == 0
    return tables.loads.reshape(3, 2, 10)


@pytest.fixture(scope="module")
def loads(blading):
    return compute(blading)


def test_loads_are_those_of_the_pair(blading, loads):
    up = 2.0 * MEAN / 2.18
    flap = make_flap_mode(blading.rotors[0], 1.6)
    e = make_edgewise_axis(KNEE, 4)[2]
    speed = KNEE * np.sqrt(e / (1.0 - e)) * MEAN * RADIUS
    conditions = [
        (ForwardCondition(PITCH[0], up, v), ForwardCondition(PITCH[1], 1.18 * up, v, rotation_sign=-1))
        for v in (0.0, speed)
    ]
    rest, pair = (solve_forward_pair(blading, blading, c, (flap, flap), spacing_m=0.04) for c in conditions)
    for k, side in enumerate(("upper", "lower")):
        at, axial = getattr(pair, side), getattr(rest, side)
        force = 1.2 * np.pi * RADIUS**3 * at.speed_rad_s * speed
        assert loads[2, k, 0] == pytest.approx(at.thrust_N / axial.thrust_N - 1.0, abs=2e-3)
        assert loads[2, k, 1] == pytest.approx(at.torque_Nm / axial.torque_Nm - 1.0, abs=2e-3)
        assert loads[2, k, 2:4] * force == pytest.approx([at.h_force_N, at.y_force_N], rel=1e-3, abs=1e-6)
        moments = np.array([at.roll_moment_Nm, at.pitch_moment_Nm])
        assert loads[2, k, 4:6] * force * RADIUS == pytest.approx(moments, rel=1e-3, abs=1e-8)


def test_hover_has_no_excess_and_flow_and_rates_are_damped(loads):
    assert np.array_equal(loads[0, :, :2], np.zeros((2, 2)))
    assert np.all(np.diff(loads[:, :, 0], axis=0) > 0.0)  # translational lift
    assert np.all(loads[:, :, 2] > 0.0)
    assert np.all(loads[:, :, 8] < 0.0)
    assert np.all(loads[:, :, 5] > 0.0)  # blow-back lifts the nose
    # Gyroscopic coupling: the pair's parts cancel up to the air's.
    assert np.all(loads[:, 0, 9] * loads[:, 1, 9] < 0.0)


def test_mirrored_pair(blading, loads):
    mirrored = compute(blading, upper_sign=-1)
    odd = np.array([1, 1, 1, -1, -1, 1, -1, 1, 1, -1])
    assert mirrored[..., :6] == pytest.approx((odd * loads)[..., :6], abs=1e-6)
    assert mirrored[..., 6:] == pytest.approx((odd * loads)[..., 6:], abs=2e-4)  # by differences of one direction


def test_free_hinge_has_no_hub_moments(blading):
    free = compute(blading, 1.0)
    assert np.abs(free[:, :, [4, 5, 8, 9]]).max() < 1e-8
    assert np.all(free[:, 0, 7] < -0.005)  # the disc lags behind a roll: the force opposes it at the hub above
    assert np.all(free[:, :, 2] > 0.0)


def test_stream_that_misses_the_lower_disc_leaves_it_alone(blading):
    far = compute(blading, spacing_m=1.0)[2]
    near = compute(blading)[2]
    # Far below, the displaced stream meets nothing: the lower rotor has no more lift to gain than the upper one.
    assert near[1, 0] > 2.0 * near[0, 0]
    assert np.all(np.isfinite(far))


def test_rows_summed_in_vectors_are_those_of_the_source_to_the_last_bit():
    rng = np.random.default_rng(8)
    table, weights = rng.normal(size=700), rng.normal(size=8)
    flow = numba.njit(lambda t, a, b, s, w: sum_flow_rows(t, a, b, s, w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]))
    rate = numba.njit(lambda t, a, w: sum_rate_rows(t, a, w[0], w[1], w[2]))
    for first, later, stride in ((0, 300, 96), (1, 431, 121)):  # aligned in memory, and not
        assert flow(table, first, later, stride, weights) == sum_flow_rows(table, first, later, stride, *weights)
        assert rate(table, first, weights) == sum_rate_rows(table, first, *weights[:3])
