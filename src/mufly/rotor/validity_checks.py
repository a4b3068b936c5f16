"""Checks of rotors before and after a solution: pitch, tip Mach number, vortex ring state and pairs that fit together.

Values that no method can solve raise an :class:`~mufly.errors.InputError`. Values outside the range of validity of the
theory issue a :class:`RotorValidityWarning`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mufly.errors import InputError
from mufly.quantities.units import RPM
from mufly.rotor.rotor_system import Air, PlacedRotor


class RotorValidityWarning(UserWarning):
    """Warning: a rotor is computed outside the range of validity of the theory."""


VORTEX_RING_DESCENT_RATIOS = (0.5, 2.0)
"""Range of descent velocity over induced velocity in hover with vortex ring state (Leishman 2006, Sec. 2.13.6)."""

MAX_TIP_MACH = 0.7
"""Tip Mach number up to which the correction for compressible flow is valid
(:func:`mufly.rotor.sections.section_coefficients.equivalent_incompressible_alpha`)."""


def compute_tip_mach(radius_m: float, speed_rad_s: float, air: Air | None = None, axial_m_s: float = 0.0) -> float:
    """Return the Mach number of the blade tips: of their motion and the axial flow together."""
    return math.hypot(radius_m * speed_rad_s, axial_m_s) / (air or Air()).sound_m_s


SUPERSONIC_TIP_REMEDY = "stay below 1, better below 0.7: the methods have no shock model"
"""Remedy of errors about :func:`describe_supersonic_tips`."""


def describe_supersonic_tips(
    radius_m: float, speed_rad_s: float, air: Air | None = None, axial_m_s: float = 0.0
) -> str:
    """Return the problem of tips at Mach 1 or faster as the text of an error; an empty text for slower tips."""
    mach = compute_tip_mach(radius_m, speed_rad_s, air, axial_m_s)
    if mach < 1.0:
        return ""
    beside = f" with {axial_m_s:g} m/s of climb" if axial_m_s else ""
    return f"{speed_rad_s / RPM:.6g} rpm ({speed_rad_s:.6g} rad/s) gives a tip Mach number of {mach:.1f}{beside}"


class VortexRingWarning(RotorValidityWarning):
    """Warning: a rotor descends in vortex ring state."""


def warn_vortex_ring(climb_m_s: float, thrust_N: float, area_m2: float, air: Air) -> None:
    """Issue a :class:`VortexRingWarning` if a disc descends within :data:`VORTEX_RING_DESCENT_RATIOS`."""
    induced = math.sqrt(max(thrust_N, 0.0) / (2.0 * air.density_kg_m3 * area_m2))
    if VORTEX_RING_DESCENT_RATIOS[0] * induced < -climb_m_s < VORTEX_RING_DESCENT_RATIOS[1] * induced:
        warnings.warn(
            f"sinking at {VORTEX_RING_DESCENT_RATIOS[0]:g} to {VORTEX_RING_DESCENT_RATIOS[1]:g} times the velocity "
            f"induced in "
            "hover a rotor is in its own wake (vortex ring, turbulent wake state): there is no steady "
            "wake; blade elements follow a curve "
            "through measured means (Leishman 2006, eq. 2.99), about which real loads swing",
            VortexRingWarning,
            stacklevel=3,
        )


def warn_upward_flow(flow_m_s: float) -> None:
    """Issue a :class:`RotorValidityWarning` if air passes the upper rotor of a pair upwards (``flow_m_s`` below 0).

    Parameters
    ----------
    flow_m_s : float
        Mean axial velocity through the upper disc, positive down.
    """
    if flow_m_s < 0.0:
        warnings.warn(
            f"air passes the upper rotor upwards ({-flow_m_s:.2g} m/s in the mean), but blade elements continue its "
            "wake down to the lower rotor: the interference is wrong; raise the pitch, sink slower, or use the method "
            "wake",
            RotorValidityWarning,
            stacklevel=3,
        )


_MAX_PITCH_RAD = 0.5 * math.pi * (1.0 + 1e-9)
_RPM_HINT = " (speed_rad_s is in rad/s; a number in rpm has to be multiplied by pi / 30)"


def warn_tip_mach(mach: float) -> None:
    """Issue a :class:`RotorValidityWarning` if a tip Mach number exceeds :data:`MAX_TIP_MACH`."""
    if mach > MAX_TIP_MACH:
        warnings.warn(
            f"the tips move at Mach {mach:.2f}; beyond {MAX_TIP_MACH:g} shocks stall the sections, and "
            f"thrust and torque are unreliable{_RPM_HINT if mach >= 1.0 else ''}",
            RotorValidityWarning, stacklevel=3,
        )  # fmt: skip


def check_pitch(where: str, name: str, pitch_rad: ArrayLike) -> None:
    """Raise :class:`InputError` for a pitch that is not finite or exceeds 90 degrees, for example one given in
    degrees."""
    values = np.asarray(pitch_rad, dtype=np.float64)
    beyond = ~(np.abs(values) <= _MAX_PITCH_RAD)
    if not np.any(beyond):
        return
    value = float(values[beyond].flat[0])
    if not math.isfinite(value):
        raise InputError(where, name, f"is {value:g}", "give a finite number")
    raise InputError(
        where, name.removesuffix("_rad"),
        f"is {math.degrees(value):.5g} degrees ({value:.5g} rad): beyond 90 a blade flies backwards",
        f"give -90 to 90 degrees; {value:g} degrees are {math.radians(value):.4g} rad",
    )  # fmt: skip


def check_rotors(rotors: Sequence[PlacedRotor], climb: float) -> None:
    """Raise :class:`InputError` if the rotors cannot be solved together."""
    if len(rotors) not in (1, 2):
        raise InputError("wake", "rotors", f"{len(rotors)} given", "give one rotor, or two")
    if not math.isfinite(climb):
        raise InputError("wake", "climb_m_s", f"is {climb:g}", "give a finite number")
    for p in rotors:
        if not (math.isfinite(p.speed_rad_s) and p.speed_rad_s > 0.0):
            raise InputError("wake", "speed_rad_s", f"is {p.speed_rad_s:g}", "give a number above 0")
        check_pitch("wake", "pitch_rad", p.pitch_rad)
        if p.rotation_sign not in (1, -1):
            raise InputError("wake", "hand", f"is {p.rotation_sign}", "give 1 or -1")
    if len(rotors) == 2:
        a, b = rotors
        if a.rotation_sign == b.rotation_sign:
            raise InputError(
                "wake", "hand", "both rotors turn the same way",
                "give opposite senses of rotation; the wake of a co-rotating pair has no steady mean",
            )  # fmt: skip
        gap = abs(a.height_m - b.height_m)
        if not gap > 0.0:
            raise InputError("wake", "spacing", "is zero", "give a distance above 0")
        reach = sum(_blade_vertical_reach(p) for p in rotors)
        if gap <= reach:
            raise InputError(
                "wake", "spacing", f"{1e3 * gap:.3g} mm makes the blades overlap",
                f"give more than {1e3 * reach:.3g} mm, what the pitched blades take up",
            )  # fmt: skip


def _blade_vertical_reach(placed: PlacedRotor) -> float:
    """Return the greatest extent of the pitched blade above or below its disc (m)."""
    b, k = placed.blading, placed.index_in_blading
    return float(np.max(0.75 * b.chord_m[k] * np.abs(np.sin(b.twist_rad[k] + placed.pitch_rad))))
