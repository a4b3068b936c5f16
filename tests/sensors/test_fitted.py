"""Sonar, laser ring, pressure, field, speeds, battery, fixes: each against what it is made of."""

import math

import numpy as np
import pytest
from scipy import stats

from mufly.dynamics import body_to_ned_matrix
from mufly.errors import InputError
from mufly.quantities.units import GRAVITY
from mufly.sensors import column_medians, make_fitted_sensors
from mufly.sensors import rng as random_numbers
from mufly.sensors.periodic import draw_stationary_gauss_markov, propagate_gauss_markov
from mufly.vehicle import replace_parameters
from mufly.world import Box, Room, World


def one(vehicle, name, world=None, seed=0):
    return make_fitted_sensors(vehicle, world or World(), seed=seed, only=[name])


def stream(sensor, name, truths):
    """Every new reading."""
    out = []
    for truth in truths:
        readings = sensor.read(truth)
        if name in readings and (not out or out[-1][1] is not readings[name]):
            out.append((truth.time_s, readings[name]))
    return out


# --- sonar


@pytest.mark.parametrize("tilt", [0.0, 0.2, 0.45])
def test_sonar_hears_the_shortest_way_to_the_floor(exact, at, tilt) -> None:
    truth = at(position=(0, 0, -2.0), attitude=(tilt, 0, 0))
    lower = (body_to_ned_matrix(truth.state[6:10]) @ exact.sensors.sonar.position.to_array()[0])[2]
    sonar = one(exact, "sonar").sensors[0]
    assert sonar.error_free_readings(truth)["ground_distance"] == pytest.approx(2.0 - lower)


def test_sonar_beyond_its_cone_hears_the_floor_aslant(exact, at) -> None:
    tilt, half = 0.8, 0.5 * float(exact.sensors.sonar.cone_angle)
    truth = at(position=(0, 0, -2.0), attitude=(tilt, 0, 0))
    lower = (body_to_ned_matrix(truth.state[6:10]) @ exact.sensors.sonar.position.to_array()[0])[2]
    heard = one(exact, "sonar").sensors[0].error_free_readings(truth)["ground_distance"]
    assert heard == pytest.approx((2.0 - lower) / math.cos(tilt - half), rel=0.01)


def test_sonar_steps_up_early_over_a_box(exact, at) -> None:
    world = World(boxes=(Box((1.0, 0.0, -0.15), (0.6, 2.0, 0.3)),))
    sonar = one(exact, "sonar", world).sensors[0]
    heard = [sonar.error_free_readings(at(position=(n, 0, -1.05)))["ground_distance"] for n in (0.0, 0.45, 1.0)]
    assert heard[0] == pytest.approx(1.0)
    assert heard[2] == pytest.approx(0.7)
    assert 0.7 < heard[1] < 0.9  # its edge is heard before it is below


def test_sonar_has_steps_limits_and_takes_its_time(vehicle, exact, at) -> None:
    coarse = replace_parameters(exact, {"sensors.sonar.resolution": 0.01})
    readings = stream(
        one(coarse, "sonar"), "ground_distance", [at(k / 200, position=(0, 0, -4.0437)) for k in range(200)]
    )
    assert {round(r.value, 6) for _, r in readings} == {3.99}
    assert len(readings) == 20  # every 50 ms
    assert all(0.02 < came - r.time_s < 0.03 for came, r in readings)  # 8 m of way
    far = stream(one(exact, "sonar"), "ground_distance", [at(k / 200, position=(0, 0, -7.0)) for k in range(50)])
    assert not any(r.valid for _, r in far)
    noisy = replace_parameters(
        vehicle, {"sensors.sonar.dropout_probability": 0.2, "sensors.sonar.multipath_probability": 0.1}
    )
    said = [r for _, r in stream(one(noisy, "sonar"), "ground_distance", [at(k / 20) for k in range(2000)])]
    assert np.mean([not r.valid for r in said]) == pytest.approx(0.2, abs=0.04)
    good = np.array([r.value for r in said if r.valid])
    assert np.mean(good > 1.05) == pytest.approx(0.1, abs=0.03)


# --- laser ring


def ring_errors(vehicle, at, half, seeds=(0,), pictures=60):
    world = World(room=Room((-half, half), (-half, half), 3.0))
    error = []
    for seed in seeds:
        camera = one(vehicle, "ring_camera", world, seed)
        said = np.array([r.value for _, r in stream(camera, "ranges", [at(k * 0.04) for k in range(pictures)])])
        error.append(np.where(said < 1.5, said - camera.sensors[0].error_free_readings(at())["ranges"], np.nan))
    return np.concatenate(error)


def test_ring_error_of_calibration_grows_with_the_square_of_the_distance(exact, at) -> None:
    off = replace_parameters(
        exact, {"sensors.ring_camera.calibration_error": 0.1, "sensors.ring_camera.spot_brightness": 1e4}
    )
    near, far = (ring_errors(off, at, half, range(40), 2) for half in (0.35, 1.05))
    distance = np.array([0.35, 1.05]) / math.cos(math.pi / 8)
    squares = (distance[1] ** 2 + 0.08**2) / (distance[0] ** 2 + 0.08**2)
    assert np.nanstd(far) / np.nanstd(near) == pytest.approx(squares, rel=0.15)


def test_ring_reads_without_bias_and_fainter_spots_worse(exact, at) -> None:
    spread = {}
    for half in (0.4, 0.8, 1.2):
        error = ring_errors(exact, at, half)
        assert np.isfinite(error).mean() > 0.95
        spread[half] = float(np.nanstd(error))
        assert abs(np.nanmean(error)) < 0.02 * half
    assert spread[0.4] < 0.01
    assert spread[1.2] < 0.12
    # A spot's light falls with the square of the distance, and its centroid's error with it: the fourth power.
    assert spread[1.2] / spread[0.4] == pytest.approx(81.0, rel=0.4)


def test_ring_sees_nothing_in_the_open_and_misses_what_is_swallowed(exact, at) -> None:
    empty = [r.value for _, r in stream(one(exact, "ring_camera"), "ranges", [at(k * 0.04) for k in range(500)])]
    assert np.mean(np.array(empty) < 1.5) < 1e-3
    world = World(room=Room((-0.7, 0.7), (-0.7, 0.7), 3.0))
    dull = replace_parameters(exact, {"sensors.ring_camera.missed_spot_probability": 0.3})
    said = np.array(
        [r.value for _, r in stream(one(dull, "ring_camera", world), "ranges", [at(k * 0.04) for k in range(200)])]
    )
    assert np.mean(said == 1.5) == pytest.approx(0.3, abs=0.05)


def test_ring_picture_holds_the_spots_where_triangulation_puts_them(exact, at) -> None:
    world = World(room=Room((-0.5, 0.5), (-0.5, 0.5), 3.0))
    camera = one(exact, "ring_camera", world).sensors[0].sensor
    c = exact.sensors.ring_camera
    picture = camera.render_picture(at().state)
    assert picture.shape == (c.radial_pixels, c.angular_pixels)
    top = 1.25 * math.atan(float(c.baseline) / float(c.min_range))
    true = camera.error_free_readings(at())["ranges"]
    bright = picture - np.median(picture, axis=0)
    for k, distance in enumerate(true):
        column = int((math.pi / 8 + k * math.pi / 4) / (2 * math.pi) * c.angular_pixels)
        row = int(np.argmax(bright[:, column]))
        assert row == pytest.approx(math.atan(float(c.baseline) / distance) / top * c.radial_pixels - 0.5, abs=1.5)


# --- pressure, field, speeds, battery


def test_pressure_falls_with_height_and_rises_under_the_rotors(exact, at) -> None:
    low, high = (one(exact, "pressure").read(at(position=(0, 0, -h)))["pressure"].value for h in (0.0, 10.0))
    assert low - high == pytest.approx(10.0 * float(exact.air.density) * GRAVITY)
    windy = replace_parameters(exact, {"sensors.pressure.downwash_coefficient": 0.05})
    hovering = one(windy, "pressure").read(at(position=(0, 0, 0.0), rotor_speed=(376.0, 443.0)))["pressure"].value
    radius = float(exact.rotors.radius)
    loading = float(exact.body.mass) * GRAVITY / (math.pi * radius**2)
    assert hovering - low == pytest.approx(0.05 * loading, rel=0.1)  # in hover the discs carry the weight


def test_magnetic_field_turns_with_the_body_and_not_its_strength(exact, at) -> None:
    said = [
        one(exact, "magnetometer").read(at(attitude=a))["magnetic_field"].value
        for a in ((0, 0, 0), (0, 0, math.pi / 2), (0.3, -0.2, 1.0))
    ]
    np.testing.assert_allclose([np.linalg.norm(m) for m in said], float(exact.sensors.magnetometer.field_strength))
    np.testing.assert_allclose(said[1], [said[0][1], -said[0][0], said[0][2]], atol=1e-12)
    loud = replace_parameters(exact, {"sensors.magnetometer.field_per_current": 5e-6})
    off = one(loud, "magnetometer").read(at(current=2.0))["magnetic_field"].value - said[0]
    assert 1e-6 < np.linalg.norm(off) < 5e-5


def test_steel_bends_the_field_smoothly(exact, at) -> None:
    bent = replace_parameters(
        exact, {"sensors.magnetometer.distortion": 3e-6, "sensors.magnetometer.distortion_correlation_length": 1.5}
    )
    places = np.random.default_rng(1).uniform(-20, 20, (400, 3))
    sensor = one(bent, "magnetometer")
    along = enumerate(np.concatenate([places, places + 0.05]))
    field = np.array([sensor.read(at(float(k), position=p))["magnetic_field"].value for k, p in along])
    here, near = np.split(field - sensor.sensors[0].sensor.earth_field_T, 2)
    assert here.std() == pytest.approx(3e-6, rel=0.15)
    assert (near - here).std() < 0.1 * here.std()


def test_speeds_and_battery_are_read_with_their_steps_and_scales(vehicle, exact, at) -> None:
    truth = at(rotor_speed=(376.0, 443.0), voltage=7.4137, current=2.0)
    np.testing.assert_allclose(one(exact, "rotor_speed").read(truth)["rotor_speed"].value, [376.0, 443.0])
    many = np.array([one(vehicle, "rotor_speed", seed=s).read(truth)["rotor_speed"].value[0] for s in range(200)])
    noise = float(vehicle.sensors.rotor_speed.voltage_noise) / (
        float(vehicle.motor.back_emf_constant) * float(vehicle.gear.ratio)
    )
    assert many.std() == pytest.approx(math.hypot(3.76, noise), rel=0.2)
    stepped = replace_parameters(exact, {"sensors.battery.voltage_resolution": 0.05})
    assert one(stepped, "battery").read(truth)["battery_voltage"].value == pytest.approx(7.4)
    assert one(exact, "battery").read(truth)["battery_current"].value == 2.0


# --- fixes, wandering, time


def test_fixes_come_late_in_their_rhythm_and_stay_wrong_together(exact, at) -> None:
    truths = [at(k / 200, position=(k / 200, 0, -1.0)) for k in range(400)]
    plain = stream(
        one(replace_parameters(exact, {"sensors.position_fix.latency": 0.2}), "position_fix"),
        "position_fix",
        truths,
    )
    assert all(came - r.time_s == pytest.approx(0.2, abs=0.005) for came, r in plain)
    assert all(r.value[0] == pytest.approx(r.time_s) for _, r in plain)
    assert len(plain) == pytest.approx((2.0 - 0.2) * 15, abs=2)
    tau = 2.0
    wrong = replace_parameters(
        exact, {"sensors.position_fix.drift": 0.03, "sensors.position_fix.drift_correlation_time": tau}
    )
    said = stream(one(wrong, "position_fix"), "position_fix", [at(k / 15) for k in range(15 * 600)])
    error = np.array([r.value[:3] - [0, 0, -1.0] for _, r in said])
    assert error.std() == pytest.approx(0.03, rel=0.15)
    lag = round(tau * 15)
    assert np.mean(error[lag:] * error[:-lag]) / error.var() == pytest.approx(math.exp(-1), abs=0.12)


def test_wandering_does_not_depend_on_how_often_one_looks() -> None:
    for step in (0.01, 1.0):
        source, sigma, memory = (
            random_numbers.make_random_source(np.random.default_rng(2)),
            np.ones(2000),
            np.empty(2001),
        )
        draw_stationary_gauss_markov(np.random.default_rng(3), sigma, memory)
        start = memory[1:].copy()
        for k in range(round(5.0 / step) + 1):
            propagate_gauss_markov(k * step, sigma, 5.0, memory, source)
        assert memory[1:].std() == pytest.approx(1.0, rel=0.08)
        assert np.mean(start * memory[1:]) == pytest.approx(math.exp(-1), abs=0.08)


def test_sensors_keep_their_own_clock_on_a_coarse_one(exact, at) -> None:
    """A period of 66.7 ms sampled every 5 ms is 15 readings a second, not 14.3."""
    said = stream(one(exact, "position_fix"), "position_fix", [at(k / 200) for k in range(2001)])
    assert len(said) == pytest.approx(10.0 / 0.0667, abs=1.5)


def test_one_seed_repeats_all_and_one_sensor_less_leaves_the_others(vehicle, at) -> None:
    world = World()
    truths = [at(k / 200, rotor_speed=(376.0, 443.0), rates=(0.1, 0, 0)) for k in range(30)]

    def last(**more):
        sensors = make_fitted_sensors(vehicle, world, **more)
        for truth in truths:
            readings = sensors.read(truth)
        return {name: np.asarray(r.value) for name, r in readings.latest.items()}

    first, again, other = last(seed=3), last(seed=3), last(seed=4)
    assert first.keys() == again.keys()
    assert all(np.array_equal(first[name], again[name], equal_nan=True) for name in first)
    assert not np.array_equal(first["rates"], other["rates"])
    fewer = last(seed=3, only=["imu", "magnetometer"])
    assert set(fewer) == {"acceleration", "rates", "clipping", "temperature", "magnetic_field"}
    assert all(np.array_equal(first[name], fewer[name]) for name in fewer)


def test_a_vehicle_without_sensors_says_so(vehicle) -> None:
    with pytest.raises(InputError, match="sensors: there is no such table; add one"):
        make_fitted_sensors(vehicle.model_copy(update={"sensors": None}), World())


# --- random numbers in compiled code


def drawn(key: int, count: int, fill=random_numbers.draw_normals):
    out = np.empty(count)
    fill(np.array([key], dtype=np.uint64), out)
    return out


def test_normal_numbers_are_normal_to_their_tails_and_know_nothing_of_each_other() -> None:
    # Each bound is what chance passes once in ten thousand times, and these keys are fixed.
    for key in (0, 1, 2**63 + 11):
        z = drawn(key, 400_001)
        assert stats.kstest(z, "norm").pvalue > 1e-4
        n = z.size
        assert abs(z.mean()) < 4 / math.sqrt(n)
        assert abs(z.var() - 1.0) < 4 * math.sqrt(2 / n)
        assert abs(stats.skew(z)) < 4 * math.sqrt(6 / n)
        assert abs(stats.kurtosis(z)) < 4 * math.sqrt(24 / n)
        for far in (3.0, 4.0):
            assert stats.binomtest(int((np.abs(z) > far).sum()), n, 2 * stats.norm.sf(far)).pvalue > 1e-4
        # Neighbours, the halves of pairs, and another source: neither they nor their magnitudes go together.
        half = n // 2
        for a, b in ((z[:-1], z[1:]), (z[:half], z[half : 2 * half]), (z, drawn(key + 1, n))):
            for f in (lambda v: v, np.abs):
                assert abs(np.corrcoef(f(a), f(b))[0, 1]) < 4 / math.sqrt(a.size)
        u = drawn(key, 200_000, random_numbers.draw_uniforms)
        assert stats.kstest(u, "uniform").pvalue > 1e-4
        assert 0.0 <= u.min() < u.max() < 1.0


def test_numbers_are_those_of_the_formulas() -> None:
    grows = 0x9E3779B97F4A7C15
    known = (6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431)
    u = drawn(1234567 + grows, 4, random_numbers.draw_uniforms)  # splitmix64's own numbers of this seed
    np.testing.assert_array_equal(u, [(k >> 12) / 2**52 for k in known])
    # Pairs of neighbours are drawn in halves; of an odd last pair there is one.
    z, u = drawn(5, 2001), drawn(5, 2002, random_numbers.draw_uniforms)
    far = np.sqrt(-2.0 * np.log(1.0 - u[::2]))
    cosine, sine = (
        far[:1000] * np.abs(np.cos(2 * math.pi * u[1:2000:2])),
        far[:1000] * np.abs(np.sin(2 * math.pi * u[1:2000:2])),
    )
    np.testing.assert_allclose(np.sort(np.abs(z[:2000])), np.sort([*cosine, *sine]), rtol=1e-11, atol=1e-13)


def test_who_draws_goes_on_where_it_was_and_sources_differ() -> None:
    rng = np.random.default_rng(3)
    source, again = random_numbers.make_random_source(rng), random_numbers.make_random_source(np.random.default_rng(3))
    a, b = np.empty((2, 500)), np.empty(500)
    for row in a:
        random_numbers.draw_normals(source, row)
    random_numbers.draw_normals(again, b)
    np.testing.assert_array_equal(a[0], b)
    assert np.intersect1d(a[0], a[1]).size == 0
    random_numbers.draw_normals(random_numbers.make_random_source(rng), b)
    assert np.intersect1d(a[0], b).size == 0


@pytest.mark.parametrize("rows", [4, 5, 48, 64, 65])
@pytest.mark.parametrize("grid", [0.0, 0.5, 1e-5])
def test_medians_of_columns_are_exact_also_with_equal_and_far_values(rows, grid) -> None:
    values = np.random.default_rng(rows).standard_normal((rows, 7))
    values = np.round(values / grid) * grid if grid else values  # equal values, and values that are equal as keys
    values[:, 5] += 100.0 * np.arange(rows)  # beyond the keys' range
    medians, levels = np.empty(7), np.linspace(-2.0, 2.0, 7)
    column_medians.write_column_medians(values.ravel(), levels, column_medians.median_comparators(rows), rows, medians)
    np.testing.assert_array_equal(medians, np.median(values, axis=0))


def test_what_overtakes_on_its_way_is_said_in_the_order_of_its_coming(exact, at) -> None:
    vehicle = replace_parameters(
        exact, {"sensors.position_fix.latency": 0.4, "sensors.position_fix.latency_jitter": 0.2}
    )
    truths = [at(k / 200, position=(0.01 * k, 0, -1.0)) for k in range(3000)]
    said = stream(one(vehicle, "position_fix"), "position_fix", truths)
    came, taken = np.array([t for t, _ in said]), np.array([r.time_s for _, r in said])
    assert (np.diff(taken) < 0).any()
    assert (came - taken > 0.4 - 1e-9).all()
    for t, reading in said:
        assert reading.value[0] == pytest.approx(2.0 * reading.time_s, abs=1e-9), t
