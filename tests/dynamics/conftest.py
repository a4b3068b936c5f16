"""Vehicles that the tests of the flight model share."""

import numpy as np
import pytest

from mufly.vehicle import Vehicle, load_vehicle, replace_parameters

NO_AIR = {
    "body.drag_area_x": 0.0,
    "body.drag_area_y": 0.0,
    "body.drag_area_z": 0.0,
    "body.downwash_drag": 0.0,
    "rotors.inplane_drag": 0.0,
}


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="session")
def published(vehicle: Vehicle) -> Vehicle:
    """muFly as the thesis models it: without drag of its rotors in their planes."""
    return replace_parameters(vehicle, {"rotors.inplane_drag": 0.0})


@pytest.fixture(scope="session")
def vacuum(vehicle: Vehicle) -> Vehicle:
    """muFly without drag on fuselage and in the rotors' planes."""
    return replace_parameters(vehicle, NO_AIR)


@pytest.fixture(scope="session")
def random_state():
    """Draw a state in mid-air with everything moving: ``random_state(rng)``."""
    from mufly.dynamics import STATE_SIZE

    def draw(rng: np.random.Generator, height: float = 50.0) -> np.ndarray:
        x = np.empty(STATE_SIZE)
        x[0:3] = rng.normal(size=3) - [0, 0, height]
        x[3:6] = rng.normal(size=3) * 3
        q = rng.normal(size=4)
        x[6:10] = q / np.linalg.norm(q)
        x[10:13] = rng.normal(size=3) * 5
        x[13:15] = rng.uniform(-0.2, 0.2, size=2)
        s = rng.normal(size=3)
        x[15:18] = s / np.linalg.norm(s)
        x[18:20] = rng.uniform(100, 600, size=2)
        x[20] = rng.uniform(0.05, 1.0)
        return x

    return draw
