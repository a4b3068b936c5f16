"""The flight model with a coefficient map: limits, physics, and everything that calls the equations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from mufly.dynamics import (
    body_to_ned_matrix,
    find_longest_stable_step,
    find_trim,
    hover_performance,
    initial_state,
    linearise_vehicle,
    model_parameters,
    simulate_open_loop,
    state_derivative,
)  # fmt: skip
from mufly.dynamics.equations_of_motion import (
    bound_map_coefficient,
    compute_axial_climb_velocity,
    is_inside_coefficient_map,
    rotor_loads,
)
from mufly.errors import InputError
from mufly.vehicle import CoefficientMap, MapTables, load_coefficient_map, replace_parameters
from mufly.vehicle.coefficient_map import format_map_table

CALM = np.zeros(3)
NAMES = ("thrust_up", "thrust_dw", "torque_up", "torque_dw")


def made_map(function, speeds=(250.0, 450.0, 650.0), n=9) -> CoefficientMap:
    """Map of ``function(mean, ratio, climb_ratio)`` -> c_T, c_Q of upper and lower."""
    axes = (np.array(speeds), np.linspace(0.6, 1.6, n), np.linspace(-0.03, 0.09, n))
    grid = np.meshgrid(*axes, indexing="ij")
    values = [np.broadcast_to(v, grid[0].shape) for v in function(*grid)]
    table = format_map_table(MapTables(*axes, *values, np.ones(grid[0].shape, dtype=bool)))
    return CoefficientMap(
        name="made", method="other", upper="a", lower="a", radius_m=0.0875, spacing_m=0.04, upper_pitch_deg=14,
        lower_pitch_deg=14, density_kg_m3=1.2, viscosity_Pa_s=1.81e-5, table=table,
    )  # fmt: skip


def with_map(vehicle, coefficients, level="computed"):
    rotors = vehicle.rotors.model_copy(update={"coefficient_map": coefficients, "map_level": level})
    return vehicle.model_copy(update={"rotors": rotors})


@pytest.fixture(scope="module")
def mapped(vehicle):
    return replace_parameters(vehicle, {"rotors.coefficient_map": "walkera-5g6-bemt"})


@pytest.fixture(scope="module")
def scaled(mapped):
    return replace_parameters(mapped, {"rotors.map_level": "constants"})


def test_a_constant_map_is_the_constants(vehicle, random_state) -> None:
    r = vehicle.rotors
    c = [float(v) for q in (r.upper, r.lower) for v in (q.thrust_coefficient, q.torque_coefficient)]
    flat = with_map(vehicle, made_map(lambda *_: c))
    p, q = model_parameters(vehicle), model_parameters(flat)
    rng = np.random.default_rng(3)
    a, b = np.empty(21), np.empty(21)
    for _ in range(20):
        x, u = random_state(rng), rng.uniform(0, 1, size=4)
        state_derivative(x, u, CALM, p, a)
        state_derivative(x, u, CALM, q, b)
        assert_allclose(b, a, rtol=1e-9, atol=1e-7)
    assert_allclose(find_trim(flat).state, find_trim(vehicle).state, rtol=1e-7, atol=1e-9)
    assert find_longest_stable_step(q) == pytest.approx(find_longest_stable_step(p), rel=1e-9)


@settings(max_examples=40)
@given(st.floats(150, 700), st.floats(150, 700), st.floats(-4, 6), st.sampled_from(["computed", "constants"]))
def test_loads_are_the_coefficients_times_the_squares(vehicle, up, dw, climb, level) -> None:
    # A map that is linear in ratio and climb is interpolated exactly; beyond its edges it stays what it is there.
    def linear(_, r, m):
        return 0.014 - 0.002 * r - 0.05 * m, 0.0019 + 0 * r, 0.004 + 0.006 * r - 0.04 * m, 0.0012 + 0.0005 * r

    v = with_map(vehicle, made_map(linear), level)
    p = model_parameters(v)
    mean = 0.5 * (up + dw)
    r, m = np.clip(dw / up, 0.6, 1.6), np.clip(climb / (mean * 0.0875), -0.03, 0.09)
    c = np.array(linear(0, r, m))
    if level == "constants":
        # Scaled so that eq. 5.1's hover has the constants.
        at_hover = np.sqrt(0.0025 / 0.0018)
        c = c * np.array([0.0138, 0.0025, 0.0117, 0.0018]) / np.array(linear(0, at_hover, 0.0))
    unit = np.pi * 1.2 * 0.0875**4
    expected = unit * c * np.array([up**2, 0.0875 * up**2, dw**2, 0.0875 * dw**2])
    assert_allclose(np.array(rotor_loads(p, up, dw, climb))[[0, 2, 1, 3]], expected, rtol=1e-5)
    inside = 0.6 <= dw / up <= 1.6 and -0.03 <= climb / (mean * 0.0875) <= 0.09 and 250 <= mean <= 650
    assert is_inside_coefficient_map(v, up, dw, climb) == inside


def test_the_equations_use_the_loads(mapped, random_state) -> None:
    # Force along the mast and torque about it, at random states: what rotor_loads says and nothing else.
    none = {"body.downwash_drag": 0.0, "rotors.inplane_drag": 0.0}
    bare = replace_parameters(mapped, {f"body.drag_area_{k}": 0.0 for k in "xyz"} | none)
    p, dx = model_parameters(bare), np.empty(21)
    rng = np.random.default_rng(11)
    for _ in range(20):
        x, wind = random_state(rng), rng.normal(size=3)
        x[13:15] = 0.0
        x[15:18] = -body_to_ned_matrix(x[6:10])[:, 2]
        state_derivative(x, np.zeros(4), wind, p, dx)
        climb = -body_to_ned_matrix(x[6:10])[:, 2] @ (x[3:6] - wind)
        assert compute_axial_climb_velocity(x, wind) == pytest.approx(climb, abs=1e-12)
        t_up, t_dw, q_up, q_dw = rotor_loads(p, x[18], x[19], climb)
        along = -body_to_ned_matrix(x[6:10])[:, 2] @ (dx[3:6] - [0, 0, 9.81])
        assert 0.095 * along == pytest.approx(t_up + t_dw, rel=1e-9)
        yaw = q_up + p["Jreact_up"] * dx[18] - q_dw - p["Jreact_dw"] * dx[19]
        gyro = (p["Iyy"] - p["Ixx"]) * x[10] * x[11]
        assert p["Izz"] * dx[12] == pytest.approx(yaw - gyro, rel=1e-9, abs=1e-12)


def test_rotors_at_rest_and_turning_slowly_make_finite_loads(mapped) -> None:
    p, dx = model_parameters(mapped), np.empty(21)
    for speeds in ((0, 0), (0, 100), (100, 0), (1e-9, 0), (-1e-6, 1e-6)):
        for velocity in (-20.0, 0.0, 20.0):
            x = initial_state(position=(0, 0, -50), velocity=(0, 0, velocity), rotor_speed=speeds)
            state_derivative(x, np.ones(4), CALM, p, dx)
            assert np.all(np.isfinite(dx))
            assert np.all(np.isfinite(rotor_loads(p, *speeds, -velocity)))
    assert_array_equal(rotor_loads(p, 0.0, 0.0, 3.0), 0.0)


def test_physics_of_the_pair(mapped) -> None:
    p = model_parameters(mapped)
    hover = rotor_loads(p, 420.0, 440.0)
    up = [rotor_loads(p, 420.0, 440.0, v) for v in (0.5, 1.0, 2.0, 3.0)]
    total = [hover[0] + hover[1], *(c[0] + c[1] for c in up)]
    assert np.all(np.diff(total) < 0)  # climb lowers the thrust
    faster = rotor_loads(p, 460.0, 440.0)
    assert faster[1] < hover[1]  # more downwash on the lower rotor
    assert faster[0] > hover[0]
    assert rotor_loads(p, 420.0, 480.0)[0] < hover[0]  # the lower rotor draws air through the upper one


def test_thrust_over_climb_falls_like_figure_4_2(mapped) -> None:
    # c_T falls with the inflow, more slowly in descent than in climb, and by little within the figure's 1 m/s.
    p = model_parameters(mapped)
    at = {v: sum(rotor_loads(p, 420.0, 440.0, v)[:2]) for v in (-1.0, 0.0, 1.0)}
    assert 0.0 < at[-1.0] / at[0.0] - 1.0 < 1.0 - at[1.0] / at[0.0] < 0.15


@pytest.mark.parametrize("name", ["mapped", "scaled"])
def test_everything_works_with_a_map(name, request, vehicle) -> None:
    v = request.getfixturevalue(name)
    t, p = find_trim(v), model_parameters(v)
    assert t.inside_map
    assert t.thrust_N.sum() == pytest.approx(0.095 * 9.81 + 0.009, rel=1e-7)
    assert t.torque_Nm[0] == pytest.approx(t.torque_Nm[1], rel=1e-7)
    flight = simulate_open_loop(v, t.state - np.eye(21)[2] * 5, t.input, duration_s=1.0, voltage=7.2)
    assert_allclose(flight.truth_position.values[-1], [0, 0, -5], atol=1e-6)
    h = hover_performance(v)
    assert 1.1 < h.thrust_to_weight_half < 1.8
    linear = linearise_vehicle(v).full
    assert np.all(np.isfinite(linear.A))
    assert 1e-3 < find_longest_stable_step(p) < 4e-3
    if name == "scaled":  # the constants hold at hover
        assert_allclose(t.rotor_speed, find_trim(vehicle).rotor_speed, rtol=1e-6)
        assert_allclose(t.input, find_trim(vehicle).input, atol=1e-6)


def test_heave_is_damped_and_linearise_sees_the_slopes(mapped, vehicle) -> None:
    t, p = find_trim(mapped), model_parameters(mapped, 7.2)
    heave = linearise_vehicle(mapped).heave_yaw
    w, lower, upper = (heave.state_labels.index(s) for s in ("w", "Omega_dw", "Omega_up"))
    a = heave.A[w, w]
    assert -2.0 < a < -0.2
    assert abs(linearise_vehicle(vehicle).heave_yaw.A[w, w]) < 1e-6  # constants know no damping
    h = 1e-5  # at the scale of linearise's own steps: the curvature jumps at hover, a point of the map

    def thrust(up=0.0, dw=0.0, climb=0.0):
        return sum(rotor_loads(p, t.rotor_speed[0] + up, t.rotor_speed[1] + dw, climb)[:2])

    # w is positive downwards, so damping is dT/dclimb over the mass; the other two lift against +z.
    assert a == pytest.approx((thrust(climb=h) - thrust(climb=-h)) / (2 * h * 0.095), rel=1e-4)
    assert heave.A[w, lower] == pytest.approx(-(thrust(dw=400 * h) - thrust(dw=-400 * h)) / (800 * h * 0.095), rel=1e-4)
    assert heave.A[w, upper] == pytest.approx(-(thrust(up=400 * h) - thrust(up=-400 * h)) / (800 * h * 0.095), rel=1e-4)


def test_a_fast_climb_needs_more_input_than_the_constants_say(scaled, vehicle) -> None:
    assert_allclose(find_trim(scaled).motor_input, find_trim(vehicle).motor_input, atol=1e-6)
    fast, constant = (find_trim(v, velocity=(0, 0, -2.0)).motor_input for v in (scaled, vehicle))
    assert np.all(fast > constant + 0.05)
    slow, constant = (find_trim(v, velocity=(0, 0, -0.2)).motor_input for v in (scaled, vehicle))
    assert np.all(np.abs(slow - constant) < 0.02)  # Sec. 4.3.1: constants do below 0.5 m/s


def test_bounds_hold_everywhere(mapped) -> None:
    p, rng = model_parameters(mapped), np.random.default_rng(9)
    for k, name in enumerate(NAMES):
        greatest, per_speed, per_climb = bound_map_coefficient(p, name)
        own = k % 2
        for _ in range(200):
            up, dw, climb = rng.uniform(200, 700), rng.uniform(200, 700), rng.uniform(-3, 5)
            omega, h = (up, dw)[own], 1e-4
            shift = np.eye(2)[own] * h
            low, high = (rotor_loads(p, *(np.array([up, dw]) + s), climb)[k] for s in (-shift, shift))
            assert abs(high - low) / (2 * h) < 1.3 * per_speed * omega  # cubics overshoot chords a little
            slope = (rotor_loads(p, up, dw, climb + h)[k] - rotor_loads(p, up, dw, climb - h)[k]) / (2 * h)
            assert abs(slope) < 1.3 * per_climb * omega
            assert abs(rotor_loads(p, up, dw, climb)[k]) < 1.05 * greatest * omega**2


def test_a_map_without_lift_at_hover_cannot_be_scaled(vehicle) -> None:
    with pytest.raises(InputError, match="zero thrust"):
        model_parameters(with_map(vehicle, made_map(lambda *_: (-0.01, 0.001, 0.01, 0.001)), "constants"))


def test_the_builtin_map_is_for_the_builtin_rotor() -> None:
    m = load_coefficient_map("walkera-5g6-bemt")
    assert m.radius_m == pytest.approx(0.0875)
    assert np.mean(m.decode_map_tables().solved) > 0.95
