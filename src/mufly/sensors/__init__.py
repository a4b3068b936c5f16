"""What does it feel? Measurements made from the true state and the world."""

from mufly.sensors.ideal import beam_angles, beam_directions, ideal_measurement, ideal_ranges, nearest_turn
from mufly.sensors.measurement import Measurement

__all__ = [
    "Measurement",
    "beam_angles",
    "beam_directions",
    "ideal_measurement",
    "ideal_ranges",
    "nearest_turn",
]
