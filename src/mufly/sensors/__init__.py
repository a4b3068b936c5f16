"""What does it feel? Measurements made from the true state and the world."""

from mufly.sensors.readings import (
    Measurement,
    beam_angles,
    beam_directions,
    ideal_measurement,
    ideal_ranges,
    nearest_turn,
)

__all__ = [
    "Measurement",
    "beam_angles",
    "beam_directions",
    "ideal_measurement",
    "ideal_ranges",
    "nearest_turn",
]
