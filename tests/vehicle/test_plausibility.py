"""Values that contradict physics are refused with file, key and remedy; unusual ones get a warning."""

from typing import Any

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.vehicle import find_unusual_parameters, format_vehicle_toml, load_vehicle, replace_parameters

KNOWN = load_vehicle("mufly-1.1")
FALLING = [*KNOWN.battery.open_circuit_voltage.value[:-1], 8.1]

IMPOSSIBLE = [
    ("battery.open_circuit_voltage", FALLING, "8.1 V at charge 1 is below 8.22 V at charge 0.9"),
    ("sensors.imu.accelerometer_range", 9.8, "above 9.81"),
    ("sensors.imu.position", [[10.0, 0.0, 0.0]], "10 m from the centre of gravity"),
    ("sensors.imu.position", [[0.0, 0.0, -0.3]], "0.3 m from the centre of gravity"),
    ("sensors.sonar.position", [[0.0, 3.0, 0.05]], "3 m from the centre of gravity"),
    ("sensors.sonar.position", [[0.0, 0.0, 0.07]], "is not above the tips of the legs"),
    ("sensors.sonar.resolution", 4.0, "leaves less than two steps"),
    ("rotors.upper.hub_z", -0.04, "the upper hub, z = -0.04 m, is not above the lower, z = -0.051 m"),
    ("rotors.lower.hub_z", -0.091, "the upper hub, z = -0.091 m, is not above"),
    ("rotors.lower.torque_coefficient", 8e-4, "the figure of merit would exceed 1"),
    ("rotors.upper.thrust_coefficient", 0.03, "is below 0.00367, the ideal rotor's"),
    ("contact.stiffness", 3.0, "presses the legs in by 77.7 mm"),
]

UNUSUAL = [
    ("body.drag_area_x", 0.4, "17 times the rotor disc's area"),
    ("body.drag_area_z", 0.04, "rotor disc's area"),
    ("body.inertia_yy", 3e-4, "which no rigid body does"),
    ("body.inertia_xx", 2e-3, "which no rigid body does"),
    ("air.density", 1.2e-1, "is not that of air"),
    ("rotors.upper.hub_z", -0.052, "the hubs are 1 mm apart"),
    ("battery.nominal_voltage", 3.7, "outside the open-circuit voltage, 6.54 to 8.4 V"),
    ("battery.capacity", 9000.0, "1.38e+03 W h/kg in 13 g"),
    ("contact.legs", [[0.5, 0.5, 0.07], [0.5, -0.5, 0.07], [-0.5, 0.5, 0.07], [-0.5, -0.5, 0.07]], "0.707 m beside"),
    ("contact.legs", [[0.05, 0.05, 0.07], [0.05, -0.05, 0.07], [0.02, 0.0, 0.07]], "do not surround"),
    ("sensors.imu.position", [[0.0, 0.0, 0.2]], "0.2 m from the centre of gravity"),
    ("sensors.imu.accelerometer_range", 15.0, "below 2 g"),
    ("sensors.imu.gyro_range", 1.2, "below 2 rad/s"),
    ("sensors.imu.bandwidth", 6e4, "above half the sample rate"),
    ("sensors.sonar.position", [[0.0, 0.0, -0.07]], "the beam meets blades"),
    ("sensors.sonar.min_range", 0.6, "blind up to 0.58 m above the floor"),
    ("sensors.magnetometer.field_strength", 48e-3 / 10, "not the Earth's field"),
    ("sensors.battery.voltage_resolution", 1.0, "14% of the nominal voltage"),
]


@pytest.mark.parametrize(("key", "value", "words"), IMPOSSIBLE)
def test_impossible_values_are_refused_with_key_and_remedy(key: str, value: Any, words: str) -> None:
    with pytest.raises(InputError) as caught:
        replace_parameters(KNOWN, {key: value})
    assert caught.value.key in (key, "rotors.upper.hub_z", "rotors.upper.torque_coefficient")
    assert words in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize(("key", "value", "words"), UNUSUAL)
def test_unusual_values_are_accepted_with_a_warning(key: str, value: Any, words: str) -> None:
    found = find_unusual_parameters(replace_parameters(KNOWN, {key: value}))
    assert [one.key for one in found if one.key == key] == [key]
    assert any(words in str(one) for one in found if one.key == key)


def test_a_falling_voltage_is_refused_in_a_file_and_a_flat_one_is_not(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(format_vehicle_toml(KNOWN).replace("8.4,", "8.1,"))
    with pytest.raises(InputError, match=r"mine\.toml: battery\.open_circuit_voltage: 8\.1 V at charge 1"):
        load_vehicle(path)
    flat = [*KNOWN.battery.open_circuit_voltage.value[:-1], 8.22]
    assert replace_parameters(KNOWN, {"battery.open_circuit_voltage": flat})


def test_ten_per_cent_of_error_in_every_number_causes_no_warning() -> None:
    rng = np.random.default_rng(11)
    keys = ("body.inertia_xx", "body.inertia_yy", "body.inertia_zz", "body.drag_area_x", "rotors.radius")
    for _ in range(20):
        near = {k: float(_value(k)) * rng.uniform(0.9, 1.1) for k in keys}
        assert find_unusual_parameters(replace_parameters(KNOWN, near)) == []


def _value(key: str) -> float:
    found: Any = KNOWN
    for part in key.split("."):
        found = getattr(found, part)
    return float(found)
