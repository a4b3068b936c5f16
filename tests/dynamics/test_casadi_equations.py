"""The CasADi function equals the compiled equations of motion."""

import numpy as np
import pytest

import mufly
from mufly.dynamics import casadi_model, find_trim, initial_state, model_parameters, state_derivative
from mufly.dynamics.branch_selection import replace_branches_by_selection
from mufly.vehicle import Vehicle, list_builtin_coefficient_maps, list_builtin_flight_maps, replace_parameters

casadi = pytest.importorskip("casadi", reason="CasADi is not installed")


def vehicle_with(**parts: object) -> Vehicle:
    values = {f"rotors.{name}": value for name, value in parts.items() if name != "phase"}
    return replace_parameters(
        mufly.load_vehicle("mufly-1.1"), {**values, "swash_plate.phase": float(parts.get("phase", 0.0))}
    )


CASES = {
    "plain": {},
    "ground effect and phase": {"ground_effect": 1.0, "phase": 0.3},
    "maps": {
        "coefficient_map": list_builtin_coefficient_maps()[0], "flight_map": list_builtin_flight_maps()[0],
        "ground_effect": 0.7,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_derivative_equals_the_compiled_one_over_random_states(name: str) -> None:
    vehicle = vehicle_with(**CASES[name])
    function, p, rng = casadi_model(vehicle), model_parameters(vehicle), np.random.default_rng(0)
    touched = 0
    for _ in range(150):
        x = initial_state(
            position=[0, 0, -rng.uniform(-0.02, 0.2)], velocity=rng.normal(0, 1, 3), attitude=rng.normal(0, 0.5, 3),
            rates=rng.normal(0, 1, 3), rotor_speed=rng.uniform(0, 600, 2), bar_attitude=rng.normal(0, 0.3, 2),
            charge=rng.uniform(0, 1),
        )  # fmt: skip
        x[13:15] = rng.normal(0, 0.1, 2)
        u, wind, expected = rng.uniform(-0.2, 1.2, 4), rng.normal(0, 1, 3), np.empty(21)
        state_derivative(x, u, wind, p, expected)
        assert function(x, u, wind).full().ravel() == pytest.approx(expected, rel=1e-12, abs=1e-12)
        touched += abs(expected[5]) > 20.0
    assert touched > 10  # contact is among the states


def test_jacobian_equals_differences_in_hover() -> None:
    vehicle = mufly.load_vehicle("mufly-1.1")
    hover, p = find_trim(vehicle, charge=0.8), model_parameters(vehicle)
    function = casadi_model(vehicle)
    symbols = casadi.SX.sym("x", 21)
    rate = function(symbols, hover.input, [0, 0, 0])
    jacobian = casadi.Function("j", [symbols], [casadi.jacobian(rate, symbols)])(hover.state).full()
    for k in (4, 7, 10, 18):
        sides = []
        for step in (1e-5, -1e-5):
            x, out = hover.state.copy(), np.empty(21)
            x[k] += step
            state_derivative(x, hover.input, np.zeros(3), p, out)
            sides.append(out)
        assert jacobian[:, k] == pytest.approx((sides[0] - sides[1]) / 2e-5, rel=1e-5, abs=1e-5)


def test_forms_without_a_selection_are_refused() -> None:
    class Compiled:
        @staticmethod
        def py_func(x: float) -> float:
            if x > 0.0:  # noqa: SIM108
                x = 2.0 * x
            else:
                x = -x
            return x

    with pytest.raises(NotImplementedError, match="else"):
        replace_branches_by_selection(Compiled, {})
