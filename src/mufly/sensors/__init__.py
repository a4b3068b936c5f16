"""What does it feel? Measurements made from the true state and the world."""

from mufly.sensors.measurement import Measurement

__all__ = ["Measurement"]
