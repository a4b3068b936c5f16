"""Rotors in forward flight: closed forms, conservation, symmetry, limits.

Closed forms: Johnson, Helicopter Theory (1980), ch. 5; Leishman (2006), sec. 4.6: untwisted rectangular blade without
cut-out, hinge at the shaft, linear lift.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.rotor import (
    Air,
    Corrections,
    OperatingCondition,
    PolarTable,
    RotorSystem,
    load_rotor,
    make_rotor,
    prepare_blading,
    solve_rotor,
    solve_system,
)
from mufly.rotor.forward import (
    ForwardCondition,
    PairSweep,
    RigidFlapMode,
    compute_cyclic_response,
    make_flap_mode,
    solve_forward,
    solve_forward_pair,
    sweep_forward,
)
from mufly.rotor.forward.azimuth_elements import compute_element_forces
from mufly.rotor.forward.inflow import momentum_induced_velocity, pitt_peters_inflow
from mufly.rotor.sections.polar_table import ALPHA_GRID

SLOPE, CHORD, RADIUS, SPEED, PITCH = 5.7, 0.018, 0.0875, 444.0, 0.2
STILL = Air(sound_m_s=1e6)
BARE = Corrections(tip_loss="none", hub_loss=False, swirl=False, lifting_surface=False, stall_delay="none")
ZERO = np.zeros((2, ALPHA_GRID.size))
LINEAR = PolarTable(
    "s", ALPHA_GRID, np.array([1e3, 1e6]), ZERO + SLOPE * ALPHA_GRID, ZERO + 0.01, ZERO,
    np.tile([-0.2, 0.2], (2, 1)), "made up",
)  # fmt: skip
POINT = ForwardCondition(PITCH, SPEED, air=STILL)
FLIGHT = ForwardCondition(
    math.radians(13.0), 376.4, edgewise_m_s=4.0, climb_m_s=0.3, cyclic_rad=(0.02, -0.03), rates_rad_s=(1.0, -2.0)
)
FIELDS = (
    "thrust_N", "torque_Nm", "h_force_N", "y_force_N", "roll_moment_Nm", "pitch_moment_Nm", "coning_rad",
    "flap_cos_rad", "flap_sin_rad", "inflow_mean",
)  # fmt: skip


@pytest.fixture(scope="module")
def textbook():
    blade = make_rotor(name="b", radius_m=RADIUS, chord_m=CHORD, airfoils="s", hub_cutout=0.0)
    return prepare_blading(blade, {"s": LINEAR}, corrections=BARE, stations=40)


@pytest.fixture(scope="module")
def walkera():
    return prepare_blading(load_rotor("walkera-5g6"))


def flap(ratio, lock=3.0):
    return RigidFlapMode(ratio, 1.2 * SLOPE * CHORD * RADIUS**4 / lock)


def solve(case, ratio=math.inf, lock=3.0, inflow="annular", **changes):
    return solve_forward(case, replace(POINT, **changes), flap(ratio, lock), inflow=inflow)


# Closed forms


@pytest.mark.parametrize("inflow", ["uniform", "pitt-peters"])
@pytest.mark.parametrize("ratio", [1.1, 1.5, 1.7])
def test_lag_and_gain_of_a_hingeless_blade(textbook, ratio, inflow):
    still = solve(textbook, ratio, inflow=inflow)
    got = compute_cyclic_response(
        textbook, POINT, flap(ratio), amplitude_rad=math.radians(0.1), inflow=inflow, start=still
    )
    lock = 3.0 / 8.0
    if inflow == "pitt-peters":  # lift deficiency of dynamic inflow
        lock /= 1.0 + 2.0 * CHORD / (math.pi * RADIUS) * SLOPE / (16.0 * still.inflow_mean)
    assert math.degrees(got.lag_rad) == pytest.approx(math.degrees(math.atan2(lock, ratio**2 - 1.0)), abs=0.5)
    assert got.tilt_per_cyclic == pytest.approx(lock / math.hypot(lock, ratio**2 - 1.0), rel=0.02)


@pytest.mark.parametrize("lock", [3.0, 8.0])
@pytest.mark.parametrize("mu", [0.05, 0.1, 0.2])
def test_coning_and_flapping_in_edgewise_flight(textbook, mu, lock):
    got = solve(textbook, 1.0, lock, "uniform", edgewise_m_s=mu * SPEED * RADIUS)
    inflow = got.inflow_mean
    coning = lock * (PITCH / 8.0 * (1.0 + mu**2) - inflow / 6.0)
    assert got.coning_rad == pytest.approx(coning, rel=0.03)
    assert got.flap_cos_rad == pytest.approx(-mu * (8 / 3 * PITCH - 2 * inflow) / (1 - mu**2 / 2), rel=0.03)
    assert got.flap_sin_rad == pytest.approx(-(4 / 3 * mu * coning) / (1 + mu**2 / 2), rel=0.03)
    thrust = CHORD * 2 / math.pi / RADIUS * SLOPE / 2 * (PITCH * (1 / 3 + mu**2 / 2) - inflow / 2)
    assert got.c_T == pytest.approx(thrust, rel=0.03)


def test_slopes_of_an_element_are_those_of_its_forces():
    """Differences of F_z and lift over both velocities, inside the rows of Re, above them and in reversed flow."""
    rng = np.random.default_rng(4)
    table = np.cumsum(rng.normal(0.0, 0.02, (3, 723, 2)), axis=1)
    for across, down, row_zero in ((20.0, 3.0, 0.0), (20.0, -2.0, 40.0), (-4.0, 1.0, 0.3)):
        given = (0.01, row_zero, 0.25, 0.8)
        at = compute_element_forces.py_func(table, 0.31, across, down, *given)
        nudge = 1e-6
        for first, moved in ((5, (0.0, nudge)), (7, (nudge, 0.0))):
            over = [
                compute_element_forces.py_func(table, 0.31, across + k * moved[0], down + k * moved[1], *given)
                for k in (1, -1)
            ]
            for slope, force in ((at[first], 0), (at[first + 1], 2)):
                assert slope == pytest.approx((over[0][force] - over[1][force]) / (2.0 * nudge), rel=1e-5, abs=1e-8)


def test_free_blade_follows_its_cyclic_and_lags_its_shaft(textbook):
    still = solve(textbook, 1.0)
    got = compute_cyclic_response(textbook, POINT, flap(1.0), start=still, inflow="pitt-peters")
    assert got.tilt_per_cyclic == pytest.approx(1.0, abs=0.03)
    assert math.degrees(got.lag_rad) == pytest.approx(90.0, abs=0.5)
    rolling = solve(textbook, 1.0, inflow="uniform", rates_rad_s=(1.0, 0.0))
    assert rolling.flap_sin_rad * 3.0 * SPEED / 16.0 == pytest.approx(1.0, abs=0.02)
    assert abs(rolling.flap_cos_rad * SPEED) == pytest.approx(1.0, abs=0.01)  # gyroscopic, exact without inflow


@pytest.mark.parametrize("mu", [0.0, 0.05, 0.2])
def test_momentum_theory(mu):
    v = momentum_induced_velocity(1.0, 0.0, mu)
    assert v * math.hypot(mu, v) == pytest.approx(1.0)
    l0, lc, ls, cosine = pitt_peters_inflow(0.01, 0.0, 0.0, 0.0, 0.0, mu)
    assert l0 * math.hypot(l0, mu) == pytest.approx(0.005)
    assert ls == 0.0
    assert lc / l0 == pytest.approx(15 * math.pi / 32 * math.tan(0.5 * math.acos(cosine)))


def test_induced_velocity_is_continuous_from_climb_to_windmill():
    for edgewise in (0.0, 0.3, 0.8, 1.6):
        axial = np.linspace(2.0, -5.0, 1401)
        v = np.array([momentum_induced_velocity(1.0, x, edgewise) for x in axial])
        assert np.abs(np.diff(v)).max() < 0.12  # the windmill branch begins with a vertical tangent
        assert v.min() > 0.15
    assert momentum_induced_velocity(-1.0, 3.0, 0.5) == -momentum_induced_velocity(1.0, -3.0, 0.5)


# Axial flow


@pytest.mark.parametrize("climb", [0.0, 1.5, -0.8])
def test_axial_flow_is_blade_element_momentum_theory(walkera, climb):
    got = solve_forward(walkera, ForwardCondition(math.radians(13.0), 376.4, climb_m_s=climb))
    same = solve_rotor(walkera, pitch_rad=math.radians(13.0), speed_rad_s=376.4, climb_m_s=climb)
    assert got.thrust_N == pytest.approx(same.thrust_N, rel=1e-3)
    assert got.torque_Nm == pytest.approx(same.torque_Nm, rel=1e-3)
    scale = got.thrust_N * RADIUS
    odd = (got.h_force_N, got.y_force_N, got.flap_cos_rad, got.flap_sin_rad, got.roll_moment_Nm / scale,
           got.pitch_moment_Nm / scale, got.inflow_cos, got.inflow_sin, got.blade_thrust_2_per_rev_N)  # fmt: skip
    assert np.abs(odd).max() < 1e-9


def test_uniform_mean_differs_from_annuli_by_a_few_percent(walkera):
    mean = solve_forward(walkera, ForwardCondition(math.radians(13.0), 376.4), inflow="pitt-peters")
    annuli = solve_rotor(walkera, pitch_rad=math.radians(13.0), speed_rad_s=376.4)
    assert 0.0 < mean.thrust_N / annuli.thrust_N - 1.0 < 0.05
    assert -0.08 < mean.torque_Nm / annuli.torque_Nm - 1.0 < 0.0


# Balances and symmetry


@pytest.mark.parametrize("inflow", ["annular", "pitt-peters", "uniform"])
@pytest.mark.parametrize("ratio", [1.0, 1.2, math.inf])
def test_power_balance(walkera, ratio, inflow):
    c = replace(FLIGHT, rates_rad_s=(0.0, 0.0))
    got = solve_forward(walkera, c, make_flap_mode(walkera.rotors[0], ratio), inflow=inflow)
    spent = got.power_W + got.h_force_N * c.edgewise_m_s
    made = got.induced_power_W + got.profile_power_W + got.thrust_N * c.climb_m_s
    assert spent == pytest.approx(made, rel=1e-8)


def test_hub_moment_is_that_of_the_mode(walkera):
    for ratio in (1.0, 1.05, 1.6):
        mode = make_flap_mode(walkera.rotors[0], ratio)
        got = solve_forward(walkera, FLIGHT, mode)
        stiffness = 2 / 2 * mode.inertia_kg_m2 * FLIGHT.speed_rad_s**2 * (ratio**2 - 1.0)
        scale = got.thrust_N * RADIUS
        assert got.roll_moment_Nm == pytest.approx(-stiffness * got.flap_sin_rad, abs=1e-7 * scale)
        assert got.pitch_moment_Nm == pytest.approx(-stiffness * got.flap_cos_rad, abs=1e-7 * scale)


def test_a_very_stiff_blade_is_a_rigid_one(walkera):
    stiff = solve_forward(walkera, FLIGHT, make_flap_mode(walkera.rotors[0], 300.0))
    rigid = solve_forward(walkera, FLIGHT, make_flap_mode(walkera.rotors[0], math.inf))
    for name in ("thrust_N", "h_force_N", "roll_moment_Nm", "pitch_moment_Nm"):
        assert getattr(stiff, name) == pytest.approx(getattr(rigid, name), rel=2e-3)


def turn_inputs(c, angle):
    """The same flow seen by a hub whose nose is turned by ``angle`` to the left."""
    s, k = math.sin(angle), math.cos(angle)
    (a, b), (p, q) = c.cyclic_rad, c.rates_rad_s
    return replace(
        c, wind_azimuth_rad=c.wind_azimuth_rad + angle, cyclic_rad=(a * k + b * s, b * k - a * s),
        rates_rad_s=(p * k - q * s, p * s + q * k),
    )  # fmt: skip


@pytest.mark.parametrize("angle", [0.3, 2.0, -1.1])
@pytest.mark.parametrize("sign", [1, -1])
def test_wind_from_any_azimuth(walkera, angle, sign):
    mode = make_flap_mode(walkera.rotors[0], 1.1)
    c = replace(FLIGHT, rotation_sign=sign, cyclic_rad=(0.0, 0.0))
    first, other = (solve_forward(walkera, one, mode) for one in (c, turn_inputs(c, angle)))
    s, k = math.sin(angle), math.cos(angle)
    for x, y in (("h_force_N", "y_force_N"), ("pitch_moment_Nm", "roll_moment_Nm")):
        hx, hy = getattr(first, x), getattr(first, y)
        assert getattr(other, x) == pytest.approx(k * hx + s * hy, abs=1e-10)
        assert getattr(other, y) == pytest.approx(k * hy - s * hx, abs=1e-10)
    assert other.thrust_N == pytest.approx(first.thrust_N, rel=1e-10)
    assert math.hypot(other.flap_cos_rad, other.flap_sin_rad) == pytest.approx(
        math.hypot(first.flap_cos_rad, first.flap_sin_rad), abs=1e-10
    )


def test_cyclic_turns_with_the_wind(walkera):
    mode = make_flap_mode(walkera.rotors[0], 1.1)
    first, other = (solve_forward(walkera, one, mode) for one in (FLIGHT, turn_inputs(FLIGHT, 0.7)))
    assert other.thrust_N == pytest.approx(first.thrust_N, rel=1e-10)
    assert other.power_W == pytest.approx(first.power_W, rel=1e-10)


def test_mirror_image(walkera):
    mode = make_flap_mode(walkera.rotors[0], 1.1)
    c = replace(FLIGHT, wind_azimuth_rad=0.4)
    mirrored = replace(c, wind_azimuth_rad=-0.4, rotation_sign=-1, rates_rad_s=(-c.rates_rad_s[0], c.rates_rad_s[1]))
    one, two = solve_forward(walkera, c, mode), solve_forward(walkera, mirrored, mode)
    for name in FIELDS:
        sign = -1.0 if name in ("y_force_N", "roll_moment_Nm") else 1.0
        assert getattr(two, name) == pytest.approx(sign * getattr(one, name), abs=1e-10)


def test_drag_and_damping_dissipate(walkera):
    for ratio in (1.0, 1.1, 1.6):
        mode = make_flap_mode(walkera.rotors[0], ratio)
        still = ForwardCondition(math.radians(13.0), 376.4)
        for v in (1.0, 4.0, 8.0):
            assert solve_forward(walkera, replace(still, edgewise_m_s=v), mode).h_force_N > 0.0
        rolling = solve_forward(walkera, replace(still, rates_rad_s=(2.0, 0.0)), mode)
        arm = 0.09
        assert rolling.roll_moment_Nm + arm * rolling.y_force_N < 0.0


def test_a_sweep_equals_its_points(walkera):
    modes = [make_flap_mode(walkera.rotors[0], ratio) for ratio in (1.0, 1.6)]
    conditions = [ForwardCondition(math.radians(13.0), 376.4, edgewise_m_s=v) for v in (0.0, 2.0, 6.0)]
    sweep = sweep_forward(walkera, conditions, modes)
    for mode, line in zip(modes, sweep.points, strict=True):
        for c, got in zip(conditions, line, strict=True):
            alone = solve_forward(walkera, c, mode)
            for name in FIELDS:
                assert getattr(got, name) == pytest.approx(getattr(alone, name), rel=1e-7, abs=1e-9)
    assert sweep.responses[0][0].moment_Nm_deg == pytest.approx(0.0, abs=1e-9)
    assert "Lock number" in str(sweep)
    assert len(sweep.as_record()["points"]) == 6


def test_azimuths_and_stations_are_enough(walkera):
    mode = make_flap_mode(walkera.rotors[0], 1.2)
    coarse = solve_forward(walkera, FLIGHT, mode)
    fine = solve_forward(prepare_blading(walkera.rotors[0], stations=48), FLIGHT, mode, azimuths=72)
    for name in ("thrust_N", "torque_Nm", "h_force_N", "roll_moment_Nm", "pitch_moment_Nm"):
        assert getattr(coarse, name) == pytest.approx(getattr(fine, name), rel=5e-3)


# Beyond the edges


def test_points_outside_say_so(walkera):
    mode = make_flap_mode(walkera.rotors[0], 1.6)
    fast = solve_forward(walkera, ForwardCondition(math.radians(13.0), 376.4, edgewise_m_s=14.0), mode)
    assert fast.is_outside_range
    assert "advance ratio" in fast.notes[0]
    assert math.degrees(np.abs(fast.disc.onset_angle_rad).max()) > 90.0  # reversed flow at the retreating root
    sinking = solve_forward(walkera, ForwardCondition(math.radians(13.0), 376.4, climb_m_s=-2.5), mode)
    assert "vortex ring" in sinking.notes[0]
    assert not solve_forward(
        walkera, ForwardCondition(math.radians(13.0), 376.4, edgewise_m_s=2.0), mode
    ).is_outside_range


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"speed_rad_s": 0.0}, "speed_rad_s"),
        ({"edgewise_m_s": -1.0}, "edgewise_m_s"),
        ({"climb_m_s": math.nan}, "climb_m_s"),
        ({"cyclic_rad": (5.0, 0.0)}, "cyclic: is 286.48 degrees"),
        ({"rotation_sign": 0}, "rotation_sign"),
    ],
)
def test_impossible_conditions(textbook, changes, key):
    with pytest.raises(InputError, match=key):
        solve_forward(textbook, replace(POINT, **changes))


def test_impossible_settings(textbook, walkera):
    with pytest.raises(InputError, match="frequency_ratio"):
        make_flap_mode(walkera.rotors[0], 0.9)
    with pytest.raises(InputError, match="inflow"):
        solve_forward(textbook, POINT, inflow="free")
    rotor = load_rotor("walkera-5g6")
    with pytest.raises(InputError, match="effective_radius"):
        solve_forward(prepare_blading(rotor, corrections=Corrections(tip_loss="effective_radius")), FLIGHT)


# The pair

SPEEDS, ANGLES, SPACING = (376.4, 443.6), (math.radians(13.0), math.radians(14.0)), 0.04


def pair(case, ratio=1.6, speed=0.0, climb=0.0, spacing=SPACING, **changes):
    mode = make_flap_mode(case.rotors[0], ratio)
    conditions = tuple(
        ForwardCondition(a, w, speed, climb, rotation_sign=s, **changes)
        for a, w, s in zip(ANGLES, SPEEDS, (1, -1), strict=True)
    )
    return solve_forward_pair(case, case, conditions, (mode, mode), spacing_m=spacing)


def test_the_pair_at_rest_is_coaxial_blade_element_momentum_theory(walkera):
    got = pair(walkera)
    same = solve_system(
        RotorSystem.from_coaxial_pair(walkera, walkera, spacing_m=SPACING), OperatingCondition(ANGLES, SPEEDS)
    )
    for one, two in zip((got.upper, got.lower), same.rotors, strict=True):
        assert one.thrust_N == pytest.approx(two.thrust_N, rel=1e-3)
        assert one.torque_Nm == pytest.approx(two.torque_Nm, rel=1e-3)
    assert got.stream_share_on_lower_disc == 1.0
    assert abs(got.h_force_N) + abs(got.y_force_N) + abs(got.pitch_moment_Nm) < 1e-9


def test_a_lower_rotor_outside_the_stream_is_alone(walkera):
    got = pair(walkera, speed=9.0, spacing=0.1)
    mode = make_flap_mode(walkera.rotors[0], 1.6)
    alone = solve_forward(walkera, ForwardCondition(ANGLES[1], SPEEDS[1], 9.0, rotation_sign=-1), mode)
    assert got.stream_share_on_lower_disc == 0.0
    assert got.lower.thrust_N == pytest.approx(alone.thrust_N, rel=1e-9)
    assert got.lower.pitch_moment_Nm == pytest.approx(alone.pitch_moment_Nm, rel=1e-9)


def test_the_stream_leaves_the_lower_rotor_with_airspeed(walkera):
    slow, fast = pair(walkera, speed=1.0), pair(walkera, speed=5.0)
    assert 1.0 >= slow.stream_share_on_lower_disc > fast.stream_share_on_lower_disc > 0.0
    assert fast.lower.thrust_N > slow.lower.thrust_N
    equal = abs(slow.upper.pitch_moment_Nm - slow.lower.pitch_moment_Nm)
    assert slow.pitch_moment_Nm > 2.0 * abs(slow.roll_moment_Nm)  # pitch moments add, roll moments nearly cancel
    assert equal < abs(slow.pitch_moment_Nm)


def test_wind_from_the_right_turns_the_loads_of_a_pair(walkera):
    ahead, right = pair(walkera, speed=3.0), pair(walkera, speed=3.0, wind_azimuth_rad=0.5 * math.pi)
    assert right.h_force_N == pytest.approx(ahead.y_force_N, abs=1e-10)
    assert right.y_force_N == pytest.approx(-ahead.h_force_N, abs=1e-10)
    assert right.roll_moment_Nm == pytest.approx(-ahead.pitch_moment_Nm, abs=1e-10)


def test_pairs_that_do_not_belong_together(walkera):
    one = ForwardCondition(ANGLES[0], SPEEDS[0], 1.0)
    for other, key in (
        (replace(one, edgewise_m_s=2.0, rotation_sign=-1), "edgewise_m_s"),
        (one, "rotation_sign"),
    ):
        with pytest.raises(InputError, match=key):
            solve_forward_pair(walkera, walkera, (one, other), spacing_m=SPACING)
    with pytest.raises(InputError, match="spacing_m"):
        pair(walkera, spacing=0.0)


def test_pictures_have_units_on_their_axes(walkera):
    conditions = [ForwardCondition(ANGLES[0], SPEEDS[0], edgewise_m_s=v) for v in (0.0, 4.0)]
    sweep = sweep_forward(walkera, conditions, [make_flap_mode(walkera.rotors[0], 1.2)])
    one = pair(walkera, speed=4.0)
    several = PairSweep(("a", "b"), "", ((one, one),))
    for result in (sweep, several):
        for axes in result.plot().axes:
            assert "(" in axes.get_ylabel()
            assert "m/s" in axes.get_xlabel()
    assert len(sweep.points[0][1].plot().axes) == len(one.plot().axes) == 6
    assert "overlap" in str(several)
