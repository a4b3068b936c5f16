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
        "imu.": "accelerometer_noise accelerometer_bias accelerometer_drift gyro_noise gyro_bias gyro_drift "
        "scale_error gyro_g_sensitivity misalignment accelerometer_temperature gyro_temperature warming vibration.once "
        "vibration.twice vibration.passing",
        "sonar.": "noise dropout multipath resolution",
        "pressure.": "noise drift downwash delay",
        "magnetometer.": "noise distortion hard_iron motor_field",
        "rotor_speed.": "noise constant_error",
        "battery.": "voltage_noise current_noise current_scale voltage_resolution",
        "position_fix.": "noise wander heading_noise heading_wander dropout jitter latency",
        "ring_camera.": "missed calibration",
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
