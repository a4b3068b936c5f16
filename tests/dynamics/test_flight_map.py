"""Flight map in the equations of motion: physics, edges, and its place beside the filter's function."""

import math
from functools import partial

import numpy as np
import pytest

from mufly.dynamics import (
    find_trim,
    initial_state,
    linearise_vehicle,
    max_level_speed_band,
    model_parameters,
    state_derivative,
)
from mufly.dynamics.edgewise_loads import is_inside_flight_map
from mufly.dynamics.equations_of_motion import state_derivative_from_tilt_sines
from mufly.dynamics.model_state import (
    MODEL_POSITION,
    MODEL_RATES,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    MODEL_VELOCITY,
    ROTOR_SPEED_SLICE,
    STATE_SIZE,
)
from mufly.dynamics.vehicle_flight_map import find_max_level_speed
from mufly.errors import InputError
from mufly.rotor.forward.edgewise_map import evaluate_flight_map, fit_flight_map_splines, interpolate_flow_loads
from mufly.vehicle import format_vehicle_toml, load_flight_map, load_vehicle, replace_parameters
from mufly.vehicle.flight_map import FLIGHT_TABLE_COLUMNS

CALM = np.zeros(3)


@pytest.fixture(scope="module")
def clamped(vehicle):
    return replace_parameters(vehicle, {"rotors.flight_map": "mufly-1.1-clamped"})


@pytest.fixture(scope="module")
def hinged(vehicle):
    return replace_parameters(vehicle, {"rotors.flight_map": "mufly-1.1-hinged"})


def derivative(v, x, wind=CALM, u=(0.7, 0.7, 0.0, 0.0)):
    dx = np.empty(STATE_SIZE)
    state_derivative(x, np.array(u), np.asarray(wind, dtype=np.float64), model_parameters(v), dx)
    return dx


def hovering(v, **changes):
    speed = find_trim(v).rotor_speed
    return initial_state(**{"position": (0, 0, -50), "rotor_speed": speed, **changes})


def test_axial_flight_is_that_without_a_map(vehicle, clamped):
    for climb in (0.0, -1.5, 2.0):
        x = hovering(vehicle, velocity=(0, 0, -climb))
        assert derivative(clamped, x) == pytest.approx(derivative(vehicle, x), abs=1e-9)
    assert find_trim(clamped).rotor_speed == pytest.approx(find_trim(vehicle).rotor_speed, rel=1e-9)


def test_wind_from_every_azimuth_turns_the_loads(clamped):
    x = hovering(clamped)
    north = derivative(clamped, x, (-1.5, 0, 0))
    for azimuth in np.radians([30, 90, 200, 315]):
        c, s = math.cos(azimuth), math.sin(azimuth)
        turned = derivative(clamped, x, (-1.5 * c, -1.5 * s, 0))
        n, e = turned[3] * c + turned[4] * s, turned[4] * c - turned[3] * s
        p, q = turned[10] * 1.12, turned[11] * 1.43  # moments in 1e-4 N m
        roll, pitch = p * c + q * s, q * c - p * s
        drag = np.array([n, e, roll / 1.12, pitch / 1.43])
        # The fuselage's drag areas along x and y are equal; along an azimuth between them its drag is less.
        assert drag == pytest.approx(north[[3, 4, 10, 11]], abs=0.02)
        assert turned[[5, 12, 18, 19]] == pytest.approx(north[[5, 12, 18, 19]], abs=1e-9)


def test_blow_back_lifts_the_nose_and_lift_grows(vehicle, clamped, hinged):
    x = hovering(vehicle, velocity=(2.0, 0, 0))
    plain = derivative(vehicle, x)
    for v in (clamped, hinged):
        dx = derivative(v, x)
        assert dx[5] < plain[5] - 0.5  # more thrust
        assert dx[11] > plain[11] + 1.0  # nose up
    assert derivative(clamped, x)[11] > 2.0 * derivative(hinged, x)[11]


def test_rotor_at_rest_in_wind_has_no_loads(vehicle, clamped):
    x = hovering(vehicle, rotor_speed=(0.0, 0.0))
    for wind in ((3.0, 0, 0), (0, -8.0, 2.0)):
        assert np.array_equal(derivative(clamped, x, wind), derivative(vehicle, x, wind))


def test_beyond_the_edges_the_last_values_hold(clamped):
    edge, sink, _ = clamped.rotors.flight_map.velocity_range_m_s
    p, speed = model_parameters(clamped), find_trim(clamped).rotor_speed
    inside = hovering(clamped, velocity=(0.9 * edge, 0, 0))
    assert is_inside_flight_map(inside, CALM, p)
    for velocity in ((1.2 * edge, 0, 0), (1.0, 0, 1.2 * sink)):
        assert not is_inside_flight_map(hovering(clamped, velocity=velocity), CALM, p)
    assert not is_inside_flight_map(hovering(clamped, rotor_speed=(speed[0], 2.0 * speed[1])), CALM, p)
    one, two = (
        derivative(clamped, hovering(clamped, velocity=(f * edge, 0, 0), rotor_speed=speed))[ROTOR_SPEED_SLICE]
        for f in (1.1, 3.0)
    )
    assert one == pytest.approx(two, rel=1e-9)  # the torque factor is that of the edge


def test_maps_are_dissipative(clamped, hinged):
    for v in (clamped, hinged):
        loads = v.rotors.flight_map.decode_map_tables().loads.reshape(-1, 2, 10)
        assert np.all(loads[..., 2] > 0.0)  # drag
        assert np.all(loads[..., 8] <= 1e-9)  # rate damping
    assert np.abs(loads[..., [4, 5, 8, 9]]).max() < 1e-7  # a free hinge has no hub moments


def test_rates_are_damped(vehicle, clamped, hinged):
    def swing(v):
        poles = linearise_vehicle(v).roll_pitch.poles()
        return max(z.real for z in poles if abs(z.imag) > 5.0)

    assert swing(clamped) < swing(hinged) < swing(vehicle) < 0.0
    assert swing(clamped) == pytest.approx(-6.0, abs=1.5)


def test_the_map_passes_through_its_points(clamped):
    flight_map = clamped.rotors.flight_map
    tables, splines = flight_map.decode_map_tables(), fit_flight_map_splines(flight_map.decode_map_tables())
    climbs, edges = splines.size
    flow = tables.loads.reshape(*tables.loads.shape[:3], 2, 10)[..., :6].reshape(*tables.loads.shape[:3], 12)
    at = partial(interpolate_flow_loads, splines.coefficient_table.ravel(), int(climbs), int(edges))
    middle = flow.mean(axis=0)
    for j in range(climbs):
        for k in range(edges):
            assert at(0.0, float(j), float(k)) == pytest.approx(middle[j, k], abs=1e-9)
    # The ratio's slope is linear over the climb: within a sixth of the range of each column to half of v_h of climb.
    away = tables.ratio - splines.speed_ratio_middle
    for i, part in enumerate(away):
        for j in range(1, climbs):
            for k in range(edges - 1):
                error = np.abs(np.array(at(float(part), float(j), float(k))) - flow[i, j, k])
                assert np.all(error < np.ptp(flow, axis=(0, 1, 2)) / 6.0)
    loads = evaluate_flight_map(flight_map)
    assert loads.airspeed_m_s[-1] == pytest.approx(flight_map.velocity_range_m_s[0])
    assert loads.rate_damping_Nms < 0.0


def test_the_filters_function_knows_no_map(vehicle, clamped, random_state):
    x, u = random_state(np.random.default_rng(5)), np.array([0.7, 0.7, 0.3, -0.1])
    turned = replace_parameters(clamped, {"swash_plate.phase": 0.4})
    first, second = np.empty(STATE_SIZE), np.empty(STATE_SIZE)
    state_derivative_from_tilt_sines(x, u, CALM, model_parameters(vehicle), 0.1, 0.99, 0.05, 0.99, True, first)
    state_derivative_from_tilt_sines(x, u, CALM, model_parameters(turned), 0.1, 0.99, 0.05, 0.99, True, second)
    assert np.array_equal(first, second)


def test_trim_in_wind_is_steady_with_a_phase(clamped):
    """All rates but those of position and charge: the swash plate's tilt follows its turned input as well."""
    turned = replace_parameters(clamped, {"swash_plate.phase": 0.5})
    trim = find_trim(turned, wind=(0.4, 0.2, 0.0), charge=0.9)
    state = trim.state.copy()
    state[MODEL_POSITION + 2] = -5.0  # above the floor
    rates = derivative(turned, state, (0.4, 0.2, 0.0), trim.input)
    assert np.hypot(*trim.input[2:]) > 0.3
    assert np.abs(rates[MODEL_VELOCITY : STATE_SIZE - 1]).max() < 1e-6


def test_phase_turns_the_cyclic_input_along_the_rotation(vehicle):
    x = hovering(vehicle)
    quarter = replace_parameters(vehicle, {"swash_plate.phase": math.pi / 2})
    ahead = derivative(vehicle, x, u=(0.7, 0.7, 0.6, 0.0))
    side = derivative(vehicle, x, u=(0.7, 0.7, 0.0, 0.6))
    # The lower rotor turns clockwise from above: an input forward acts to the right, one to the right acts aft.
    assert derivative(quarter, x, u=(0.7, 0.7, 0.6, 0.0)) == pytest.approx(side, abs=1e-9)
    back = derivative(quarter, x, u=(0.7, 0.7, 0.0, 0.6))
    assert back[[MODEL_SWASH_ROLL, MODEL_SWASH_PITCH]] == pytest.approx(
        -ahead[[MODEL_SWASH_ROLL, MODEL_SWASH_PITCH]], abs=1e-9
    )
    small = replace_parameters(vehicle, {"swash_plate.phase": 0.1})
    gain = linearise_vehicle(small).full.B[[12, 13]][:, 2:]
    assert math.atan2(gain[1, 0], gain[0, 0]) == pytest.approx(0.1, abs=1e-6)


def test_trim_and_level_speed(vehicle, clamped, hinged):
    slow = find_trim(clamped, velocity=(0.5, 0, 0))
    assert slow.inside_map
    assert slow.servo_input[0] > 0.4  # the lower rotor holds the nose down against blow-back
    assert slow.thrust_N.sum() == pytest.approx(find_trim(vehicle).thrust_N.sum(), rel=0.01)
    low, high = max_level_speed_band(clamped)
    assert find_max_level_speed(clamped) == pytest.approx(low, abs=0.1)
    assert find_max_level_speed(hinged) == pytest.approx(high, rel=0.1)
    assert max_level_speed_band(vehicle) is not None  # of the built-in map with the same rotors
    assert max_level_speed_band(replace_parameters(vehicle, {"body.mass": 0.07})) is None


def test_a_map_of_another_rotor_is_refused(vehicle):
    for change in ({"rotors.radius": 0.06}, {"rotors.upper.hub_z": -0.2}, {"rotors.lower.thrust_coefficient": 0.018}):
        other = replace_parameters(vehicle, change)
        with pytest.raises(InputError, match=r"rotors.flight_map.* is for .*make one for these rotors") as caught:
            replace_parameters(other, {"rotors.flight_map": "mufly-1.1-clamped"})
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="coefficient map is for"):
        replace_parameters(
            vehicle,
            {
                "rotors.coefficient_map": "walkera-5g6-bemt",
                "rotors.flight_map": {**load_flight_map("mufly-1.1-clamped").model_dump(), "upper": "other"},
            },
        )


def test_vehicle_files_name_or_contain_the_map(clamped, tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(format_vehicle_toml(clamped), encoding="utf-8")
    assert load_vehicle(path) == clamped
    with pytest.raises(InputError, match="flight map"):
        load_flight_map(tmp_path / "none.toml")
    table = clamped.rotors.flight_map.table.splitlines()
    short = "\n".join(table[:-1])
    for wrong, words in (
        (short, "do not fill a grid"),
        ("a b\n1 2\n", f"begin with: {FLIGHT_TABLE_COLUMNS[0]}"),
        ("\n".join([table[0], *table[1:10]]), "has 1 value"),
    ):
        with pytest.raises(InputError, match=words):
            replace_parameters(
                clamped, {"rotors.flight_map": {**clamped.rotors.flight_map.model_dump(), "table": wrong}}
            )


def test_rate_derivative_matches_the_table(clamped, hinged):
    for v in (clamped, hinged):
        x, p = hovering(v), model_parameters(v)
        turning = x.copy()
        turning[MODEL_RATES] = 1e-3
        slope = (derivative(v, turning) - derivative(v, x))[MODEL_RATES] / 1e-3
        bare = replace_parameters(v, {"rotors.flight_map": None})
        without = (derivative(bare, turning) - derivative(bare, x))[MODEL_RATES] / 1e-3
        tables = v.rotors.flight_map.decode_map_tables()
        loads = tables.loads.mean(axis=0)[int(np.argmin(np.abs(tables.climb_ratio))), 0].reshape(2, 10)
        speeds, z = x[ROTOR_SPEED_SLICE], np.array([p["z_up"], p["z_dw"]])
        scale, radius = p["flight_map_scale"] * speeds, float(p["flight_map_radius"])
        moment = scale * radius**2 * loads[:, 8] - scale * radius * z * loads[:, 7]
        drag = scale * loads[:, 2] - p["inplane"] * speeds
        moment -= drag * z**2
        blow_back = scale * radius * loads[:, 5] * z  # of the velocity -p z to the right
        expected = (moment + blow_back).sum() / p["Ixx"]
        assert slope - without == pytest.approx(expected, rel=0.02)
        assert slope < without
