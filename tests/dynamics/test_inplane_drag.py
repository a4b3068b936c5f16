"""Drag of the rotors in their disc planes: which way it points, what it takes, where its coefficient comes from."""

import tomllib

import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mufly.dynamics import (
    body_to_ned_matrix,
    find_trim,
    linearise_vehicle,
    model_parameters,
    simulate_open_loop,
    state_derivative,
)
from mufly.vehicle import format_vehicle_toml, load_vehicle, replace_parameters


def wrench(vehicle, x, wind):
    """Force (N) and moment (N m) in body axes that a vehicle has more than without this drag."""
    found = []
    for v in (vehicle, replace_parameters(vehicle, {"rotors.inplane_drag": 0.0})):
        p, dx = model_parameters(v, 7.2), np.empty(21)
        state_derivative(x, np.full(4, 0.5), wind, p, dx)
        inertia = np.array([float(p[k]) for k in ("Ixx", "Iyy", "Izz")])
        found.append((float(p["mass"]) * body_to_ned_matrix(x[6:10]).T @ dx[3:6], inertia * dx[10:13]))
    return found[0][0] - found[1][0], found[0][1] - found[1][1]


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_it_takes_power_from_every_motion_and_is_of_the_size_said(vehicle, random_state, seed) -> None:
    rng = np.random.default_rng(seed)
    x, wind = random_state(rng), rng.normal(size=3)
    force, moment = wrench(vehicle, x, wind)
    air = body_to_ned_matrix(x[6:10]).T @ (x[3:6] - wind)
    # Work on hubs at the end of a stiff mast: force times velocity plus moment times rates, in the air's frame.
    assert force @ air + moment @ x[10:13] <= 1e-12
    assert moment[2] == pytest.approx(0.0, abs=1e-9)  # hubs on the mast
    # With both discs square to the mast and no rates: along the edgewise flow and at the rotors' height.
    x[10:15], x[15:18] = 0.0, -body_to_ned_matrix(x[6:10])[:, 2]
    force, moment = wrench(vehicle, x, wind)
    each = 0.0070 * 1.2 * np.pi * 0.0875**3 * x[18:20]
    assert_allclose(force, -each.sum() * air * [1, 1, 0], atol=1e-9)
    assert_allclose(moment, np.cross([0, 0, each @ [-0.091, -0.051]], -air * [1, 1, 0]), atol=1e-9)


def test_a_file_without_it_flies_as_before_and_hover_does_not_know_it(vehicle, published, tmp_path) -> None:
    tables = tomllib.loads(format_vehicle_toml(vehicle))
    del tables["rotors"]["inplane_drag"]
    (tmp_path / "v.toml").write_text(tomli_w.dumps(tables))
    without = load_vehicle(tmp_path / "v.toml")
    assert float(without.rotors.inplane_drag) == 0.0
    assert "inplane_drag" in format_vehicle_toml(without)
    assert_allclose(find_trim(vehicle).input, find_trim(published).input, rtol=1e-12, atol=1e-12)
    start, inputs = find_trim(without).state, (0.67, 0.73, 0.1, 0.05)
    flights = [
        simulate_open_loop(v, start, inputs, duration_s=0.5, wind=(0.5, 0, 0)).truth_position.values
        for v in (without, published, vehicle)
    ]
    assert np.array_equal(flights[0], flights[1])
    assert np.abs(flights[2] - flights[0]).max() > 1e-4


def test_translation_is_a_damped_swing_where_it_was_free(vehicle, published) -> None:
    """Thesis: appendix B, whose horizontal motion is two integrators."""
    lateral = ["u", "v", "phi", "theta", "p", "q", "a_dw", "b_dw", "bar_roll", "bar_pitch"]

    def poles(v):
        full = linearise_vehicle(v).full
        i = [full.state_labels.index(k) for k in lateral]
        return np.linalg.eigvals(full.A[np.ix_(i, i)])

    free, damped = poles(published), poles(vehicle)
    assert np.sum(np.abs(free) < 1e-9) == 4
    assert damped.real.max() == pytest.approx(-0.246, abs=0.001)
    assert np.abs(damped).min() == pytest.approx(1.48, abs=0.01)


def test_the_builtin_coefficient_is_that_of_blade_elements(vehicle) -> None:
    """Blades of muFly made plain (constant chord, no twist, uniform inflow), averaged over a turn numerically.

    It meets the closed form of docs/explanation/dynamics.md, and the file's value
    (`benchmarks/validate_rotors.py inplane-drag`, with the blade's shape, polars and losses) within its deviation.
    """
    sigma, slope, cd, found = 2 * 0.0165 / (np.pi * 0.0875), 5.0, 0.035, []
    hover, wash = find_trim(vehicle), 0.0
    for rotor, speed in zip((vehicle.rotors.upper, vehicle.rotors.lower), hover.rotor_speed, strict=True):
        c_T = float(rotor.thrust_coefficient)
        inflow = np.sqrt(c_T / 2) + wash / speed  # its own, and the upper rotor's at the lower one
        wash = inflow * speed
        pitch = 3 * (2 * c_T / (sigma * slope) + inflow / 2)
        psi, r = np.linspace(0, 2 * np.pi, 64, endpoint=False)[:, None], np.linspace(0, 1, 401)[1:]
        mu = 1e-5
        u = r + mu * np.sin(psi)
        across = (slope * (pitch - inflow / u) * inflow + cd * u) * u  # over rho c (Omega R)^2 / 2
        backwards = across * np.sin(psi) + cd * u * mu * np.cos(psi) ** 2
        found.append(sigma / 2 * np.mean(backwards) / mu)
        assert found[-1] == pytest.approx(sigma / 4 * (slope * pitch * inflow + 1.5 * cd), rel=0.01)
    coefficient = vehicle.rotors.inplane_drag
    assert abs(np.mean(found) - coefficient.value) < coefficient.std, found
