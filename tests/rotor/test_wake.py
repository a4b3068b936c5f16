"""The wake method: Biot and Savart's closed forms, symmetry, momentum, limits, honesty about convergence."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from mufly.errors import InputError, MuflyError
from mufly.rotor import (
    Air,
    OperatingCondition,
    RotorSystem,
    load_rotor,
    prepare_blading,
    solve_rotor,
    solve_system,
)
from mufly.rotor.vortex_tube import compute_wake_radius_ratio
from mufly.rotor.wake import (
    PlacedRotor,
    WakeSettings,
    compute_blade_passing_loads,
    compute_momentum_flux_thrust,
    induced_velocity,
    solve_wake,
)
from mufly.rotor.wake.biot_savart import (
    convert_segments_to_single,
    filament_influence,
    induce_velocity,
    induce_velocity_by_group,
    make_segments,
)
from mufly.rotor.wake.lifting_surface import (
    compute_core_radii,
    extend_filaments,
    free_wake_ages,
    make_lifting_surface,
    prescribe_landgrebe_wake,
)
from mufly.rotor.wake.wake_solver import RotorState, average_mutual_inflow, compute_upper_drag_swirl, initialise_wakes

RPM = np.pi / 30
PITCH = np.radians(14)
COARSE = WakeSettings(chord_deg=15.0, turns=2.0, far_turns=5.0, phases=3, tolerance=5e-3)


@pytest.fixture(scope="module")
def blading():
    return prepare_blading(load_rotor("naca0012-r60-c20"), stations=8)


@pytest.fixture(scope="module")
def single(blading):
    return one(blading)


@pytest.fixture(scope="module")
def pair(blading):
    return two(blading, (6000 * RPM, 6000 * RPM))


def one(blading, pitch=PITCH, speed=6000 * RPM, settings=COARSE, start=None, progress=None, **given):
    at = OperatingCondition(pitch, speed, **given)
    return solve_system(
        RotorSystem.from_single_rotor(blading), at, "wake", settings=settings, start=start, progress=progress
    )


def two(blading, speed, spacing=0.02, settings=COARSE, start=None, **given):
    system = RotorSystem.from_coaxial_pair(blading, blading, spacing_m=spacing)
    return solve_system(system, OperatingCondition(PITCH, speed, **given), "wake", settings=settings, start=start)


# The kernel


def _line(points, core):
    paths = np.asarray(points, dtype=float)[None]
    return make_segments(paths, np.full((1, len(points) - 1), core), np.array([1.0]))


def test_a_long_straight_vortex_turns_the_air_about_itself():
    segments = _line([[0, 0, -1e3], [0, 0, 1e3]], 1e-6)
    v = induce_velocity(np.array([[0.5, 0.0, 0.0], [0.0, 2.0, 10.0]]), segments)
    assert v[0] == pytest.approx([0.0, 1 / (2 * np.pi * 0.5), 0.0], rel=1e-6)
    assert v[1] == pytest.approx([-1 / (2 * np.pi * 2.0), 0.0, 0.0], rel=1e-3)


def test_a_ring_blows_along_its_axis():
    t = np.linspace(0, 2 * np.pi, 721)
    ring = np.column_stack([np.cos(t), np.sin(t), 0 * t])
    z = np.array([0.0, 0.7, 2.0])
    v = induce_velocity(np.column_stack([0 * z, 0 * z, z]), _line(ring, 1e-6))
    np.testing.assert_allclose(v[:, 2], 0.5 / (1 + z**2) ** 1.5, rtol=1e-4)
    np.testing.assert_allclose(v[:, :2], 0.0, atol=1e-12)


def test_a_core_is_that_of_a_thick_vortex():
    core = 0.1
    segments = _line([[0, 0, -1e3], [0, 0, 1e3]], core)
    r = np.array([0.01, 0.1, 0.5])
    v = induce_velocity(np.column_stack([r, 0 * r, 0 * r]), segments)[:, 1]
    s2 = (1.1 * core) ** 2
    np.testing.assert_allclose(v, r * (r**2 + 2 * s2) / (r**2 + s2) ** 2 / (2 * np.pi), rtol=1e-6)
    # Against the integral over the line, from a point beside one end.
    x = np.linspace(0.0, 1.0, 4001)
    d2 = (0.3 - x) ** 2 + 0.05**2
    law = np.trapezoid(0.05 * (d2 + 2.5 * s2) / (d2 + s2) ** 2.5, x) / (4 * np.pi)
    one = induce_velocity(np.array([[0.05, 0.0, 0.3]]), _line([[0, 0, 0], [0, 0, 1]], core))
    assert one[0, 1] == pytest.approx(law, rel=1e-6)


def test_a_vortex_does_not_move_points_on_its_own_line():
    segments = _line([[0, 0, 0], [0, 0, 1]], 1e-9)
    v = induce_velocity(np.array([[0, 0, 0.0], [0, 0, 0.5], [0, 0, 1.0], [0, 0, 3.0]]), segments)
    assert np.all(v == 0.0)


def test_influence_times_strength_is_velocity():
    rng = np.random.default_rng(1)
    paths, points = rng.normal(size=(5, 7, 3)), rng.normal(size=(11, 3))
    core, strength = rng.uniform(0.01, 0.3, (5, 6)), rng.normal(size=5)
    together = induce_velocity(points, make_segments(paths, core, strength))
    np.testing.assert_allclose(
        np.einsum("ijc,j->ic", filament_influence(points, paths, core), strength),
        together,
        rtol=1e-9,
        atol=1e-12,
    )


def test_single_precision_agrees_with_double_at_ends_of_segments_and_far_away():
    # Beside an end of a long segment the squared distance to that end is a small difference of large numbers.
    rng = np.random.default_rng(2)
    paths = 1e-3 * rng.normal(size=(3, 6, 3))
    paths[1, 3] = paths[1, 2]  # a segment without length
    core, strength = np.full((3, 5), 1e-5), rng.normal(size=3)
    beside = paths.reshape(-1, 3) + 2e-5 * rng.normal(size=(18, 3))
    segments = make_segments(paths, core, strength)
    for points, error in ((beside, 3e-5), (paths.reshape(-1, 3), 2e-4), (1e3 * beside, 5e-4)):
        exact = induce_velocity(points, segments)
        single = convert_segments_to_single(segments, 3)
        np.testing.assert_allclose(induce_velocity(points, single), exact, atol=error * np.max(np.abs(exact)))
        each = convert_segments_to_single(make_segments(paths, core, np.ones(3)), 3)
        together = np.einsum("ijc,j->ic", induce_velocity_by_group(points, each), strength)
        np.testing.assert_allclose(together, exact, atol=error * np.max(np.abs(exact)))


# Shape


def test_landgrebes_tip_vortex(blading):
    surface = make_lifting_surface(blading, 0, 0.2, 500.0)
    age = free_wake_ages(3.0, np.radians(15))
    c_T = 0.008
    tip = prescribe_landgrebe_wake(surface, age, c_T, None, 0.0)[-1] / surface.radius_m
    k = round(np.pi / np.radians(15))  # at the next blade
    sigma = 2 * 0.02 * 0.85 / (np.pi * 0.06)
    contraction = 0.78 + 0.22 * np.exp(-(0.145 + 27 * c_T) * np.pi)
    assert np.hypot(*tip[k, :2]) / np.hypot(*tip[0, :2]) == pytest.approx(contraction, abs=0.01)
    assert tip[k, 2] == pytest.approx(-0.25 * c_T / sigma * np.pi, abs=0.06)
    fall = (tip[-1, 2] - tip[2 * k, 2]) / (age[-1] - age[2 * k])
    assert fall == pytest.approx(-1.41 * np.sqrt(c_T / 2), rel=0.01)


def test_filaments_go_on_as_helices_and_cores_grow(blading):
    surface = make_lifting_surface(blading, 0, 0.2, 500.0)
    age = free_wake_ages(2.0, np.radians(15))
    free = prescribe_landgrebe_wake(surface, age, 0.008, None, 0.0)
    paths, ages = extend_filaments(surface, free, age, 4.0, np.radians(30))
    assert ages[-1] == pytest.approx(6 * 2 * np.pi)
    steps = np.diff(paths[:, -5:, 2], axis=1)
    np.testing.assert_allclose(steps, steps[:, :1] * np.ones((1, 4)), rtol=1e-9)
    core = compute_core_radii(surface, ages, np.zeros(paths.shape[0]), 1.5e-5, 0.1, 0.2)
    assert np.all(np.diff(core[:, 1:], axis=1) >= 0)
    assert np.all(core[:, -1] < 0.3 * surface.radius_m)


# One rotor


def test_a_single_rotor_converges_and_says_so(single):
    assert single.converged
    assert "converged" in single.message
    assert single.history.shape == (single.iterations, 3)
    assert single.history[-1, 1] == pytest.approx(single.rotors[0].thrust_N)


def test_loads_are_the_sum_of_the_stations(single):
    r = single.rotors[0]
    assert r.dT_N.sum() == pytest.approx(r.thrust_N)
    assert r.dQ_Nm.sum() == pytest.approx(r.torque_Nm)
    assert 0.0 < r.figure_of_merit < 0.8


def test_the_wake_contracts(single):
    tip = single.wakes[0].filament_paths_m[-3]  # just inboard of the outermost, which winds around it
    radius = np.hypot(tip[:, 0], tip[:, 1]) / single.wakes[0].surface.radius_m
    turn = 1 + round(2 * np.pi / np.radians(COARSE.chord_deg))
    assert 0.6 < np.mean(radius[turn : 2 * turn]) < 0.95


def test_contraction_costs_thrust_against_blade_elements(blading, single):
    momentum = solve_rotor(blading, pitch_rad=np.radians(14), speed_rad_s=6000 * RPM)
    assert 0.8 < single.rotors[0].thrust_N / momentum.thrust_N < 1.0


def test_a_mirrored_rotor_is_a_mirror_image(blading, single):
    other = solve_wake([PlacedRotor(blading, np.radians(14), 6000 * RPM, rotation_sign=-1)], settings=COARSE)
    assert other.rotors[0].thrust_N == single.rotors[0].thrust_N
    points = np.array([[0.03, 0.01, -0.02], [0.05, -0.02, -0.06]])
    mirrored = induced_velocity(other, points * [1, -1, 1])
    np.testing.assert_allclose(mirrored * [1, -1, 1], induced_velocity(single, points), rtol=1e-9, atol=1e-12)


def test_a_turned_rotor_has_a_turned_field(single):
    points = np.array([[0.03, 0.01, -0.02], [0.05, -0.02, -0.06]])
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(
        induced_velocity(single, points @ turn.T, 0.7), induced_velocity(single, points) @ turn.T, rtol=1e-9
    )


def test_a_lifted_rotor_takes_its_wake_along(blading, single):
    high = solve_wake([PlacedRotor(blading, np.radians(14), 6000 * RPM, height_m=0.5)], settings=COARSE)
    assert high.rotors[0].thrust_N == pytest.approx(single.rotors[0].thrust_N, rel=1e-12)
    np.testing.assert_allclose(
        high.wakes[0].filament_paths_m[..., 2] - 0.5, single.wakes[0].filament_paths_m[..., 2], atol=1e-12
    )


def test_without_a_boundary_layer_coefficients_do_not_depend_on_speed(blading):
    how = replace(COARSE, inviscid=True, model="prescribed")
    slow, fast = (one(blading, 0.2, s, how, air=Air(1.2, 1e-12), climb_m_s=0.02 * s * 0.06) for s in (100.0, 900.0))
    assert fast.rotors[0].c_T == pytest.approx(slow.rotors[0].c_T, rel=1e-5)
    assert fast.rotors[0].c_Q == pytest.approx(slow.rotors[0].c_Q, rel=1e-5)


def test_momentum_of_the_wake_is_the_thrust(blading):
    how = WakeSettings(inviscid=True, turns=3.0, step_deg=20.0)
    solution = one(blading, np.radians(12), 5000 * RPM, how)
    assert solution.converged
    thrust = solution.rotors[0].thrust_N
    for height in (-0.018, -0.03):
        assert compute_momentum_flux_thrust(solution, height) == pytest.approx(thrust, rel=0.05)
    with pytest.raises(InputError, match="not below"):
        compute_momentum_flux_thrust(solution, 0.0)
    with pytest.raises(InputError, match="has no wakes"):
        induced_velocity(
            solve_system(RotorSystem.from_single_rotor(blading), OperatingCondition(0.2, 500.0)), [0.0, 0.0, -0.1]
        )


def test_climb_unloads_the_rotor(blading, single):
    climbing = one(blading, climb_m_s=1.0, start=single)
    assert climbing.converged
    assert climbing.rotors[0].thrust_N < 0.95 * single.rotors[0].thrust_N


def test_ground_lifts_and_nothing_flows_through_it(blading, single):
    """At a radius of height rotors lift 7 to 9 % more at the same power (Cheeseman and Bennett; Hayden)."""
    big = blading.rotors[0].radius_m
    low = one(blading, settings=replace(COARSE, ground_m=big, iterations=60), start=single)
    at_power = low.thrust_N / single.thrust_N * (single.power_W / low.power_W) ** (2 / 3)
    assert 1.02 < at_power < 1.14
    plane = np.column_stack((np.linspace(0.1, 3.0, 8) * big, np.full(8, 0.3 * big), np.full(8, -big)))
    v = induced_velocity(low, plane)
    assert np.abs(v[:, 2]).max() < 1e-9 * np.abs(v).max()
    assert min(w.filament_paths_m[..., 2].min() for w in low.wakes) > -big
    far = one(blading, settings=replace(COARSE, ground_m=50 * big), start=single)
    assert far.thrust_N == pytest.approx(single.thrust_N, rel=5e-3)
    with pytest.raises(InputError, match="ground_m"):
        WakeSettings(ground_m=-1.0)


def test_a_warm_start_saves_iterations_and_changes_nothing(blading, single):
    again = one(blading, start=single)
    assert again.iterations < 0.6 * single.iterations
    assert again.rotors[0].thrust_N == pytest.approx(single.rotors[0].thrust_N, rel=3e-3)


def test_an_unfinished_run_says_so_and_keeps_its_history(blading):
    short = replace(COARSE, iterations=5, core_limit=0.2)
    seen = []
    solution = one(blading, 0.2, 500.0, short, progress=lambda *row: seen.append(row))
    assert not solution.converged
    assert "not converged in 5 iterations" in solution.message
    assert len(solution.history) == len(seen) == 5


def test_a_run_that_diverges_stops(blading):
    wild = replace(COARSE, relaxation=1.0, core=0.001, core_limit=0.0, iterations=100, residual=1e-6)
    solution = one(blading, np.radians(2), 500.0, wild)
    assert not solution.converged
    assert solution.iterations == len(solution.history) <= 100
    assert "diverged" in solution.message or "not converged" in solution.message


# Two rotors


def test_the_lower_rotor_works_in_the_upper_ones_stream(pair, single):
    upper, lower = pair.rotors
    assert pair.converged
    assert 0.4 < lower.thrust_N / upper.thrust_N < 0.65
    assert lower.torque_Nm < 0.9 * upper.torque_Nm
    assert upper.thrust_N == pytest.approx(single.rotors[0].thrust_N, rel=0.05)
    assert np.all(lower.alpha_rad[2:-2] < upper.alpha_rad[2:-2])


def test_the_upper_rotors_root_vortex_goes_down_the_shaft(blading):
    # Where nothing holds it, it goes up through the disc with these settings, and the upper thrust has two values.
    both = two(blading, (6000 * RPM, 6000 * RPM), settings=replace(COARSE, phases=6))
    for wake in both.wakes:
        assert np.all(wake.filament_paths_m[0, :, 2] < wake.placed.height_m + 1e-3)


def test_it_does_not_matter_which_rotor_is_named_first_or_turns_which_way(blading, pair):
    turned = solve_wake(
        [
            PlacedRotor(blading, np.radians(14), 6000 * RPM, 0.0, 1),
            PlacedRotor(blading, np.radians(14), 6000 * RPM, 0.02, -1),
        ],
        settings=COARSE,
    )
    assert turned.rotors[0].thrust_N == pytest.approx(pair.rotors[1].thrust_N, rel=0.01)
    assert turned.rotors[1].thrust_N == pytest.approx(pair.rotors[0].thrust_N, rel=0.01)


def test_the_lower_rotor_meets_all_the_turning_that_profile_drag_gave_the_upper_ones_stream(pair):
    upper = pair.rotors[0]
    units = [RotorState(wake.placed, pair.settings) for wake in pair.wakes]
    initialise_wakes(units, pair, 0.0)
    rho = pair.air.density_kg_m3
    for unit in units:
        unit.build_filaments(pair.settings, pair.air.viscosity_Pa_s / rho)
    ways = [(units[1], units[0]), (units[0], units[1])]
    below, above = (compute_upper_drag_swirl(*way, 0.0, pair.settings.phases) for way in ways)
    assert not above.any()
    s, state = units[0].surface, units[0].blade_state
    r, n = s.quarter_chord_m[:, 0], s.chord_m.size
    drag = 0.5 * rho * state.speed_m_s**2 * s.chord_m * state.cd * np.cos(s.pitch_rad - state.alpha_rad)
    torque = s.blade_count * float(np.sum(drag * r * s.panel_width_m))
    assert 0.2 * upper.torque_Nm < torque < 0.45 * upper.torque_Nm
    # What passes the lower disc in a second takes as much along, and turns against the lower rotor.
    through = sum(average_mutual_inflow(units[0], u, s.quarter_chord_m, pair.settings.phases)[:, 2] for u in units)
    narrow = compute_wake_radius_ratio(units[0].placed.height_m - units[1].placed.height_m, s.radius_m)
    at = units[1].surface.quarter_chord_m[:, 0]
    against = -below[n : 2 * n, 1]
    down = np.interp(at / narrow, r, -through) / narrow**2
    moment = rho * float(np.sum(against * at * down * 2 * np.pi * at * units[1].surface.panel_width_m))
    assert moment == pytest.approx(torque, rel=0.05)
    assert (against[at < 0.95 * narrow * s.radius_m] > 0.0).all()
    assert (against[at > 1.1 * narrow * s.radius_m] == 0.0).all()
    # Without drag there is none.
    units[0].blade_state = replace(state, cd=0.0 * state.cd)
    assert not compute_upper_drag_swirl(units[1], units[0], 0.0, pair.settings.phases).any()


def test_passing_blades_average_to_the_mean_loads(pair):
    passing = compute_blade_passing_loads(pair, points=12)
    for k in (0, 1):
        assert passing.thrust_N[k].mean() == pytest.approx(pair.rotors[k].thrust_N, rel=0.02)
    assert np.ptp(passing.thrust_N[1]) > 0.05 * pair.rotors[1].thrust_N
    assert passing.passing_hz == pytest.approx(2 * 2 * 6000 / 60)


def test_trim_balances_the_torques(blading, pair):
    trim = two(blading, (6000 * RPM, None), start=pair)
    upper, lower = trim.rotors
    assert lower.torque_Nm == pytest.approx(upper.torque_Nm, rel=6e-3)
    assert 1.03 < lower.speed_rad_s / upper.speed_rad_s < 1.2
    with pytest.raises(InputError, match="one of upper speed and thrust"):
        two(blading, (6000 * RPM, None), thrust_N=0.4)


# Faults


def test_pairs_that_cannot_be(blading):
    def at(height, hand, pitch=0.2):
        return PlacedRotor(blading, pitch, 500.0, height, hand)

    for rotors, words in (
        ([at(0, 1), at(0, -1)], "is zero"),
        ([at(0, 1), at(0.02, 1)], "same way"),
        ([at(0, 1), at(0.004, -1)], "overlap"),
        ([], "0 given"),
        ([PlacedRotor(blading, 0.2, 0.0)], "speed_rad_s"),
        ([PlacedRotor(blading, 0.2, 500.0, rotation_sign=2)], "hand"),
    ):
        with pytest.raises(InputError, match=words):
            solve_wake(rotors, settings=COARSE)
    with pytest.raises(InputError, match="spacing_m"):
        two(blading, 6000 * RPM, spacing=0.0)


@pytest.mark.parametrize(
    ("key", "value"), [("step_deg", 45.0), ("turns", 0.5), ("model", "rigid"), ("core_limit", 2.0)]
)
def test_settings_that_cannot_be(key, value):
    with pytest.raises(InputError, match=key):
        WakeSettings(**{key: value})


# GPU


def test_the_gpu_kernel_sums_as_the_cpu_does():
    """In Numba's simulator of CUDA, which runs anywhere."""
    script = """
import numpy as np
from mufly.rotor.wake.biot_savart_gpu import induce_velocity_gpu
from mufly.rotor.wake.biot_savart import induce_velocity, make_segments
rng = np.random.default_rng(0)
s = make_segments(rng.normal(size=(2, 6, 3)), np.full((2, 5), 0.1), rng.normal(size=2))
p = rng.normal(size=(5, 3))
np.testing.assert_allclose(induce_velocity_gpu(p, s), induce_velocity(p, s), rtol=1e-9, atol=1e-12)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], env={**os.environ, "NUMBA_ENABLE_CUDASIM": "1"}, capture_output=True, text=True
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_without_a_gpu_there_is_one_line(blading):
    from mufly.rotor.wake.biot_savart_gpu import is_gpu_available

    if is_gpu_available():
        pytest.skip("there is a GPU")
    with pytest.raises(MuflyError, match="no CUDA device"):
        one(blading, 0.2, 500.0, replace(COARSE, gpu=True))
