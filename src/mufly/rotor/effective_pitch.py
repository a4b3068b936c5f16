"""Effective pitch of a blade: its measured angle, the maker's pitch, and the uncertainty of both.

The angle at which a blade works differs from the angle in its file: chord lines of thin moulded sections are hard to
see in photographs, calipers and protractors err, blades twist and differ. The effective pitch is the angle at 0.75 R
plus an unknown offset p, the same along the blade. Its prior has two independent sources:

* the angle of the rotor file, with a standard deviation by the source of the geometry (:data:`ANGLE_STD_DEG`);
* the pitch H that the maker states, the advance in a turn of a screw with the angle atan(H / (2 pi 0.75 R)), with the
  standard deviation :data:`STATED_PITCH_STD_DEG`. Makers round H, refer it to the flat lower face or to the line of no
  lift, and state one number for a blade whose pitch changes along the span.

With the variances v_a and v_h of the two, and d the stated less the measured angle (limited to 7 degrees),

    mean p = d v_a / (v_a + v_h),      1 / variance = 1 / v_a + 1 / v_h        (inverse-variance weights)

Without a stated pitch the mean is 0. ``family`` adds a deviation to v_a for the making of the blade
(:mod:`mufly.rotor.blades.blade_families`); ``pitch_std`` of the rotor file replaces both.

The deviations are judgement: offsets of series of photographed propellers reach 3.3 degrees, two protractor readings
of a small blade agree within a degree. The ratio of photograph to stated pitch, 2 to 3 degrees, was chosen with the
errors of 17 propellers in view. Their mean errors of thrust and torque are 11.2 and 14.6 % without a stated pitch, 9.8
and 14.4 % with it. They are 10.6 and 14.9 % if the weight for a family is chosen on the other families. `mufly rotor
fit` replaces the prior by a posterior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from mufly.rotor.blades.blade_families import BladeFamilyPrior, find_family_priors
from mufly.rotor.geometry import GeometrySource, Rotor

ANGLE_STD_DEG: dict[GeometrySource, float] = {
    "photograph": 2.0,
    "maker": 1.0,
    "caliper": 1.0,
    "scan": 0.5,
    "CAD": 0.5,
}
"""Standard deviation of the angle at 0.75 R by the source of the geometry (degrees)."""
STATED_PITCH_STD_DEG = 3.0
"""Standard deviation of the angle from a maker's stated pitch (degrees)."""
_DEFAULT_PITCH_STD_DEG = 0.5  # of geometry without a source, taken as the user's own design
_MAX_PITCH_DISAGREEMENT_RAD = math.radians(7.0)
_PITCH_REFERENCE_STATION_RATIO = 0.75  # r/R


class PitchOffsetPrior(NamedTuple):
    """Prior of the effective pitch relative to the rotor file's angle: mean and deviation (rad), and basis in words."""

    offset_mean_rad: float
    offset_std_rad: float
    origin: str


def estimate_pitch_offset_prior(rotor: Rotor, families: Sequence[BladeFamilyPrior] = ()) -> PitchOffsetPrior:
    """Return the prior of the effective pitch's offset, which depends on how the rotor's geometry was obtained.

    Parameters
    ----------
    rotor : Rotor
        Its ``blade.geometry``, ``blade.family`` and ``nominal_pitch`` are read; without them the mean is 0 and the
        deviation 0.5 degrees, or ``blade.pitch_std`` if the file states one.
    families : sequence of BladeFamilyPrior
        Possible families by their probabilities; default: that of the file, none if it states none.
    """
    source = rotor.blade.geometry
    making = families or (find_family_priors(rotor) if rotor.blade.family else ())
    total = sum(f.probability for f in making)
    variance = sum(f.probability * f.pitch_std_deg**2 for f in making) / total if making else 0.0
    read = _DEFAULT_PITCH_STD_DEG if source is None else ANGLE_STD_DEG[source]
    own = math.radians(math.sqrt(read**2 + variance))
    if rotor.blade.pitch_std is not None:
        own = float(rotor.blade.pitch_std)
    basis = ", ".join(filter(None, (source or "own design", rotor.blade.family)))
    if rotor.nominal_pitch is None:
        return PitchOffsetPrior(0.0, own, basis)
    stated = math.atan(float(rotor.nominal_pitch) / (2.0 * math.pi * _PITCH_REFERENCE_STATION_RATIO * rotor.radius_m))
    apart = stated - float(rotor.twist_rad(_PITCH_REFERENCE_STATION_RATIO))
    apart = min(max(apart, -_MAX_PITCH_DISAGREEMENT_RAD), _MAX_PITCH_DISAGREEMENT_RAD)
    share = own**2 / (own**2 + math.radians(STATED_PITCH_STD_DEG) ** 2)
    return PitchOffsetPrior(share * apart, own * math.sqrt(1.0 - share), f"{basis} and stated pitch")
