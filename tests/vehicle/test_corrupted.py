"""Whatever is written into a vehicle file, the answer is a vehicle or one line that names the fault."""

import random
import tomllib

import pytest
import tomli_w

from mufly.errors import InputError, MuflyError
from mufly.vehicle import (
    format_vehicle_toml,
    list_parameters,
    load_vehicle,
    replace_parameters,
    vehicle_schema,
)

ODD = [
    float("nan"),
    float("inf"),
    -1.0,
    0.0,
    1e300,
    1e-300,
    "x",
    "",
    True,
    [],
    [1.0],
    [[1, 2]],
    {},
    {"value": 1},
    1979,
]


def places(table, before=()):
    for key, value in table.items():
        yield (*before, key)
        if isinstance(value, dict):
            yield from places(value, (*before, key))


def corrupted(tables, place, odd):
    copied = dict(tables)
    table = copied
    for key in place[:-1]:
        table[key] = dict(table[key])
        table = table[key]
    if odd is None:
        del table[place[-1]]
    else:
        table[place[-1]] = odd
    return copied


def user_error(act) -> str | None:
    """The line that a user would read, or None if nothing is wrong; any other exception fails the test."""
    try:
        act()
    except MuflyError as error:
        return str(error)
    return None


def test_every_corruption_is_a_vehicle_or_one_line(tmp_path, monkeypatch) -> None:
    tables = tomllib.loads(format_vehicle_toml(load_vehicle("mufly-1.1")))
    rng, path = random.Random(1), tmp_path / "odd.toml"
    for k, place in enumerate(list(places(tables))):
        for odd in [None, *rng.sample(ODD, 2)]:
            spoilt = corrupted(tables, place, odd)
            with monkeypatch.context() as patch:
                if k % 20:  # nine tenths of the time would go into writing and reading TOML, which is not ours
                    patch.setattr(vehicle_schema, "read_toml", lambda *_, spoilt=spoilt: (spoilt, str(path)))
                else:
                    path.write_text(tomli_w.dumps(spoilt))
                error = user_error(lambda: load_vehicle(path))
            assert error is None or ("\n" not in error and str(path) in error)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_what_is_accepted_can_be_asked_to_hover() -> None:
    from mufly.dynamics import hover_performance, standing_height

    vehicle = load_vehicle("mufly-1.1")
    for row in list_parameters(vehicle):
        if not isinstance(row.value, float) or row.key.startswith("mass_budget"):
            continue
        for odd in (0.0, 1e8):

            def ask(key: str = row.key, value: float = odd) -> None:
                v = replace_parameters(vehicle, {key: value})
                standing_height(v)
                hover_performance(v)

            assert "\n" not in (user_error(ask) or "")


@pytest.mark.parametrize(
    ("place", "odd", "key", "words"),
    [
        (("body", "mass", "unit"), ["g"], "body.mass", "not a unit"),
        (("contact", "legs", "value"), [], "contact.legs", "3 to 16"),
        (("contact", "legs", "value"), [[0.1, 0, -0.1]] * 3, "contact.legs", "below the centre of gravity"),
        (("range_ring", "min_range", "value"), 2.0, "range_ring.min_range", "not below max_range"),
        (("rotors", "radius", "value"), 1e300, "rotors.radius", "at most 5"),
        (("range_ring", "count"), True, "range_ring.count", "true is not a whole number"),
    ],
)
def test_fault_is_named(tmp_path, place, odd, key, words) -> None:
    tables = tomllib.loads(format_vehicle_toml(load_vehicle("mufly-1.1")))
    path = tmp_path / "odd.toml"
    path.write_text(tomli_w.dumps(corrupted(tables, place, odd)))
    with pytest.raises(InputError, match=words) as caught:
        load_vehicle(path)
    assert caught.value.key == key


def test_a_number_beyond_floating_point_is_one_line(tmp_path) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_text(format_vehicle_toml(load_vehicle("mufly-1.1")).replace("value = 0.095", "value = " + "9" * 400))
    assert "body.mass" in str(user_error(lambda: load_vehicle(path)))


def test_what_would_fly_on_energy_from_nowhere_is_refused() -> None:
    vehicle = load_vehicle("mufly-1.1")
    with pytest.raises(InputError, match=r"motor\.torque_constant: 0\.0047 N m/A is above back_emf_constant, 0\.0045"):
        replace_parameters(vehicle, {"motor.torque_constant": 0.0047})
    # Within the doubt of two measurements the two are one.
    assert replace_parameters(vehicle, {"motor.torque_constant": 0.00455}).motor.torque_constant.value == 0.00455
    for name in ("nominal_voltage", "low_voltage"):
        with pytest.raises(InputError, match=f"battery\\.{name}: 9 V is above the full battery's 8.4 V"):
            replace_parameters(vehicle, {f"battery.{name}": 9.0})


_SIGNED = ("sensors.pressure.downwash_coefficient", "sensors.magnetometer.inclination")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_every_number_twelve_decades_off_is_refused_by_its_key_or_flies() -> None:
    """A factor of 1e12 or 1e-12, or the other sign: one line that names the key, or a model with finite numbers."""
    import numpy as np

    from mufly.dynamics import find_longest_stable_step, initial_state, model_parameters, simulate_open_loop

    vehicle = load_vehicle("mufly-1.1")
    start, accepted = initial_state(position=(0.0, 0.0, -5.0), rotor_speed=(376.0, 444.0)), []
    refused: list[tuple[str, str]] = []
    for row in list_parameters(vehicle):
        if not isinstance(row.value, float) or row.value == 0.0 or row.key.startswith("mass_budget"):
            continue
        for factor in (1e12, 1e-12, -1.0):
            try:
                v = replace_parameters(vehicle, {row.key: factor * row.value})
            except InputError as error:
                refused.append((row.key, str(error)))
                continue
            if row.key.startswith("sensors."):
                # Errors may be next to nothing, and the port may lie where the downwash sucks; nothing may be as large.
                assert factor == 1e-12 or row.key in _SIGNED, (row.key, factor)
                continue
            accepted.append((row.key, factor))
            step = min(1e-3, 0.9 * find_longest_stable_step(model_parameters(v)))
            flown = simulate_open_loop(
                v, start, (0.67, 0.73, 0.1, 0.1), duration_s=20 * step, step_s=step, sample_s=step
            )
            assert np.isfinite(flown.truth_position.values).all(), (row.key, factor)
    # By its own key, or as the half of a pair that does not fit.
    assert all(key.rpartition(".")[2] in told for key, told in refused), refused
    # What may be next to nothing, a beam that looks the other way, and nothing else.
    assert {key.rpartition(".")[2] for key, _ in accepted} <= {
        "downwash_drag", "drag_area_x", "drag_area_y", "drag_area_z", "reaction_inertia", "linkage", "friction",
        "internal_resistance", "electronics_current", "damping", "min_range", "first_angle", "low_voltage",
        "inplane_drag", "ground_effect", "friction_torque",
    }  # fmt: skip
