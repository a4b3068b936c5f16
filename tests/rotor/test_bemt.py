"""Blade element momentum theory against closed forms, balances, limits and itself."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mufly.drive import make_blade_load
from mufly.errors import InputError
from mufly.rotor import (
    TEXTBOOK_CORRECTIONS,
    Air,
    Blading,
    Corrections,
    OperatingCondition,
    PolarTable,
    Rotor,
    RotorSystem,
    RotorValidityWarning,
    VortexRingWarning,
    load_rotor,
    prepare_blading,
    solve_for_thrust,
    solve_rotor,
    solve_rotor_batch,
    solve_system,
)
from mufly.rotor.bemt import induced_velocity_ratio
from mufly.rotor.blades.blade_solid import blade_contours
from mufly.rotor.sections.polar_table import ALPHA_GRID

NO_LOSS = Corrections(tip_loss="none", hub_loss=False, swirl=False, lifting_surface=False, stall_delay="none")
SLOPE = 5.73


def a_table(cl, cd, reynolds=(1e3, 1e5, 1e7)) -> PolarTable:
    shape = (len(reynolds), ALPHA_GRID.size)
    valid = np.tile([-0.3, 0.3], (shape[0], 1))
    zeros = np.zeros(shape)
    return PolarTable("section", ALPHA_GRID, np.array(reynolds), zeros + cl, zeros + cd, zeros, valid, "made up")


LINEAR = a_table(SLOPE * ALPHA_GRID, 0.0)
REAL = a_table(
    np.where(np.abs(ALPHA_GRID) < 0.2, SLOPE * ALPHA_GRID, 1.1 * np.sin(2 * ALPHA_GRID)),
    0.02 + 1.8 * np.sin(ALPHA_GRID) ** 2,
)


def a_rotor(*, blades=2, radius=0.5, x0=0.1, x=(0.1, 1.0), chord=(0.05, 0.05), twist=(0.0, 0.0)) -> Rotor:
    def q(value, unit):
        return {"value": value, "unit": unit, "source": "specified"}

    return Rotor(
        name="test", blades=blades, radius=q(radius, "m"), hub_cutout=q(x0, "1"),
        blade={"r_over_R": q(tuple(x), "1"), "chord": q(tuple(chord), "m"), "twist": q(tuple(twist), "rad"),
               "airfoils": ("section",)},
    )  # fmt: skip


def blading(table=REAL, corrections=None, stations=24, **rotor) -> Blading:
    return prepare_blading(a_rotor(**rotor), {"section": table}, corrections=corrections, stations=stations)


def closed_form_inflow(theta, x, sigma):
    """Leishman, eq. 3.61."""
    return sigma * SLOPE / 16.0 * (np.sqrt(1.0 + 32.0 * theta * x / (sigma * SLOPE)) - 1.0)


@pytest.mark.parametrize("pitch_deg", [0.2, 1.0, 3.0])
def test_small_pitch_is_leishmans_closed_form(pitch_deg):
    case = blading(LINEAR, NO_LOSS, chord=(0.02, 0.02))
    out = solve_rotor(case, pitch_rad=math.radians(pitch_deg), speed_rad_s=100.0)
    sigma = 2 * 0.02 / (math.pi * 0.5)
    want = closed_form_inflow(math.radians(pitch_deg), out.r_m / 0.5, sigma)
    got = out.axial_induced_m_s / (100.0 * 0.5)
    assert_allclose(got[4:], want[4:], rtol=0.02)  # Leishman's form takes phi and alpha as small
    x, dx = out.r_m / 0.5, out.dr_m / 0.5
    assert_allclose(out.c_T, np.sum(4.0 * want**2 * x * dx), rtol=0.01)


def test_ideal_twist_gives_uniform_inflow_and_ideal_power():
    x = np.linspace(0.1, 1.0, 40)
    case = blading(LINEAR, NO_LOSS, x=tuple(x), chord=tuple(np.full(40, 0.02)), twist=tuple(0.05 / x), stations=48)
    out = solve_rotor(case, pitch_rad=0.0, speed_rad_s=80.0)
    assert_allclose(out.axial_induced_m_s, out.axial_induced_m_s[20], rtol=0.06)
    v = np.average(out.axial_induced_m_s, weights=out.r_m * out.dr_m)
    annulus = math.pi * 0.5**2 * (1 - 0.1**2)
    assert_allclose(v, math.sqrt(out.thrust_N / (2 * 1.2 * annulus)), rtol=0.002)
    assert_allclose(out.power_W, out.thrust_N * v, rtol=0.01)
    assert 0.97 < out.figure_of_merit < 1.0


def test_momentum_holds_in_every_annulus():
    out = solve_rotor(blading(LINEAR, NO_LOSS), pitch_rad=0.15, speed_rad_s=100.0)
    assert_allclose(out.dT_N, 4 * math.pi * 1.2 * out.r_m * out.axial_induced_m_s**2 * out.dr_m, rtol=1e-7)


@pytest.mark.parametrize("climb", [0.0, 3.0])
def test_shaft_power_is_what_the_air_and_the_drag_take(climb):
    out = solve_rotor(
        blading(REAL, Corrections(stall_delay="none")), pitch_rad=0.25, speed_rad_s=100.0, climb_m_s=climb
    )
    omega = 100.0
    wind = (omega * out.r_m - out.swirl_m_s) / np.cos(out.phi_rad)
    push = 0.5 * 1.2 * wind**2 * out.chord_m * 2 * out.dr_m
    lift, drag = push * out.cl, push * out.cd
    axial = np.sum(lift * np.cos(out.phi_rad) * (climb + out.axial_induced_m_s))
    swirl = np.sum(lift * np.sin(out.phi_rad) * out.swirl_m_s)
    profile = np.sum(drag * np.cos(out.phi_rad) * omega * out.r_m)
    assert_allclose(out.power_W, axial + swirl + profile, rtol=1e-9)
    assert_allclose(out.thrust_N, np.sum(lift * np.cos(out.phi_rad) - drag * np.sin(out.phi_rad)), rtol=1e-12)


def test_coefficients_do_not_depend_on_speed_at_constant_reynolds_number():
    case = blading(REAL)
    slow = solve_rotor(case, pitch_rad=0.2, speed_rad_s=50.0, air=Air(1.2, 1e-5))
    fast = solve_rotor(case, pitch_rad=0.2, speed_rad_s=200.0, air=Air(1.2, 4e-5, sound_m_s=4 * 343.2))
    assert_allclose([slow.c_T, slow.c_Q], [fast.c_T, fast.c_Q], rtol=1e-12)
    assert_allclose(fast.thrust_N, 16.0 * slow.thrust_N, rtol=1e-12)


@pytest.mark.parametrize("corrections", [TEXTBOOK_CORRECTIONS, Corrections(), Corrections(stall_delay="snel"), NO_LOSS])
@pytest.mark.parametrize("climb", [-20.0, -3.0, 0.0, 3.0])
def test_upside_down_is_the_mirror_image(corrections, climb):
    case = blading(REAL, corrections)
    up = solve_rotor(case, pitch_rad=0.2, speed_rad_s=100.0, climb_m_s=climb)
    down = solve_rotor(case, pitch_rad=-0.2, speed_rad_s=100.0, climb_m_s=-climb)
    assert_allclose(down.thrust_N, -up.thrust_N, rtol=1e-9)
    assert_allclose(down.torque_Nm, up.torque_Nm, rtol=1e-9)


def test_untwisted_symmetric_blade_at_zero_pitch_pays_drag_only():
    out = solve_rotor(blading(REAL), pitch_rad=0.0, speed_rad_s=100.0)
    assert abs(out.thrust_N) < 1e-12
    profile = 0.5 * 1.2 * 2 * 0.05 * 0.02 * 100.0**2 * np.sum(out.r_m**3 * out.dr_m)
    assert_allclose(out.torque_Nm, profile, rtol=1e-9)
    assert math.isnan(out.figure_of_merit)


def test_fast_climb_is_a_blade_without_inflow():
    # theta = 80 deg, V = 50 Omega R: the wind comes along the axis and induced velocities vanish.
    out = solve_rotor(blading(REAL, NO_LOSS), pitch_rad=math.radians(80.0), speed_rad_s=1.0, climb_m_s=25.0)
    free = np.arctan2(25.0, out.r_m)
    assert_allclose(out.phi_rad, free, atol=0.05)
    assert np.all(np.abs(out.axial_induced_m_s) < 1.0)  # of 25 m/s


def test_inflow_falls_in_climb_and_rises_in_slow_descent():
    case = blading(REAL, TEXTBOOK_CORRECTIONS)
    at = [
        solve_rotor(case, pitch_rad=0.2, speed_rad_s=100.0, climb_m_s=v).axial_induced_m_s.mean()
        for v in (-1.0, 0.0, 2.0)
    ]
    assert at[0] > at[1] > at[2]


@pytest.mark.filterwarnings("error::mufly.rotor.VortexRingWarning")
def test_a_rotor_that_sinks_into_its_own_wake_is_told() -> None:
    case = blading(REAL, TEXTBOOK_CORRECTIONS)
    free = solve_rotor(case, pitch_rad=0.2, speed_rad_s=100.0)
    induced = np.sqrt(free.thrust_N / (2 * 1.2 * np.pi * case.radius_m[0] ** 2))
    for sink in (-0.5, 0.0, 0.3, 3.0):  # climb, slow descent, windmill
        solve_system(RotorSystem.from_single_rotor(case), OperatingCondition(0.2, 100.0, climb_m_s=-sink * induced))
    with pytest.warns(VortexRingWarning, match="own wake"):
        solve_system(RotorSystem.from_single_rotor(case), OperatingCondition(0.2, 100.0, climb_m_s=-1.0 * induced))


def test_descent_closure_is_continuous_and_meets_momentum_theory():
    x = np.linspace(-5, 5, 200001)
    g = np.array([induced_velocity_ratio(v) for v in x])
    assert np.max(np.abs(np.diff(g))) < 1e-2  # the windmill root has a vertical tangent at -2
    assert induced_velocity_ratio(0.0) == 1.0
    assert_allclose(induced_velocity_ratio(-2.0), 1.0)
    beyond = np.abs(x) * 0 + ((x > 0) | (x < -2))
    assert_allclose(np.where(beyond, np.abs(x + g) * g, 1.0), 1.0, rtol=1e-6)


def test_few_slender_blades_approach_no_loss_and_more_blades_lose_less():
    free = solve_rotor(blading(REAL, NO_LOSS), pitch_rad=0.2, speed_rad_s=100.0).thrust_N
    ratio = []
    for n in (1, 2, 4, 16):
        kw = {"blades": n, "chord": (0.1 / n, 0.1 / n)}
        lossy = Corrections(lifting_surface=False, stall_delay="none", hub_loss=False, swirl=False)
        ratio.append(solve_rotor(blading(REAL, lossy, **kw), pitch_rad=0.2, speed_rad_s=100.0).thrust_N / free)
    assert all(a < b for a, b in pairwise(ratio))
    assert ratio[-1] > 0.97


def test_vanishing_chord_vanishing_inflow():
    out = solve_rotor(blading(REAL, TEXTBOOK_CORRECTIONS, chord=(1e-7, 1e-7)), pitch_rad=0.15, speed_rad_s=100.0)
    assert_allclose(out.alpha_rad, 0.15, atol=0.01)
    blade = 0.5 * 1.2 * 100.0**2 * 2 * 1e-7 * SLOPE * 0.15 * np.sum(out.r_m**2 * out.dr_m)
    assert_allclose(out.thrust_N, blade, rtol=0.02)


def test_compressible_flow_raises_the_lift_by_prandtl_and_glauerts_rule():
    case = blading(LINEAR, TEXTBOOK_CORRECTIONS, chord=(1e-7, 1e-7))  # without inflow to speak of
    slow, fast = (
        solve_rotor(case, pitch_rad=0.05, speed_rad_s=400.0, air=Air(sound_m_s=sound)) for sound in (1e9, 343.2)
    )
    mach = 400.0 * fast.r_m / 343.2
    assert mach.max() > 0.55
    assert_allclose(fast.cl / slow.cl, 1.0 / np.sqrt(1.0 - mach**2), rtol=1e-3)
    assert np.all((fast.cd == 0.0) | (mach > 0.87 - 0.12 - 0.11 - 0.1 * np.abs(fast.cl)))
    assert fast.cd[-1] >= 0.0
    real = blading(REAL, TEXTBOOK_CORRECTIONS)  # stalls at the lift that it always stalls at, at a smaller angle
    steep = [solve_rotor(real, pitch_rad=0.3, speed_rad_s=450.0, air=Air(sound_m_s=s)).cl.max() for s in (1e9, 343.2)]
    assert steep[1] < 1.02 * max(steep[0], 1.15)


def test_tips_beyond_mach_0_7_are_said_at_once():
    with pytest.warns(RotorValidityWarning, match=r"Mach 0\.8"):
        solve_system(RotorSystem.from_single_rotor(blading(REAL)), OperatingCondition(0.1, 0.8 * 343.2 / 0.5))
    with pytest.raises(InputError, match=r"Mach number of 1\.5"):
        solve_system(RotorSystem.from_single_rotor(blading(REAL)), OperatingCondition(0.1, 1.5 * 343.2 / 0.5))


def test_effective_radius_is_eq_3_13():
    case = blading(
        REAL, Corrections(tip_loss="effective_radius", lifting_surface=False, stall_delay="none"), stations=200
    )
    out = solve_rotor(case, pitch_rad=0.2, speed_rad_s=100.0)
    lam = np.average(out.axial_induced_m_s, weights=out.r_m * out.dr_m) / (100.0 * 0.5)
    wanted = 0.5 * (1.0 - 1.386 / 2 * lam / math.sqrt(1 + lam**2))
    lifting = out.r_m[np.abs(out.cl) > 1e-9].max()
    assert abs(lifting - wanted) < 0.005


def test_stations_converge():
    coarse = solve_rotor(blading(REAL), pitch_rad=0.2, speed_rad_s=100.0)
    fine = solve_rotor(blading(REAL, stations=200), pitch_rad=0.2, speed_rad_s=100.0)
    assert_allclose([coarse.thrust_N, coarse.torque_Nm], [fine.thrust_N, fine.torque_Nm], rtol=0.005)


def test_batch_is_bit_by_bit_the_single_point():
    rotors = [
        a_rotor(),
        a_rotor(blades=3, chord=(0.08, 0.03), twist=(0.3, 0.0)),
        a_rotor(radius=0.06, chord=(0.02, 0.02)),
    ]
    case = prepare_blading(rotors, {"section": REAL})
    rng = np.random.default_rng(5)
    n = 700
    pitch, speed = rng.uniform(-1.5, 1.5, n), rng.uniform(1.0, 1500.0, n)
    climb, which = rng.uniform(-30, 30, n), rng.integers(0, 3, n)
    with pytest.warns(RotorValidityWarning, match="Mach 2"):
        many = solve_rotor_batch(case, pitch_rad=pitch, speed_rad_s=speed, climb_m_s=climb, which=which)
    for i in range(0, n, 7):
        one = solve_rotor(case, pitch_rad=pitch[i], speed_rad_s=speed[i], climb_m_s=climb[i], which=int(which[i]))
        assert one.thrust_N == many.thrust_N[i]
        assert one.torque_Nm == many.torque_Nm[i]
        assert one.c_T == many.c_T[i]


@settings(max_examples=120, deadline=None)
@given(
    pitch=st.floats(-90, 90),
    speed=st.floats(0.1, 5000),
    climb=st.floats(-100, 100),
    chord=st.tuples(st.floats(1e-4, 0.5), st.floats(1e-4, 0.5)).filter(lambda c: c[0] >= 0.01 * c[1]),
    twist=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)),
    blades=st.integers(1, 8),
    x0=st.floats(0.0, 0.8),
    stall_delay=st.sampled_from(["none", "snel", "chaviaropoulos-hansen", "dumitrescu-cardos"]),
    tip=st.sampled_from(["none", "prandtl", "effective_radius"]),
    surface=st.booleans(),
    swirl=st.booleans(),
)
def test_never_fails_and_always_solves(pitch, speed, climb, chord, twist, blades, x0, stall_delay, tip, surface, swirl):
    fixes = Corrections(tip_loss=tip, swirl=swirl, lifting_surface=surface, stall_delay=stall_delay)
    case = blading(REAL, fixes, blades=blades, x0=x0, x=(0.0, 1.0), chord=chord, twist=twist)
    out = solve_rotor(case, pitch_rad=math.radians(pitch), speed_rad_s=speed, climb_m_s=climb)
    assert math.isfinite(out.thrust_N)
    assert math.isfinite(out.torque_Nm)
    size = math.hypot(speed * 0.5, climb)
    bound = 0.5 * 1.2 * (4 * size) ** 2 * 6.0 * blades * max(chord) * 0.5
    assert abs(out.thrust_N) < bound


@settings(max_examples=60, deadline=None)
@given(pitch=st.floats(-60, 60), climb=st.floats(-30, 30), blades=st.integers(1, 6), surface=st.booleans())
def test_blade_and_momentum_agree_at_the_solution(pitch, climb, blades, surface):
    fixes = Corrections(stall_delay="none", lifting_surface=surface)
    out = solve_rotor(
        blading(REAL, fixes, blades=blades), pitch_rad=math.radians(pitch), speed_rad_s=60.0, climb_m_s=climb
    )
    wind = np.hypot(60.0 * out.r_m - out.swirl_m_s, climb + out.axial_induced_m_s)
    load = blades * out.chord_m * wind**2 * out.cl * np.cos(out.phi_rad) / (8 * math.pi * out.r_m * out.loss)
    for load_i, u in zip(load, out.axial_induced_m_s, strict=True):
        hovering = math.sqrt(abs(load_i))
        if hovering > 1e-6:
            sign = math.copysign(1.0, load_i)
            want = sign * hovering * induced_velocity_ratio(sign * climb / hovering)
            assert abs(u - want) < 1e-5 * (30.0 + abs(climb))


def test_thrust_is_found_by_speed_and_by_pitch():
    case = blading(REAL)
    by_speed = solve_for_thrust(case, thrust_N=10.0, pitch_rad=0.2)
    by_pitch = solve_for_thrust(case, thrust_N=10.0, speed_rad_s=by_speed.speed_rad_s)
    assert_allclose([by_speed.thrust_N, by_pitch.thrust_N], 10.0, rtol=1e-8)
    assert_allclose(by_pitch.pitch_rad, 0.2, rtol=1e-7)


def test_thrust_out_of_reach_is_said_in_one_line():
    with pytest.raises(InputError, match="out of reach: at most"):
        solve_for_thrust(blading(REAL), thrust_N=1e6, speed_rad_s=100.0)
    with pytest.raises(InputError, match="needs one of pitch and speed"):
        solve_for_thrust(blading(REAL), thrust_N=1.0)


def test_faults_are_named():
    case = blading(REAL)
    with pytest.raises(InputError, match="speed_rad_s: is 0"):
        solve_rotor(case, pitch_rad=0.1, speed_rad_s=0.0)
    with pytest.raises(InputError, match="pitch_rad: is nan"):
        solve_rotor_batch(case, pitch_rad=[0.1, math.nan], speed_rad_s=10.0)
    with pytest.raises(InputError, match="there are 1 rotors"):
        solve_rotor_batch(case, pitch_rad=0.1, speed_rad_s=10.0, which=[0, 1])
    with pytest.raises(InputError, match="no polar"):
        prepare_blading(a_rotor(), {"other": REAL})
    with pytest.raises(InputError, match="unknown"):
        Corrections(stall_delay="magic")
    with pytest.raises(InputError, match="above 0"):
        Air(density_kg_m3=0.0)


def test_flags_name_stations_outside_the_polar():
    case = blading(REAL, TEXTBOOK_CORRECTIONS)
    assert not solve_rotor(case, pitch_rad=0.1, speed_rad_s=100.0).outside.any()
    steep = solve_rotor(case, pitch_rad=1.2, speed_rad_s=100.0)
    assert steep.outside.any()
    assert steep.outside_share > 0.5
    assert (solve_rotor(case, pitch_rad=0.1, speed_rad_s=0.01).outside == 2).all()


def test_a_pitch_in_degrees_is_refused_with_the_remedy():
    """Before: 14 was taken for 14 rad, and hover had an answer."""
    rotor = load_rotor("naca4412-r60-c20")
    for call in (
        lambda p: solve_rotor(rotor, pitch_rad=p, speed_rad_s=600.0),
        lambda p: solve_rotor_batch(rotor, pitch_rad=[0.2, p], speed_rad_s=600.0),
        lambda p: solve_system(
            RotorSystem.from_single_rotor(prepare_blading(rotor)), OperatingCondition(p, thrust_N=0.3)
        ),
        lambda p: make_blade_load(prepare_blading(rotor), pitch_rad=p),
        lambda p: blade_contours(rotor, pitch_rad=p),
    ):
        with pytest.raises(InputError, match=r"pitch: is 802\.14 degrees \(14 rad\).*14 degrees are 0\.2443 rad"):
            call(14.0)
    assert solve_rotor(rotor, pitch_rad=np.pi / 2, speed_rad_s=600.0).pitch_rad == pytest.approx(np.pi / 2)


def test_a_speed_in_rpm_is_told_apart():
    with pytest.warns(RotorValidityWarning, match=r"Mach 1\.2.*multiplied by pi / 30"):
        solve_rotor_batch(load_rotor("naca4412-r60-c20"), pitch_rad=0.2, speed_rad_s=7000.0)
