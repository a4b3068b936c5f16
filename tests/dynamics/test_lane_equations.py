"""Lanes of vehicles: every vehicle moves as the equations move it alone, to the last bit."""

import math

import numpy as np
import pytest

import mufly
from mufly.compiled.portable_math import sine_cosine
from mufly.dynamics import PARAMETER_DTYPE, integrate_batch, model_parameters, state_derivative
from mufly.dynamics.branch_selection import replace_branches_by_selection
from mufly.dynamics.lane_equations import assign_vehicles_to_blocks, group_vehicles, integrate_lanes
from mufly.dynamics.simulation import normalise_state
from mufly.vehicle import list_builtin_coefficient_maps, list_builtin_flight_maps, replace_parameters

PLAIN_NAMES = {
    "select": lambda test, a, b: a if test else b,
    "any_of": bool,
    "both_of": lambda a, b: a and b,
    "negate": lambda test: not test,
    "require_uniform": bool,
    "whole_number": int,
    "sine_of": lambda x: sine_cosine(x)[0],
    "cosine_of": lambda x: sine_cosine(x)[1],
}
MAP, FLIGHT_MAP = list_builtin_coefficient_maps()[0], list_builtin_flight_maps()[0]
KINDS = (
    {},
    {"rotors.ground_effect": 1.0},
    {"rotors.coefficient_map": MAP},
    {"rotors.coefficient_map": MAP, "rotors.flight_map": FLIGHT_MAP, "rotors.ground_effect": 0.5},
    {"swash_plate.phase": 0.3, "rotors.inplane_drag": 0.0},
)


def integrate_alone(x, u, wind, p, dt, steps):
    """The equations' source in Python, with the sine of lanes."""
    derivative, normalise = (replace_branches_by_selection(f, PLAIN_NAMES) for f in (state_derivative, normalise_state))
    for _ in range(steps):
        slopes = []
        for reach in (0.0, 0.5 * dt, 0.5 * dt, dt):
            stage = x + reach * slopes[-1] if slopes else x
            slopes.append(np.empty(21))
            derivative(stage, u, wind, p, slopes[-1])
        k1, k2, k3, k4 = slopes
        x += dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        normalise(x)


@pytest.fixture(scope="module")
def mixed():
    """Forty vehicles of five kinds in one batch, a quarter of them on the floor."""
    rng, base = np.random.default_rng(7), mufly.load_vehicle("mufly-1.1")
    vehicles = [replace_parameters(base, {**kind, "body.mass": 0.09 + 0.005 * k}) for k, kind in enumerate(KINDS)]
    p = np.array([model_parameters(vehicles[k % 5]) for k in range(40)], dtype=PARAMETER_DTYPE)
    x = np.zeros((40, 21))
    x[:, :3] = rng.normal(0, 1, (40, 3)) - [0, 0, 5]
    x[::4, 2] = rng.uniform(-0.06, 0.01, 10)
    x[:, 3:6], x[:, 10:13] = rng.normal(0, 1, (2, 40, 3))
    x[:, 6:10] = rng.normal(0, 0.2, (40, 4))
    x[:, 6] += 1.0
    x[:, 13:15] = rng.normal(0, 0.15, (40, 2))
    x[:, 15:18] = rng.normal(0, 0.2, (40, 3)) - [0, 0, 1]
    x[:, 18:20], x[:, 20] = rng.uniform(0, 500, (40, 2)), rng.uniform(0, 1, 40)
    x[:8, 18:20] = 0.0
    for row in x:
        normalise_state(row)
    return x, rng.uniform(-0.2, 1.2, (40, 4)), rng.normal(0, 1, (40, 3)), p


def test_every_vehicle_of_a_mixed_batch_moves_as_its_equations_alone(mixed) -> None:
    x, u, wind, p = mixed
    together, alone = x.copy(), x.copy()
    integrate_batch(together, u, wind, p, 1e-3, 4)
    with np.errstate(all="ignore"):
        for k in range(40):
            integrate_alone(alone[k], u[k], wind[k], p[k : k + 1].view(np.recarray)[0], 1e-3, 4)
    assert np.isfinite(together).all()
    assert together.tobytes() == alone.tobytes()


def test_neighbours_do_not_matter(mixed) -> None:
    x, u, wind, p = mixed
    together = x.copy()
    integrate_batch(together, u, wind, p, 1e-3, 50)
    for k in range(0, 40, 7):
        one = slice(k, k + 1)
        alone = x[one].copy()
        integrate_batch(alone, u[one], wind[one], p[one], 1e-3, 50)
        assert alone.tobytes() == together[one].tobytes()


def test_a_broken_neighbour_stays_alone(mixed) -> None:
    x, u, wind, p = (part[:1].repeat(8, axis=0) for part in mixed)
    broken = x.copy()
    broken[3] = math.nan
    broken[5, 13] = 1e6
    whole = x.copy()
    integrate_batch(broken, u, wind, p, 1e-3, 3)
    integrate_batch(whole, u, wind, p, 1e-3, 3)
    assert np.isnan(broken[3]).any()
    assert np.delete(broken, (3, 5), axis=0).tobytes() == np.delete(whole, (3, 5), axis=0).tobytes()


def test_blocks_hold_one_kind_and_every_vehicle_once(mixed) -> None:
    group = group_vehicles(mixed[3])
    blocks = assign_vehicles_to_blocks(group)
    assert len(set(group)) == len(KINDS)
    assert all(len(set(group[row])) == 1 for row in blocks)
    assert sorted(set(blocks.ravel())) == list(range(40))


def test_inputs_change_after_the_delay_and_threads_do_not_matter(mixed) -> None:
    x, u, wind, p = mixed
    before, delay = u[::-1].copy(), np.arange(40) % 11
    blocks, vehicle = assign_vehicles_to_blocks(group_vehicles(p)), np.arange(40)
    at_once, two_cores, in_parts = x.copy(), x.copy(), x.copy()
    for y, threads in ((at_once, 1), (two_cores, 2)):
        integrate_lanes(y, before, u, delay, wind, p, vehicle, blocks, 1e-3, 10, threads=threads)
    for k in range(40):
        one = slice(k, k + 1)
        for inputs, steps in ((before, delay[k]), (u, 10 - delay[k])):
            integrate_batch(in_parts[one], inputs[one], wind[one], p[one], 1e-3, int(steps))
    assert at_once.tobytes() == two_cores.tobytes() == in_parts.tobytes()
