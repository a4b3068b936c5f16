"""The coaxial pair of Sec. 3.4.7: Figs 3.43, 3.44 and 3.45 and Table 3.4, by the wake method and by blade elements.

Two rotors of NACA 0012, R 60 mm, chord 20 mm, at 14 degrees. The source computed them with a vortex method of its own
kind, so these are comparisons of methods, not with measurements. What it leaves out and we take: hub cut-out 0.15 R;
spacing 20 mm where Fig. 3.45 does not vary it; equal speeds of both rotors in Fig. 3.45.

Computed with ``wake`` (:mod:`mufly.rotor.wake`, default settings, each case from the wake of the one before) and with
``full`` (coaxial blade element momentum theory). Speeds are fewer than in the source's figures: a wake takes seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from mufly.errors import MuflyError
from mufly.rotor import RotorResult, balance_torque, coaxial, hover, load_rotor, prepare
from mufly.rotor.blading import Blading
from mufly.rotor.wake import WakeSettings, WakeSolution, balance_torque_wake, coaxial_wake, hover_wake
from mufly.study.sweep import Progress

__all__ = ["COAXIAL_MODELS", "distances", "equal_speeds", "one_speed_kept", "torque_balance"]

COAXIAL_MODELS = ("wake", "full")
PITCH_DEG = 14.0
SPACING_M = 0.02
UPPER_RPM = 6000.0
_RPM = math.pi / 30.0
_FIELDS = {"thrust_N": "N", "torque_Nm": "N m", "power_W": "W", "c_T": "1", "c_Q": "1"}


@dataclass(frozen=True)
class _Point:
    upper_rpm: float = UPPER_RPM
    lower_rpm: float = UPPER_RPM
    lower_pitch_deg: float = PITCH_DEG
    spacing_m: float = SPACING_M
    balance: bool = False
    """Find the lower speed."""


def _blade() -> Blading:
    return prepare(load_rotor("naca0012-r60-c20"))


def _pair(
    model: str, blade: Blading, point: _Point, settings: WakeSettings | None, known: WakeSolution | None
) -> tuple[Sequence[RotorResult], WakeSolution | None, str]:
    """Upper and lower rotor, the wake to start the next case from, and what went wrong."""
    up, low = math.radians(PITCH_DEG), math.radians(point.lower_pitch_deg)
    upper = point.upper_rpm * _RPM
    try:
        if model == "wake":
            if point.balance:
                wake = balance_torque_wake(
                    blade, blade, spacing_m=point.spacing_m, upper_pitch_rad=up, lower_pitch_rad=low,
                    upper_speed_rad_s=upper, settings=settings, start=known,
                )  # fmt: skip
            else:
                wake = coaxial_wake(
                    blade, blade, spacing_m=point.spacing_m, upper_pitch_rad=up, lower_pitch_rad=low,
                    upper_speed_rad_s=upper, lower_speed_rad_s=point.lower_rpm * _RPM, settings=settings, start=known,
                )  # fmt: skip
            if wake.converged:
                return wake.rotors, wake, ""
            return (), known, wake.message
        if point.balance:
            both = balance_torque(
                blade, blade, spacing_m=point.spacing_m, upper_pitch_rad=up, lower_pitch_rad=low,
                upper_speed_rad_s=upper,
            )  # fmt: skip
        else:
            both = coaxial(
                blade, blade, spacing_m=point.spacing_m, upper_pitch_rad=up, lower_pitch_rad=low,
                upper_speed_rad_s=upper, lower_speed_rad_s=point.lower_rpm * _RPM,
            )  # fmt: skip
        return (both.upper, both.lower), known, ""
    except MuflyError as error:
        return (), known, str(error)


def _solve(
    model: str,
    axes: Mapping[str, Sequence[float | str]],
    at: Callable[..., _Point],
    settings: WakeSettings | None,
    progress: Progress | None,
) -> xr.Dataset:
    """Solve every combination of the axes; a case that does not converge holds nan and says why in ``fault``."""
    blade = _blade()
    shape = tuple(len(v) for v in axes.values())
    data = {
        f"{who}_{field}": np.full(shape, np.nan) for who in ("upper", "lower") for field in (*_FIELDS, "rpm")
    }
    fault = np.full(shape, "", dtype=object)
    known: WakeSolution | None = None
    for done, index in enumerate(np.ndindex(shape)):
        point = at(**{name: values[i] for (name, values), i in zip(axes.items(), index, strict=True)})
        rotors, known, fault[index] = _pair(model, blade, point, settings, known)
        for who, rotor in zip(("upper", "lower"), rotors, strict=False):
            for field in _FIELDS:
                data[f"{who}_{field}"][index] = getattr(rotor, field)
            data[f"{who}_rpm"][index] = rotor.speed_rad_s / _RPM
        if progress is not None:
            progress(done + 1, math.prod(shape))
    names = tuple(axes)
    out = xr.Dataset(
        {k: (names, v, {"units": _FIELDS.get(k.partition("_")[2], "rev/min")}) for k, v in data.items()},
        coords=dict(axes),
        attrs={"model": model},
    )
    out["fault"] = (names, fault.astype(str))
    return out


def equal_speeds(
    model: str,
    rpm: Sequence[float] = (3000, 5000, 7000),
    settings: WakeSettings | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Fig. 3.43: both rotors at the same speed, and one rotor alone (``single_...``)."""
    both = _solve(
        model, {"rpm": list(rpm)}, lambda rpm: _Point(upper_rpm=rpm, lower_rpm=rpm), settings, progress
    )
    blade, pitch = _blade(), math.radians(PITCH_DEG)
    known: WakeSolution | None = None
    alone: RotorResult | None
    single: dict[str, list[float]] = {field: [] for field in _FIELDS}
    for speed in rpm:
        if model == "wake":
            wake = hover_wake(
                blade, pitch_rad=pitch, speed_rad_s=speed * _RPM, settings=settings, start=known
            )
            known, alone = (wake, wake.rotors[0]) if wake.converged else (known, None)
        else:
            alone = hover(blade, pitch_rad=pitch, speed_rad_s=speed * _RPM)
        for field, values in single.items():
            values.append(float(getattr(alone, field)) if alone is not None else math.nan)
    return both.assign({f"single_{k}": ("rpm", v, {"units": _FIELDS[k]}) for k, v in single.items()})


def one_speed_kept(
    model: str,
    rpm: Sequence[float] = (3000, 4500, 6000, 7000),
    settings: WakeSettings | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Fig. 3.44: one rotor is kept at 6000 rpm, the other varied; ``varied`` says which."""

    def at(varied: str, rpm: float) -> _Point:
        return _Point(upper_rpm=rpm) if varied == "upper" else _Point(lower_rpm=rpm)

    return _solve(model, {"varied": ["upper", "lower"], "rpm": list(rpm)}, at, settings, progress)


def torque_balance(
    model: str,
    lower_pitch_deg: Sequence[float] = (14, 16, 18),
    settings: WakeSettings | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Table 3.4: the lower speed at which the torques cancel, the upper rotor at 6000 rpm."""

    def at(lower_pitch_deg: float) -> _Point:
        return _Point(lower_pitch_deg=lower_pitch_deg, balance=True)

    return _solve(model, {"lower_pitch_deg": list(lower_pitch_deg)}, at, settings, progress)


def distances(
    model: str,
    spacing_mm: Sequence[float] = (10, 20, 30, 40),
    rpm: Sequence[float] = (4000, 6000, 8000),
    settings: WakeSettings | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Fig. 3.45: the lower rotor at four distances below the upper one, both at the same speed."""

    def at(spacing_mm: float, rpm: float) -> _Point:
        return _Point(upper_rpm=rpm, lower_rpm=rpm, spacing_m=1e-3 * spacing_mm)

    return _solve(model, {"spacing_mm": list(spacing_mm), "rpm": list(rpm)}, at, settings, progress)
