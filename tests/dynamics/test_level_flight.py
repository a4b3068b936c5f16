"""Level flight over airspeed with blades computed over azimuth."""

import math

import pytest
from typer.testing import CliRunner

from mufly.cli.vehicle import app
from mufly.dynamics import find_trim
from mufly.dynamics import level_flight as level_flight_module
from mufly.dynamics.level_flight import level_flight
from mufly.errors import InputError
from mufly.rotor import load_rotor
from mufly.vehicle import load_vehicle


@pytest.fixture(scope="module")
def flight():
    return level_flight(load_vehicle("mufly-1.1"), load_rotor("walkera-5g6"), [1.0, 2.0])


def test_at_rest_it_is_the_hover_of_the_vehicle(flight):
    hover = find_trim(load_vehicle("mufly-1.1"), charge=0.5)
    for line in flight.trims:
        rest = line[0]
        assert rest.airspeed_m_s == 0.0
        assert rest.rotor_speed_rad_s == pytest.approx(tuple(hover.rotor_speed), rel=1e-3)
        assert rest.power_W == pytest.approx(hover.power_W, rel=2e-3)
        assert rest.motor_input == pytest.approx(tuple(hover.motor_input), rel=2e-3)
        assert max(abs(rest.pitch_rad), abs(rest.roll_rad), rest.servo) < 1e-3


def test_blow_back_limits_the_speed_of_stiff_blades_first(flight):
    free, stiff = flight.trims
    assert free[0].flap_frequency_ratio == pytest.approx(1.0)
    assert stiff[0].flap_frequency_ratio > 1.5
    assert stiff[1].servo > free[1].servo > 0.0
    assert free[1].servo_pitch < 0.0  # nose down against blow-back
    low, high = flight.greatest_speed_m_s
    assert 0.4 < low < 1.5
    assert low < high
    assert free[2].power_W < free[0].power_W  # translational lift
    assert free[2].thrust_margin > free[0].thrust_margin > 0.0
    assert "greatest level airspeed" in str(flight)


def test_picture_has_units(flight):
    for axes in flight.plot().axes:
        assert "(" in axes.get_ylabel()
        assert axes.get_xlabel() == "Airspeed (m/s)"


def test_blades_of_another_vehicle_are_refused():
    vehicle = load_vehicle("mufly-1.1")
    with pytest.raises(InputError, match="give the vehicle's blades by --rotor FILE"):
        level_flight(vehicle, load_rotor("naca0012-r60-c20"), [1.0])
    with pytest.raises(InputError, match="airspeeds"):
        level_flight(vehicle, load_rotor("walkera-5g6"), [math.nan])


def test_command_prints_the_band_and_draws(flight, monkeypatch, tmp_path):
    monkeypatch.setattr(level_flight_module, "level_flight", lambda *a: flight)
    found = CliRunner().invoke(app, ["speed", "mufly-1.1", "--speed", "1,2", "--out", str(tmp_path)])
    assert found.exit_code == 0, found.output
    assert "greatest level airspeed" in found.output
    assert (tmp_path / "speed.png").stat().st_size > 10_000
