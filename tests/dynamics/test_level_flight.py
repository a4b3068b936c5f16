"""Level flight over airspeed with blades computed over azimuth."""

import math

import pytest
from typer.testing import CliRunner

from mufly.cli.vehicle import app
from mufly.dynamics import describe_excess_wind, find_trim, max_level_speed_band
from mufly.dynamics import level_flight as level_flight_module
from mufly.dynamics.level_flight import compute_level_flight
from mufly.errors import InputError
from mufly.rotor import load_rotor
from mufly.vehicle import load_vehicle, replace_parameters


@pytest.fixture(scope="module")
def flight():
    return compute_level_flight(load_vehicle("mufly-1.1"), load_rotor("walkera-5g6"), [1.0, 2.0])


def test_at_rest_it_is_the_hover_of_the_vehicle(flight):
    hover = find_trim(load_vehicle("mufly-1.1"), charge=0.5)
    for line in flight.trims:
        rest = line[0]
        assert rest.airspeed_m_s == 0.0
        assert rest.rotor_speed_rad_s == pytest.approx(tuple(hover.rotor_speed), rel=1e-3)
        assert rest.power_W == pytest.approx(hover.battery_power_W, rel=2e-3)
        assert rest.motor_input == pytest.approx(tuple(hover.motor_input), rel=2e-3)
        assert max(abs(rest.pitch_rad), abs(rest.roll_rad), rest.larger_servo_input) < 1e-3


def test_blow_back_limits_the_speed_of_stiff_blades_first(flight):
    free, stiff = flight.trims
    assert free[0].flap_frequency_ratio == pytest.approx(1.0)
    assert stiff[0].flap_frequency_ratio > 1.5
    assert stiff[1].larger_servo_input > free[1].larger_servo_input > 0.0
    assert free[1].servo_pitch < 0.0  # nose down against blow-back
    low, high = flight.greatest_speed_m_s
    assert 0.4 < low < 1.5
    assert low < high
    assert free[2].power_W < free[0].power_W  # translational lift
    assert free[2].thrust_margin > free[0].thrust_margin > 0.0
    assert "greatest level airspeed" in str(flight)


def test_the_flight_map_reaches_full_servo_at_the_same_speeds(flight):
    """The flight model with a map and the rotors solved at every trim agree within a tenth of a metre per second."""
    vehicle = load_vehicle("mufly-1.1")
    low, high = flight.greatest_speed_m_s
    band = max_level_speed_band(vehicle)
    assert band[0] == pytest.approx(low, abs=0.1)
    assert band[1] > 2.0
    assert high > 2.0
    hinged = replace_parameters(vehicle, {"rotors.flight_map": "mufly-1.1-hinged"})
    for trim in flight.trims[0][1:]:
        servo = find_trim(hinged, velocity=(trim.airspeed_m_s, 0.0, 0.0), charge=0.5).servo_input
        assert float(abs(servo).max()) == pytest.approx(trim.larger_servo_input, rel=0.15)


def test_a_flight_beyond_the_level_speed_says_so():
    vehicle = load_vehicle("mufly-1.1")
    assert "level flight ends at 0.7 to" in describe_excess_wind(vehicle, (3.0, 0, 0), 0.0)
    hinged = replace_parameters(vehicle, {"rotors.flight_map": "mufly-1.1-hinged"})
    assert describe_excess_wind(hinged, (3.0, 0, 0), 0.0) == ""
    assert "3.7 and" in describe_excess_wind(hinged, (4.0, 0, 0), 0.0)


def test_picture_has_units(flight):
    for axes in flight.plot().axes:
        assert "(" in axes.get_ylabel()
        assert axes.get_xlabel() == "Airspeed (m/s)"


def test_blades_of_another_vehicle_are_refused():
    vehicle = load_vehicle("mufly-1.1")
    with pytest.raises(InputError, match="give the vehicle's blades by --rotor FILE"):
        compute_level_flight(vehicle, load_rotor("naca0012-r60-c20"), [1.0])
    with pytest.raises(InputError, match="airspeeds"):
        compute_level_flight(vehicle, load_rotor("walkera-5g6"), [math.nan])


def test_command_prints_the_band_and_draws(flight, monkeypatch, tmp_path):
    monkeypatch.setattr(level_flight_module, "compute_level_flight", lambda *a: flight)
    found = CliRunner().invoke(app, ["speed", "mufly-1.1", "--speed", "1,2", "--out", str(tmp_path)])
    assert found.exit_code == 0, found.output
    assert "greatest level airspeed" in found.output
    assert (tmp_path / "speed.png").stat().st_size > 10_000
