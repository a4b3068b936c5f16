"""The inertial unit against mechanics, its data sheet and the false tilt of the dissertation."""

import math

import numpy as np
import pytest

from mufly.dynamics import body_to_ned_matrix
from mufly.quantities.units import GRAVITY
from mufly.sensors import make_fitted_sensors
from mufly.sensors.imu import butterworth_coefficients, resonance_gain
from mufly.vehicle import replace_parameters
from mufly.world import World

GEE = 9.80665


def unit(vehicle, seed=0):
    return make_fitted_sensors(vehicle, World(), seed=seed, only=["imu"])


def settle(imu, truths):
    for truth in truths:
        readings = imu.read(truth)
    return readings


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.3, 0.0, 1.0), (-0.2, 0.4, 2.0), (math.pi, 0.0, 0.0)])
def test_at_rest_it_feels_what_holds_it_up(exact, at, attitude) -> None:
    r = settle(unit(exact), [at(k / 200, attitude=attitude) for k in range(40)])
    up = body_to_ned_matrix(at(attitude=attitude).state[6:10]).T @ [0.0, 0.0, -GRAVITY]
    np.testing.assert_allclose(r["acceleration"].value, up, atol=1e-9)
    np.testing.assert_allclose(r["rates"].value, 0.0, atol=1e-12)
    assert not r["clipping"].value.any()


def test_in_free_fall_it_feels_nothing(exact, at) -> None:
    r = settle(unit(exact), [at(k / 200, velocity=(0.0, 0.0, GRAVITY * k / 200)) for k in range(60)])
    np.testing.assert_allclose(r["acceleration"].value, 0.0, atol=1e-3)  # the filter forgets the floor slowly


def test_off_the_centre_it_feels_the_turning(exact, at) -> None:
    """w x (w x r) in a steady turn about z, dw/dt x r while it begins."""
    place = exact.sensors.imu.position.to_array()[0]
    steady = settle(unit(exact), [at(k / 200, rates=(0.0, 0.0, 10.0)) for k in range(60)])
    np.testing.assert_allclose(steady["acceleration"].value, [-100.0 * place[0], 0.0, -GRAVITY], atol=1e-6)
    starts = settle(unit(exact), [at(k / 200, rates=(0.0, 50.0 * k / 200, 0.0)) for k in range(60)])
    w = 50.0 * 59 / 200
    expected = np.array([50.0 * place[2] - w * w * place[0], 0.0, -GRAVITY - 50.0 * place[0] - w * w * place[2]])
    np.testing.assert_allclose(starts["acceleration"].value, expected, atol=0.02 * abs(expected).max())


def test_noise_has_the_density_of_the_data_sheet(exact, at) -> None:
    """White noise of density N behind a second-order Butterworth filter: N sqrt(1.11 f_c)."""
    density, cutoff_Hz = 2e-3, 30.0
    v = replace_parameters(
        exact, {"sensors.imu.accelerometer_noise_density": density, "sensors.imu.bandwidth": 2 * math.pi * cutoff_Hz}
    )
    imu = unit(v)
    said = np.array([imu.read(at(k / 200))["acceleration"].value for k in range(4000)])[100:]
    expected = density * math.sqrt(math.pi / (2 * math.sqrt(2)) * cutoff_Hz)
    assert said.std(axis=0) == pytest.approx(np.full(3, expected), rel=0.1)


def test_units_differ_by_what_the_file_says(exact, at) -> None:
    v = replace_parameters(exact, {"sensors.imu.gyro_bias": 0.02, "sensors.imu.accelerometer_bias": 0.3})
    said = [unit(v, seed).read(at()) for seed in range(60)]
    gyro = np.array([r["rates"].value for r in said])
    felt = np.array([r["acceleration"].value for r in said]) + np.array([0.0, 0.0, GRAVITY])
    assert gyro.std() == pytest.approx(0.02, rel=0.2)
    assert felt.std() == pytest.approx(0.3, rel=0.2)


def test_the_filter_passes_what_is_slow_and_halves_the_power_at_its_cut_off() -> None:
    b0, b1, b2, a1, a2 = butterworth_coefficients(2 * math.pi * 60.0, 125e-6)
    for hertz, gain in ((0.0, 1.0), (60.0, math.sqrt(0.5)), (600.0, 0.01)):
        z = np.exp(-2j * math.pi * hertz * 125e-6)
        assert abs((b0 + b1 * z + b2 * z * z) / (1 + a1 * z + a2 * z * z)) == pytest.approx(gain, rel=0.05)


def test_the_board_exaggerates_its_resonance(vehicle) -> None:
    v = vehicle.sensors.imu.vibration
    w, damping = float(v.resonance_frequency), float(v.damping_ratio)
    assert resonance_gain(0.0, w, damping) == 1.0
    assert resonance_gain(w, w, damping) == pytest.approx(0.5 / damping)
    assert resonance_gain(10 * w, w, damping) == pytest.approx(0.01, rel=0.05)


def false_tilt_deg(vehicle, at, hover, once, twice, seeds=7) -> float:
    """Median over units of the tilt that the mean of the accelerometers shows, standing with rotors running."""
    v = replace_parameters(
        vehicle, {"sensors.imu.vibration.once_per_rev": once * GEE, "sensors.imu.vibration.twice_per_rev": twice * GEE}
    )
    tilt = []
    for seed in range(seeds):
        imu = unit(v, seed)
        said = [imu.read(at(k / 200, rotor_speed=hover))["acceleration"].value for k in range(400)]
        mean = np.mean(said[100:], axis=0)
        tilt.append(math.degrees(math.atan2(math.hypot(mean[0], mean[1]), -mean[2])))
    return float(np.median(tilt))


def test_clipping_makes_a_tilt_out_of_a_lopsided_shaking(exact, at) -> None:
    """The dissertation's 20 degrees of false tilt (Sec. 2.1.2): nothing wrong but amplitude and the range of 6 g."""
    hover = (376.0, 443.0)
    low, high, higher = (false_tilt_deg(exact, at, hover, a, a / 2) for a in (3.0, 6.0, 8.0))
    assert low < 1.0
    assert 4.0 < high < higher < 35.0
    # With a range that nothing reaches, and with a shaking that is even, there is none.
    wide = replace_parameters(exact, {"sensors.imu.accelerometer_range": 100 * GEE})
    assert false_tilt_deg(wide, at, hover, 8.0, 4.0) < 1.0
    assert false_tilt_deg(exact, at, hover, 8.0, 0.0, seeds=3) < 2.0


def test_it_says_how_much_was_clipped_and_shakes_with_the_square_of_the_speed(exact, at) -> None:
    v = replace_parameters(
        exact, {"sensors.imu.vibration.once_per_rev": 9 * GEE, "sensors.imu.vibration.resonance_frequency": 1e5}
    )
    full, half, none = (
        np.array([imu.read(at(k / 200, rotor_speed=(s * 376.0, s * 443.0)))["clipping"].value for k in range(200)])
        for s, imu in ((s, unit(v)) for s in (1.0, 0.5, 0.0))
    )
    assert full.max() > 0.2
    assert not half.any()  # a quarter: 2 x 2.3 g along a direction
    assert not none.any()


def test_a_moment_that_did_not_pass_changes_nothing(exact, at) -> None:
    imu = unit(exact)
    first = imu.read(at(0.0))
    assert imu.read(at(0.0))["rates"] is first["rates"]


def test_a_unit_that_is_mounted_askew_senses_in_its_own_axes(exact, at) -> None:
    """R_m^T f and R_m^T w: rolled by 3 degrees, gravity and a yaw rate also show on the y axis."""
    angle = math.radians(3.0)
    askew = replace_parameters(exact, {"sensors.imu.mount_roll": angle, "sensors.imu.gyro_g_sensitivity": 0.0})
    motion = [at(k / 200, rates=(0.0, 0.0, 0.5)) for k in range(60)]
    straight, turned = settle(unit(exact), motion), settle(unit(askew), motion)
    roll = np.array([[1, 0, 0], [0, math.cos(angle), math.sin(angle)], [0, -math.sin(angle), math.cos(angle)]])
    for name in ("acceleration", "rates"):
        np.testing.assert_allclose(turned[name].value, roll @ straight[name].value, atol=1e-9)
    assert turned["rates"].value[1] == pytest.approx(0.5 * math.sin(angle), rel=1e-6)
    # The first reading, without a period before it.
    first = unit(askew).read(motion[0])["acceleration"].value
    np.testing.assert_allclose(first, roll @ unit(exact).read(motion[0])["acceleration"].value, atol=1e-9)
    both = replace_parameters(
        exact, {"sensors.imu.mount_roll": 0.02, "sensors.imu.mount_pitch": -0.03, "sensors.imu.mount_yaw": 0.1}
    )
    force = settle(unit(both), motion)["acceleration"].value
    assert np.linalg.norm(force) == pytest.approx(np.linalg.norm(straight["acceleration"].value), rel=1e-9)
