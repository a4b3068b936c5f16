import numpy as np
import pytest

from mufly.dynamics import initial_state
from mufly.sensors import Truth
from mufly.vehicle import Vehicle, load_vehicle, replace_parameters

RATE_HZ = 200.0


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="session")
def exact(vehicle: Vehicle) -> Vehicle:
    """The vehicle with sensors that have no errors but those of their kind: steps, cones, clipping, filters."""
    sensors = "sensors."
    zero = {
        "imu.": "accelerometer_noise_density accelerometer_bias accelerometer_drift gyro_noise_density "
        "gyro_bias gyro_drift scale_error gyro_g_sensitivity misalignment "
        "accelerometer_temperature_coefficient gyro_temperature_coefficient temperature_rise "
        "vibration.once_per_rev vibration.twice_per_rev vibration.blade_passing",
        "sonar.": "noise dropout_probability multipath_probability resolution",
        "pressure.": "noise drift downwash_coefficient filter_delay",
        "magnetometer.": "noise distortion hard_iron field_per_current",
        "rotor_speed.": "voltage_noise back_emf_constant_error",
        "battery.": "voltage_noise current_noise current_scale_error voltage_resolution",
        "position_fix.": "noise drift heading_noise heading_drift dropout_probability latency_jitter latency",
        "ring_camera.": "missed_spot_probability calibration_error",
    }
    return replace_parameters(
        vehicle, {f"{sensors}{group}{name}": 0.0 for group, names in zero.items() for name in names.split()}
    )


@pytest.fixture
def at():
    """Make the truth of an instant."""

    def make(time_s: float = 0.0, *, voltage: float = 7.4, current: float = 0.0, **state) -> Truth:
        x = initial_state(**{"position": (0.0, 0.0, -1.0), **state})
        attitude = np.array(state.get("attitude", (0.0, 0.0, 0.0)), dtype=float)
        return Truth(time_s, round(time_s * RATE_HZ), x, attitude, np.zeros(3), voltage, current)

    return make
