"""What the thesis prints about its controllers, to stand beside ours (Sec. 6.1; facts.csv, keys S6.1-*)."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["HEAVE_YAW", "ROLL_PITCH", "VELOCITY", "PublishedDesign"]


@dataclass(frozen=True)
class PublishedDesign:
    """Printed figures of one design; None where the text gives none.

    Attributes
    ----------
    gamma : float
        H-infinity level reached.
    plant_crossovers : tuple of float
        0 dB crossings of the unscaled plant's singular values, rad/s.
    crossover : float
        Of the loop gain, rad/s.
    sensitivity_peak_dB, complementary_peak_dB : float
        Of S_u and T_u.
    resonance : float
        Of the plant, rad/s.
    order : int
        On the processor, after reduction.
    """

    gamma: float | None = None
    plant_crossovers: tuple[float, ...] | None = None
    crossover: float | None = None
    sensitivity_peak_dB: float | None = None
    complementary_peak_dB: float | None = None
    resonance: float | None = None
    order: int | None = None


HEAVE_YAW = PublishedDesign(
    gamma=1.38,
    plant_crossovers=(2.82, 575.0),
    crossover=3.26,
    sensitivity_peak_dB=3.7398,
    complementary_peak_dB=3.93,
    order=10,
)
ROLL_PITCH = PublishedDesign(crossover=36.0, complementary_peak_dB=1.9, resonance=14.5, order=8)
VELOCITY = PublishedDesign()
