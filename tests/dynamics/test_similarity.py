"""Vehicles of another size: similarity's own checks, and that they hover."""

import numpy as np
import pytest

from mufly.dynamics import (
    compute_hover_rotor_speeds,
    hover_performance,
    judge_hover,
    linearise_vehicle,
    model_parameters,
    scale_vehicle_by_similarity,
)
from mufly.errors import ArgumentError, InputError
from mufly.quantities.units import RPM
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters


@pytest.fixture(scope="module")
def known() -> Vehicle:
    return load_vehicle("mufly-1.1")


def test_the_same_mass_and_size_are_the_same_vehicle(known: Vehicle) -> None:
    same = scale_vehicle_by_similarity(known, "same", mass_kg=0.095, radius_m=0.0875)
    for a, b in zip(list_parameters(known), list_parameters(same), strict=True):
        np.testing.assert_allclose(np.array(b.value), np.array(a.value), rtol=1e-4, err_msg=a.key)


@pytest.mark.parametrize(("mass", "radius"), [(0.03, 0.05), (0.3, 0.15), (0.05, 0.03)])
def test_a_similar_vehicle_hovers_alike(known: Vehicle, mass: float, radius: float) -> None:
    """Speeds by sqrt(mu) / la^2; inputs, endurance and thrust in hand as those of the known one."""
    new = scale_vehicle_by_similarity(known, "new", mass_kg=mass, radius_m=radius)
    speed = np.sqrt(mass / 0.095) / (radius / 0.0875) ** 2
    ours, theirs = (compute_hover_rotor_speeds(model_parameters(v)) for v in (new, known))
    np.testing.assert_allclose(ours / theirs, speed, rtol=1e-4)
    a, b = hover_performance(new), hover_performance(known)
    np.testing.assert_allclose(a.motor_input, b.motor_input, rtol=0.03)
    assert a.endurance_s == pytest.approx(b.endurance_s, rel=0.1)
    assert a.thrust_to_weight_half == pytest.approx(b.thrust_to_weight_half, rel=0.08)


def test_poles_go_with_similarity(known: Vehicle) -> None:
    """With mu = la^3 (same density) and the bar as slow in rotor turns, motor poles over rotor speed stay.

    The motor's inertia term J dOmega/dt scales as mu la^2 w, its damping kM kE / R as P / w^2: the ratio pole / w is
    P / (w^3 mu la^2), which is 1 for every mu and la.
    """
    new = scale_vehicle_by_similarity(known, "new", mass_kg=0.095 * 1.5**3, radius_m=0.0875 * 1.5)
    speed = np.sqrt(1.5**3) / 1.5**2
    poles = [np.sort(np.linalg.eigvals(linearise_vehicle(v).heave_yaw.A).real)[:2] for v in (known, new)]
    np.testing.assert_allclose(poles[1] / poles[0], speed, rtol=0.01)
    bars = [float(v.stabiliser_bar.time_constant) for v in (known, new)]
    assert bars[1] / bars[0] == pytest.approx(1.0 / speed, rel=1e-4)


def test_a_motor_of_ones_own(known: Vehicle) -> None:
    kv = 1800 * RPM
    own = scale_vehicle_by_similarity(
        known, "own", mass_kg=0.12, radius_m=0.09, speed_constant_rad_Vs=kv, resistance_ohm=0.3,
        no_load_current_A=0.2, gear_ratio=2.0,
    )  # fmt: skip
    m = own.motor
    assert float(m.back_emf_constant) * kv == pytest.approx(1.0, rel=1e-4)
    # Without load it draws what was given, at the nominal voltage: kM I = d omega, U - R I = kE omega
    turns = (float(own.battery.nominal_voltage) - 0.3 * 0.2) / float(m.back_emf_constant)
    assert float(m.friction) * turns / float(m.torque_constant) == pytest.approx(0.2, rel=1e-3)
    # The rotor behind a gear of 2 instead of 1.5 is less inertia to the motor, and reacts as before
    plain = scale_vehicle_by_similarity(known, "plain", mass_kg=0.12, radius_m=0.09)
    for a, b in ((own.rotors.upper, plain.rotors.upper), (own.rotors.lower, plain.rotors.lower)):
        assert float(a.drive_inertia) == pytest.approx(float(b.drive_inertia) * 0.75**2, rel=1e-3)
        assert float(a.reaction_inertia) == float(b.reaction_inertia)


def test_the_gear_that_is_chosen_needs_the_least_power(known: Vehicle) -> None:
    def power(gear: float | None) -> tuple[float, float]:
        v = scale_vehicle_by_similarity(
            known, "own", mass_kg=0.12, radius_m=0.09, speed_constant_rad_Vs=3000 * RPM, resistance_ohm=0.2,
            gear_ratio=gear,
        )  # fmt: skip
        return float(v.gear.ratio), hover_performance(v).battery_power_W

    ratio, least = power(None)
    assert ratio > 1.0
    assert all(power(ratio * k)[1] > least * 0.9999 for k in (0.85, 1.15))


def test_what_cannot_be_is_said(known: Vehicle) -> None:
    with pytest.raises(InputError, match=r"no gear lets it hover.*less resistance"):
        scale_vehicle_by_similarity(
            known, "weak", mass_kg=0.12, radius_m=0.09, speed_constant_rad_Vs=52.0, resistance_ohm=3.0
        )
    with pytest.raises(InputError, match="does not hover"):
        scale_vehicle_by_similarity(
            known,
            "weak",
            mass_kg=0.12,
            radius_m=0.09,
            speed_constant_rad_Vs=52.0,
            resistance_ohm=3.0,
            gear_ratio=1.0,
        )
    with pytest.raises(InputError, match="KV and its resistance together"):
        scale_vehicle_by_similarity(known, "half", mass_kg=0.12, radius_m=0.09, resistance_ohm=0.3)
    with pytest.raises(InputError, match="radius_m"):
        scale_vehicle_by_similarity(known, "none", mass_kg=0.12, radius_m=float("nan"))


@pytest.mark.parametrize(
    ("blamed", "options"),
    [
        ("capacity_As", {"capacity_As": 18.0}),
        ("gear_ratio", {"gear_ratio": 50.0}),
        ("no_load_current_A",
         {"speed_constant_rad_Vs": 314.0, "resistance_ohm": 0.2, "no_load_current_A": 30.0, "gear_ratio": 2.0}),
        ("resistance_ohm", {"speed_constant_rad_Vs": 314.0, "resistance_ohm": 6.0}),
        ("speed_constant_rad_Vs", {"speed_constant_rad_Vs": 40.0, "resistance_ohm": 0.3}),
        ("speed_constant_rad_Vs", {"speed_constant_rad_Vs": 40.0, "resistance_ohm": 0.3, "capacity_As": 1800.0}),
    ],
)  # fmt: skip
def test_the_option_without_which_it_hovers_is_named(known: Vehicle, blamed: str, options: dict[str, float]) -> None:
    with pytest.raises(ArgumentError) as caught:
        scale_vehicle_by_similarity(known, "weak", mass_kg=0.1, radius_m=0.09, **options)
    assert caught.value.argument == blamed


def test_mass_and_radius_that_do_not_fit_each_other_are_refused(known: Vehicle) -> None:
    with pytest.raises(InputError, match=r"radius_m: 9000 g on rotors of 20 mm need tips of Mach 4\.8"):
        scale_vehicle_by_similarity(known, "fast", mass_kg=9.0, radius_m=0.02)
    with pytest.raises(InputError, match=r"radius_m: 1 g on rotors of 1000 mm is outside the range of similarity"):
        scale_vehicle_by_similarity(known, "large", mass_kg=0.001, radius_m=1.0)


@pytest.mark.parametrize(
    ("mass", "radius", "changes", "keys"),
    [
        (0.095, 0.0875, {}, []),
        (0.05, 0.06, {}, []),
        (0.25, 0.12, {}, []),
        (0.5, 0.05, {}, ["rotors.radius", "mass_budget.actuators"]),
        (0.05, 0.3, {}, ["rotors.radius"]),
        (2.0, 0.05, {}, ["rotors.radius", "rotors.radius", "mass_budget.actuators"]),
        (0.095, 0.0875, {"battery.capacity": 40.0}, ["battery.capacity", "battery.capacity"]),
    ],
)
def test_limits_beyond_the_model_are_told(
    known: Vehicle, mass: float, radius: float, changes: dict[str, float], keys: list[str]
) -> None:
    made = replace_parameters(scale_vehicle_by_similarity(known, "new", mass_kg=mass, radius_m=radius), changes)
    found = list(judge_hover(made, hover_performance(made)))
    assert [one.key for one in found] == keys
    if mass == 0.5:
        assert "the disc loading is 625 N/m2" in found[0].problem
        assert "take 350 W in hover, 3.9 W/g" in found[1].problem


@pytest.mark.parametrize(
    ("mass", "radius", "words"),
    [(120.0, 0.08, "not grams: 0.12"), (0.12, 80.0, "not millimetres: 0.08")],
)
def test_a_mass_in_grams_or_a_radius_in_millimetres_is_refused(mass: float, radius: float, words: str) -> None:
    from mufly import dynamics, load_vehicle
    from mufly.errors import InputError

    with pytest.raises(InputError, match=words):
        dynamics.scale_vehicle_by_similarity(load_vehicle("mufly-1.1"), "mine", mass_kg=mass, radius_m=radius)


def test_a_new_vehicle_without_a_bar_has_equal_rotors(known: Vehicle) -> None:
    """The upper rotor loses the bar's inertia, so both rotors answer a motor alike; the bar's parameters are gone."""
    new = scale_vehicle_by_similarity(known, "bare", mass_kg=0.05, radius_m=0.06, bar=False)
    assert not new.stabiliser_bar.fitted
    p = model_parameters(new)
    assert p["J_up"] == p["J_dw"]
    assert p["bar_gain"] == 0.0
    barred = model_parameters(scale_vehicle_by_similarity(known, "barred", mass_kg=0.05, radius_m=0.06))
    assert barred["J_up"] == pytest.approx(3.0 * p["J_up"], rel=0.01)
    assert barred["J_dw"] == p["J_dw"]
