"""Plans: the hold, safe amplitudes, and that the promised accuracy is what fits scatter by."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.errors import InputError
from mufly.identify import FlightLimits, design_excitation
from mufly.identify.fit_pictures import draw_excitation_plan
from mufly.identify.fit_result import covariance_from_information, describe_undetermined_combinations
from mufly.identify.flight.excitation_plan import SENSOR_NOISE_STD, combine_expected_std
from mufly.identify.flight.hover_feedback import design_hover_feedback, simulate_closed_loop_flights
from mufly.identify.flight.output_error_problem import make_problem
from mufly.vehicle import load_vehicle, replace_parameters

SYMBOLS = ["cQ_dw", "Jdrive_dw", "Jdrive_up"]


def design_matrix(problem, linear):
    """Columns: parameters, then the start values of every window, each acting on its own window."""
    n, m, k = linear.initial_state_jacobian.shape
    starts = problem.window_starts[0]
    blocks = np.zeros((n, m, len(starts), k))
    for w, rows in enumerate(np.split(np.arange(n), starts[1:])):
        blocks[rows, :, w] = linear.initial_state_jacobian[rows]
    return np.hstack([linear.theta_jacobian.reshape(n * m, -1), blocks.reshape(n * m, -1)])


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def plan(vehicle):
    return design_excitation(vehicle, SYMBOLS, "yaw", kinds=("chirp", "doublet"), duration_s=6.0)


def test_the_hold_brings_a_pushed_helicopter_back(vehicle):
    support = design_hover_feedback(vehicle)
    push = np.zeros((3, 1500, 4))
    push[1, :30, 2:] = 0.4
    push[2, :30, :2] = 0.08
    states, inputs, voltage = simulate_closed_loop_flights(vehicle, support, push)
    assert np.all(np.abs(inputs[0] - support.hover.input) < 0.02)  # only the battery runs down
    assert np.linalg.norm(states[1, :, 0:2], axis=1).max() > 0.01
    assert np.linalg.norm(states[:, -1, 0:2], axis=1).max() < 0.15
    assert np.abs(states[:, -1, 2] + 2.0).max() < 0.2
    assert np.abs(states[:, -1, 10:13]).max() < 0.05
    assert np.all(np.diff(voltage[0, 10:]) < 1e-3)


def test_the_motors_directions_do_one_thing_each(vehicle):
    support = design_hover_feedback(vehicle)
    added = np.zeros((2, 60, 4))
    added[0, :, :2] = 0.02 * support.collective_direction
    added[1, :, :2] = 0.02 * support.differential_direction
    states, _, _ = simulate_closed_loop_flights(vehicle, support, added)
    climb, turn = -states[:, -1, 5], states[:, -1, 12]
    assert climb[0] > 0
    assert turn[1] > 0
    assert abs(climb[1]) < 0.25 * climb[0]
    assert abs(turn[0]) < 0.25 * turn[1]


def test_the_flight_stays_within_its_limits_and_uses_them(plan):
    for c in plan.candidates:
        assert 0.9 < c.limit_fraction <= 1.0
        assert c.binding_limit in ("body rates", "heading", "motor input", "height", "attitude")
        assert np.all(c.record.inputs[:, :2] >= 0.05)
        assert np.all(c.record.inputs[:, :2] <= 0.95)
        assert np.max(np.abs(c.added_inputs)) == pytest.approx(c.amplitude)
        yaw = c.record.measured[:, c.record.output_names.index("yaw")]
        assert np.max(np.abs(yaw - yaw[0])) <= math.radians(90)
    assert plan.candidates[0].geometric_mean_std <= plan.candidates[1].geometric_mean_std
    assert plan.band_rad_s[0] < plan.modes_rad_s.min() < plan.modes_rad_s.max() < plan.band_rad_s[1]


def test_a_narrower_limit_binds_and_a_smaller_wish_is_granted(vehicle):
    arguments = {"kinds": ("doublet",), "duration_s": 6.0}
    tight = design_excitation(vehicle, ["Izz"], "yaw", limits=FlightLimits(heading_rad=math.radians(10)), **arguments)
    assert tight.best_candidate.binding_limit == "heading"
    small = design_excitation(vehicle, ["Izz"], "yaw", amplitude=0.005, **arguments)
    assert small.best_candidate.binding_limit == "as asked"
    assert small.best_candidate.amplitude == 0.005
    large = design_excitation(vehicle, ["Izz"], "yaw", amplitude=0.9, **arguments)
    assert large.best_candidate.amplitude < 0.9
    # In the linear range twice the signal halves the standard deviation.
    half = design_excitation(vehicle, ["Izz"], "yaw", amplitude=0.0025, **arguments)
    assert half.best_candidate.relative_std[0] / small.best_candidate.relative_std[0] == pytest.approx(2, rel=0.1)


@pytest.mark.parametrize("window_s", [None, 2.0])
def test_fits_scatter_by_what_the_plan_promises(vehicle, plan, window_s):
    """Linear fits of the flight with sensor noise, start values free: a Monte Carlo of the whole machinery."""
    c = plan.best_candidate
    if window_s is None:
        c = design_excitation(vehicle, SYMBOLS, "yaw", kinds=("chirp",), duration_s=6.0, window_s=None).best_candidate
    problem = make_problem(vehicle, plan.free_parameters, [c.record], part="heave-yaw", delay_s=0.02, prior=False)
    std = np.array([SENSOR_NOISE_STD[o] for o in problem.records[0].output_names])
    problem = problem.with_noise([std]).with_windows(window_s)
    linear = problem.linearise_record(0, np.zeros(3), problem.make_zero_initial_states()[0])
    a = design_matrix(problem, linear)
    size = np.linalg.norm(a, axis=0)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((linear.whitened_residual.size, 400))
    found = (np.linalg.lstsq(a / size, noise, rcond=None)[0] / size[:, None])[:3]
    assert_allclose(found.std(axis=1), c.relative_std, rtol=0.12)


def test_a_real_fit_finds_a_changed_vehicle_within_the_promise(vehicle, plan):
    """The truth differs by 5 %; Gauss-Newton from the plan's vehicle on its noisy flight."""
    truth = replace_parameters(
        vehicle, {"rotors.lower.drive_inertia": 1.05 * float(vehicle.rotors.lower.drive_inertia)}
    )
    flown = design_excitation(truth, SYMBOLS, "yaw", kinds=("chirp",), duration_s=6.0).best_candidate.record
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(6):
        noisy = flown.measured + rng.standard_normal(flown.measured.shape) * [
            SENSOR_NOISE_STD[o] for o in flown.output_names
        ]
        record = type(flown)(flown.name, flown.time_s, flown.inputs, flown.output_names, noisy, flown.voltage)
        problem = make_problem(vehicle, plan.free_parameters, [record], part="heave-yaw", delay_s=0.02, prior=False)
        problem = problem.with_noise(
            [np.array([SENSOR_NOISE_STD[o] for o in problem.records[0].output_names])]
        ).with_windows(2.0)
        theta, start = np.zeros(3), problem.make_zero_initial_states()[0]
        for _ in range(6):
            linear = problem.linearise_record(0, theta, start)
            a = design_matrix(problem, linear)
            size = np.linalg.norm(a, axis=0)
            step = -np.linalg.lstsq(a / size, linear.whitened_residual.ravel(), rcond=1e-9)[0] / size
            theta, start = theta + step[:3], start + step[3:].reshape(start.shape)
        errors.append(theta - [0.0, math.log(1.05), 0.0])
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < 2.0 * plan.best_candidate.relative_std)


def test_flights_add_their_information(vehicle, plan):
    heave = design_excitation(vehicle, SYMBOLS, "heave", kinds=("doublet",), duration_s=6.0)
    both, _ = combine_expected_std([plan, heave], [plan.best_candidate, heave.best_candidate])
    assert np.all(both <= plan.best_candidate.relative_std * (1 + 1e-6))
    assert np.all(both <= heave.best_candidate.relative_std * (1 + 1e-6))


def test_what_no_flight_shows_is_named(vehicle):
    asked = ["Ixx", "l_up", "l_dw", "Whub"]
    roll = design_excitation(vehicle, asked, "roll", kinds=("doublet",), duration_s=6.0)
    # Drag of the downwash has no part in rolling, but that rotors drag in their discs by their speed.
    assert roll.best_candidate.relative_std[3] > 10.0
    roll = design_excitation(
        replace_parameters(vehicle, {"rotors.inplane_drag": 0.0}),
        asked,
        "roll",
        kinds=("doublet",),
        duration_s=6.0,
    )
    assert roll.best_candidate.relative_std[3] == math.inf
    _, undetermined = combine_expected_std([roll], [roll.best_candidate])
    assert any("Whub is not determined by the data" in u for u in undetermined)
    assert any("Ixx" in u and "l_up" in u and "l_dw" in u for u in undetermined)


def test_directions_in_words():
    information = np.array([[1.0, 1.0], [1.0, 1.0]]) * 1e4
    words = describe_undetermined_combinations(("a", "b"), covariance_from_information(information))
    assert words == ("only the product of b and a is seen (no bound along it)",) or "product of a and b" in words[0]
    difference = np.array([[1.0, -1.0], [-1.0, 1.0]]) * 1e4
    assert (
        "only the ratio" in describe_undetermined_combinations(("a", "b"), covariance_from_information(difference))[0]
    )
    assert describe_undetermined_combinations(("a", "b"), 1e-4 * np.eye(2)) == ()
    assert "a is hardly seen" in describe_undetermined_combinations(("a", "b"), np.diag([1.0, 1e-4]))[0]


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"channel": "sideways"}, "'sideways' is unknown"),
        ({"symbols": ["Izzz"]}, "did you mean 'Izz'"),
        ({"limits": FlightLimits(motor_margin=0.35)}, "limit on motor input: is exceeded by the smallest signal"),
        ({"noise": {"roll": 0.01}}, "no output of yaw is measured"),
        ({"amplitude": 2.0}, "amplitude"),
    ],
)
def test_what_cannot_be_planned(vehicle, arguments, what):
    given = {"symbols": ["Izz"], "channel": "yaw", "kinds": ("doublet",), "duration_s": 6.0, **arguments}
    with pytest.raises(InputError, match=what):
        design_excitation(vehicle, given.pop("symbols"), given.pop("channel"), **given)


def test_the_picture_has_units_on_every_axis(plan):
    figure = draw_excitation_plan(plan)
    assert len(figure.axes) == 4
    assert all(ax.get_xlabel() and "(" in ax.get_ylabel() for ax in figure.axes)
