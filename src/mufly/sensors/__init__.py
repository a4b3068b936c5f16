"""What does it feel? Readings made from the true state and the world."""

from mufly.sensors.readings import (
    IdealBattery,
    IdealMotion,
    IdealRing,
    Reading,
    Readings,
    Sensor,
    Sensors,
    Truth,
    beam_angles,
    beam_directions,
    ideal_ranges,
    ideal_sensors,
    nearest_turn,
)

__all__ = [
    "IdealBattery",
    "IdealMotion",
    "IdealRing",
    "Reading",
    "Readings",
    "Sensor",
    "Sensors",
    "Truth",
    "beam_angles",
    "beam_directions",
    "ideal_ranges",
    "ideal_sensors",
    "nearest_turn",
]
