"""The whole right-hand side against a plain transcription in vectors and matrices, in random states.

Written from chapter 4 (read as the errata say), not from the compiled code: body velocities and eq. A.5, one function a
force, no common subexpressions.
"""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mufly.dynamics import GRAVITY, body_to_ned_matrix, model_parameters, state_derivative

X, Y, Z = np.eye(3)


def about(axis, angle):
    """Rotation by ``angle`` about x or y (Rodrigues)."""
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def transcription(vehicle, x, u, wind, voltage):
    f = float
    body, up, dw, motor = vehicle.body, vehicle.rotors.upper, vehicle.rotors.lower, vehicle.motor
    rho, R = f(vehicle.air.density), f(vehicle.rotors.radius)
    A = body_to_ned_matrix(x[6:10])
    rates, inertia = x[10:13], np.diag([f(body.inertia_xx), f(body.inertia_yy), f(body.inertia_zz)])

    def thrust(rotor, speed):
        return f(rotor.thrust_coefficient) * np.pi * rho * R**4 * speed**2

    def torque(rotor, speed):
        return f(rotor.torque_coefficient) * np.pi * rho * R**5 * speed**2

    def acceleration(rotor, speed, duty):
        i, kM, kE = f(vehicle.gear.ratio), f(motor.torque_constant), f(motor.back_emf_constant)
        drive = (kM * voltage * duty - kM * kE * i * speed) / (i * f(motor.resistance))
        load = torque(rotor, speed) / (i**2 * f(vehicle.gear.efficiency))
        return (drive - f(motor.friction) * speed - load) / f(rotor.drive_inertia)

    mast, bar = -Z, A.T @ x[15:18]
    lean = f(vehicle.stabiliser_bar.linkage) * (bar - (bar @ mast) * mast)
    air = A.T @ (x[3:6] - wind)

    def load(rotor, normal, speed):
        hub = air + np.cross(x[10:13], f(rotor.hub_z) * Z)
        across = hub - (hub @ normal) * normal
        drag = f(vehicle.rotors.inplane_drag) * rho * np.pi * R**3 * speed * across
        return thrust(rotor, speed) * normal - drag

    T_up = load(up, lean + np.sqrt(1 - lean @ lean) * mast, x[18])
    T_dw = load(dw, about(X, x[13]) @ about(Y, x[14]) @ -Z, x[19])
    areas = np.array([f(body.drag_area_x), f(body.drag_area_y), f(body.drag_area_z)])
    downwash = min(1.0, (thrust(up, x[18]) + thrust(dw, x[19])) / (f(body.mass) * GRAVITY / 2))
    F = T_up + T_dw + A.T @ (f(body.mass) * GRAVITY * Z)
    F = F + f(body.downwash_drag) * downwash * Z - rho / 2 * areas * np.abs(air) * air

    speed_rates = np.array([acceleration(up, x[18], u[0]), acceleration(dw, x[19], u[1])])
    M = np.cross(f(up.hub_z) * Z, T_up) + np.cross(f(dw.hub_z) * Z, T_dw)
    M = M + (torque(up, x[18]) + f(up.reaction_inertia) * speed_rates[0]) * Z
    M = M - (torque(dw, x[19]) + f(dw.reaction_inertia) * speed_rates[1]) * Z

    body_velocity = A.T @ x[3:6]
    body_acceleration = F / f(body.mass) - np.cross(rates, body_velocity)  # A.5
    full = f(vehicle.swash_plate.linkage) * f(vehicle.swash_plate.max_tilt)
    axis = -A @ Z
    return {
        "velocity": A @ (body_acceleration + np.cross(rates, body_velocity)),
        "attitude": A @ np.cross(rates, np.eye(3), axisb=0, axisc=0),
        "rates": np.linalg.solve(inertia, M - np.cross(rates, inertia @ rates)),  # A.6
        "tilt": (np.array([full * u[3], -full * u[2]]) - x[13:15]) / f(vehicle.swash_plate.time_constant),
        "bar": (axis - (axis @ x[15:18]) * x[15:18]) / f(vehicle.stabiliser_bar.time_constant),
        "rotor": speed_rates,
    }


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1))
def test_right_hand_side(vehicle, random_state, seed) -> None:
    rng = np.random.default_rng(seed)
    x, wind = random_state(rng), rng.normal(size=3)
    u = np.append(rng.uniform(0, 1, size=2), rng.uniform(-1, 1, size=2))
    p, dx = model_parameters(vehicle, 6.9), np.empty(21)
    state_derivative(x, u, wind, p, dx)
    expected = transcription(vehicle, x, u, wind, 6.9)

    assert_allclose(dx[0:3], x[3:6])
    assert_allclose(dx[3:6], expected["velocity"], rtol=1e-10, atol=1e-10)
    # The matrix turns as A W~ does: compare by a central difference of the quaternion.
    h = 1e-6
    turned = (body_to_ned_matrix(x[6:10] + h * dx[6:10]) - body_to_ned_matrix(x[6:10] - h * dx[6:10])) / (2 * h)
    assert_allclose(turned, expected["attitude"], atol=1e-7)
    assert_allclose(dx[10:13], expected["rates"], rtol=1e-9, atol=1e-7)
    assert_allclose(dx[13:15], expected["tilt"], rtol=1e-9, atol=1e-9)
    assert_allclose(dx[15:18], expected["bar"], rtol=1e-9, atol=1e-10)
    assert_allclose(dx[18:20], expected["rotor"], rtol=1e-9, atol=1e-7)
