"""The batched simulator of the fits against the model's own integrator at small steps."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mufly
from mufly.dynamics import (
    PARAMETER_DTYPE,
    euler_from_quaternion,
    find_trim,
    integrate_state,
    model_parameters,
)
from mufly.identify.flight.batch_simulation import _lag_line_coefficients, run_on_cluster, simulate_batch
from mufly.identify.flight_record import FLIGHT_OUTPUTS

SAMPLE = 0.01
N = 400


@pytest.fixture(scope="module")
def case():
    vehicle = mufly.load_vehicle("mufly-1.1")
    hover = find_trim(vehicle)
    p = np.array(model_parameters(vehicle, 7.2), dtype=PARAMETER_DTYPE)
    p["contact_reach"] = -1e9
    t = np.arange(N) * SAMPLE
    u = np.tile(hover.input, (N, 1))
    u[:, 0] += 0.05 * np.sin(2 * np.pi * 0.7 * t)
    u[:, 2] += 0.2 * np.sin(2 * np.pi * 1.3 * t) + 0.05 * np.sign(np.sin(40 * t))
    u[:, 3] += 0.15 * np.cos(2 * np.pi * 0.9 * t)
    x = hover.state.copy()
    x[2] = -5.0
    return p, x, u


def fly(p, x, u, *, delay=0.0, longest=0.01, starts=(0,), motion=None, mast=None, path=None, batch=1):
    if motion is None:
        motion = np.zeros((1, 12))
        motion[0, 2] = -5.0
    mast = np.tile([0.0, 0.0, -1.0], (len(u), 1)) if mast is None else mast
    return simulate_batch(
        np.tile(x, (batch, 1)), np.full(batch, p, dtype=PARAMETER_DTYPE), u, sample_s=SAMPLE,
        codes=np.arange(len(FLIGHT_OUTPUTS)), starts=np.array(starts), motion=np.tile(motion, (batch, 1, 1)), mast=mast,
        delay_s=np.full(batch, delay), path=path, longest_step_s=longest,
    )  # fmt: skip


def reference(p, x, u, delay_ms=0):
    """States at every sample from ``integrate_state`` with steps of 0.1 ms."""
    record, x, calm = p[()], x.copy(), np.zeros(3)
    whole, part = divmod(delay_ms, 10)
    states = [x.copy()]
    for k in range(N - 1):
        integrate_state(x, u[max(k - whole - 1, 0)], calm, record, 1e-4, 10 * part)
        integrate_state(x, u[max(k - whole, 0)], calm, record, 1e-4, 100 - 10 * part)
        states.append(x.copy())
    return np.array(states)


@pytest.mark.parametrize(("delay_ms", "phase"), [(0, 0.0), (13, 0.0), (25, 0.0), (0, 0.4)])
def test_steps_of_10_ms_are_right_to_3e_4_of_the_motion(case, delay_ms, phase):
    p, x, u = case
    p = p.copy()
    p["swash_phase"] = phase
    states = reference(p, x, u, delay_ms)
    y = fly(p, x, u, delay=delay_ms / 1e3)[0]
    truth = np.column_stack([-states[:, 2], euler_from_quaternion(states[:, 6:10])[:, :2], states[:, 10:13]])
    columns = [FLIGHT_OUTPUTS.index(o) for o in ("height", "roll", "pitch", "p", "q", "r")]
    error = np.max(np.abs(y[:, columns] - truth), axis=0) / np.ptp(truth, axis=0)
    assert np.all(error < 3e-4)


def test_rates_converge_with_the_fourth_power_of_the_step(case):
    p, x, u = case
    fine = fly(p, x, u, longest=2.5e-4)[0]
    k = [FLIGHT_OUTPUTS.index(o) for o in ("p", "q", "r")]
    coarse, half = (np.max(np.abs(fly(p, x, u, longest=h)[0] - fine)[:, k], axis=0) for h in (0.01, 0.005))
    assert np.all(coarse > 8 * half)


@pytest.mark.parametrize("z", [1e-6, 0.049, 0.051, 1.0, 10.0, 300.0])
def test_straight_line_has_integral_and_first_moment_of_the_lag(z):
    a, b = _lag_line_coefficients(z)
    exact = solve_ivp(lambda t, y: [np.exp(-z * t), (1 - t) * np.exp(-z * t)], (0, 1), [0, 0], rtol=1e-11, atol=1e-14)
    assert a + b / 2 == pytest.approx(exact.y[0, -1], rel=2e-7)
    assert a / 2 + b / 6 == pytest.approx(exact.y[1, -1], rel=2e-7)


def test_batch_is_the_single_flight_many_times(case):
    p, x, u = case
    assert np.array_equal(fly(p, x, u, batch=5, delay=0.004), np.tile(fly(p, x, u, delay=0.004), (5, 1, 1)))


def test_a_delay_of_whole_samples_shifts_the_inputs(case):
    p, x, u = case
    shifted = np.vstack([u[:1], u[:1], u[:-2]])
    assert np.allclose(fly(p, x, u, delay=0.02), fly(p, x, shifted), rtol=0, atol=1e-9)


def test_delay_acts_smoothly_across_a_whole_sample(case):
    p, x, u = case
    k = FLIGHT_OUTPUTS.index("p")
    values = [fly(p, x, u, delay=d)[0, 200, k] for d in (0.0199, 0.02, 0.0201)]
    assert values[2] - values[1] == pytest.approx(values[1] - values[0], rel=0.05)


def test_a_nanosecond_more_of_a_whole_sample_has_the_slope_of_a_millisecond(case):
    p, x, u = case
    k = FLIGHT_OUTPUTS.index("p")
    at, tiny, small = (fly(p, x, u, delay=d)[0, :, k] for d in (0.02, 0.02 + 1e-9, 0.02 + 1e-4))
    slope, wanted = (tiny - at) / 1e-9, (small - at) / 1e-4
    assert np.linalg.norm(slope - wanted) < 0.02 * np.linalg.norm(wanted)


def test_a_window_that_starts_where_the_flight_is_changes_nothing_but_the_bar(case):
    p, x, u = case
    states = reference(p, x, u)
    k = 150
    a = euler_from_quaternion(states[:, 6:10])
    motion = np.zeros((2, 12))
    motion[0, 2] = -5.0
    motion[1] = np.concatenate([states[k, :6], a[k], states[k, 10:13]])
    cr, sr, cp, sp = np.cos(a[:, 0]), np.sin(a[:, 0]), np.cos(a[:, 1]), np.sin(a[:, 1])
    cy, sy = np.cos(a[:, 2]), np.sin(a[:, 2])
    mast = -np.column_stack([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr])
    whole = fly(p, x, u)[0]
    columns = [FLIGHT_OUTPUTS.index(o) for o in ("height", "roll", "p", "q", "r", "speed_up")]
    # Rotors that drag in their discs feel a drift that nobody measured: it follows from the attitude.
    path = np.column_stack([states[:, :6], a, states[:, 10:13]])
    path[:, [0, 1, 3, 4]] = 0.0
    drifting = motion.copy()
    drifting[1, 3:5] = 0.0
    assert p["inplane"] > 0.0
    assert np.hypot(*states[k, 3:5]) > 0.1
    for way, least in (({"motion": motion}, 2e-3), ({"motion": drifting, "path": path}, 4e-3)):
        cut = fly(p, x, u, starts=(0, k), mast=mast, **way)[0]
        assert np.allclose(cut[:k, columns], whole[:k, columns], atol=0)
        off = np.max(np.abs(cut - whole)[:, columns], axis=0)
        assert np.all(off < least * np.ptp(whole[:, columns], axis=0))


def test_a_flight_that_diverges_ends_in_large_numbers_not_nan(case):
    p, x, u = case
    p = p.copy()
    p["Izz"] *= 1e-6
    y = fly(p, x, np.clip(u + np.array([0.3, -0.3, 0, 0]), 0, 1))
    assert np.all(np.isfinite(y))
    assert y[0, -1, 0] == 1e6


def test_a_cluster_flies_the_same(case):
    distributed = pytest.importorskip("distributed", reason="dask.distributed, an extra, is not installed")
    p, x, u = case
    here = fly(p, x, u, batch=11, delay=0.012)
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster,
        run_on_cluster(cluster.scheduler_address),
    ):
        there = fly(p, x, u, batch=11, delay=0.012)
    np.testing.assert_array_equal(there, here)
