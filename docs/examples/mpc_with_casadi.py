"""Fly a step of 1 m by nonlinear model predictive control, on the CasADi function of the flight model.

    python mpc_with_casadi.py

The prediction has a slower swash plate than the vehicle (20 ms instead of 1 ms), so that Runge-Kutta steps of 25 ms are
stable. The simulated vehicle is the full model at steps of 1 ms. A solution takes longer than the period of 50 ms: the
example shows the method, not a controller for a board.
"""

from __future__ import annotations

import time

import casadi
import numpy as np

import mufly
from mufly.dynamics import casadi_model, find_trim, integrate_state, model_parameters
from mufly.vehicle import replace_parameters

PERIOD_S, HORIZON, STEPS = 0.05, 20, 2
"""Period of the controller, intervals of the horizon, Runge-Kutta steps in an interval."""


def predict_interval(derivative: casadi.Function) -> casadi.Function:
    """Return the state after an interval of constant input."""
    state, inputs, wind = casadi.SX.sym("x", 21), casadi.SX.sym("u", 4), casadi.SX.zeros(3)
    x, h = state, PERIOD_S / STEPS
    for _ in range(STEPS):
        k1 = derivative(x, inputs, wind)
        k2 = derivative(x + 0.5 * h * k1, inputs, wind)
        k3 = derivative(x + 0.5 * h * k2, inputs, wind)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + derivative(x + h * k3, inputs, wind))
    return casadi.Function("interval", [state, inputs], [x])


def make_controller(interval: casadi.Function, trim: np.ndarray) -> casadi.Function:
    """Return the solver: state, target position and guess of the inputs (4, HORIZON) to inputs."""
    start, target, inputs = casadi.SX.sym("x0", 21), casadi.SX.sym("target", 3), casadi.SX.sym("u", 4, HORIZON)
    x, cost, before = start, 0.0, casadi.DM(trim)
    for k in range(HORIZON):
        u = inputs[:, k]
        x = interval(x, u)
        cost += 4.0 * casadi.sumsqr(x[:3] - target) + casadi.sumsqr(x[3:6]) + 0.2 * casadi.sumsqr(x[10:13])
        cost += 2.0 * x[9] ** 2 + 0.5 * casadi.sumsqr(u - trim) + 0.5 * casadi.sumsqr(u - before)
        before = u
    cost += 40.0 * casadi.sumsqr(x[:3] - target) + 10.0 * casadi.sumsqr(x[3:6])
    problem = {"x": casadi.vec(inputs), "p": casadi.vertcat(start, target), "f": cost}
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.max_iter": 8,
             "show_eval_warnings": False, "ipopt.hessian_approximation": "limited-memory"}  # fmt: skip
    return casadi.nlpsol("mpc", "ipopt", problem, quiet)


def main() -> None:
    vehicle = mufly.load_vehicle("mufly-1.1")
    hover = find_trim(vehicle, charge=0.8)
    slow = replace_parameters(vehicle, {"swash_plate.time_constant": 0.02})
    solver = make_controller(predict_interval(casadi_model(slow, hover.battery_voltage_V)), hover.input)
    p, x, target = model_parameters(vehicle), hover.state.copy(), np.array([1.0, 0.0, -1.0])
    x[2] = -1.0
    guess = np.tile(hover.input, HORIZON)
    low, high = np.tile([0.0, 0.0, -1.0, -1.0], HORIZON), np.ones(4 * HORIZON)
    track, taken = [x.copy()], []
    for _ in range(round(4.0 / PERIOD_S)):
        begin = time.perf_counter()
        found = solver(x0=guess, p=np.concatenate([x, target]), lbx=low, ubx=high)["x"].full().ravel()
        taken.append(time.perf_counter() - begin)
        integrate_state(x, found[:4].copy(), np.zeros(3), p, 1e-3, round(PERIOD_S * 1e3))
        guess = np.concatenate([found[4:], found[-4:]])
        track.append(x.copy())
    north = np.array(track)[:, 0]
    reached = PERIOD_S * int(np.argmax(north > 0.9))
    last = float(np.linalg.norm(track[-1][:3] - target))
    print(f"0.9 m after {reached:.2f} s, overshoot {100.0 * (north.max() - 1.0):.0f} cm, error {100.0 * last:.1f} cm "
          f"after 4 s; {1e3 * np.median(taken):.0f} ms a solution")  # fmt: skip


if __name__ == "__main__":
    main()
