"""One component of a signal on its own clock, and its units: converted, or guessed for angles and said."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.angle_unit import UnitGuess, guess_angle_units
from mufly.logs.resample import unwrap
from mufly.logs.signals import signal_named
from mufly.logs.units import conversion, known_unit

__all__ = ["Series", "in_si", "settle_angles", "unit_of", "without_jumps"]

_ANGLES, _RATES = ("roll", "pitch", "yaw"), ("p", "q", "r")
_ALIASES = {"roll": _ANGLES[0], "phi": "roll", "pitch": "pitch", "theta": "pitch", "yaw": "yaw", "psi": "yaw"}


@dataclass(frozen=True)
class Series:
    """One component of a signal on its own, increasing clock.

    ``unit`` is what the values are in, ``""`` as long as nobody has said; ``source`` names topic and column.
    """

    variable: str
    label: str | None
    time: NDArray[np.float64]
    values: NDArray[Any]
    unit: str
    source: str
    hold: bool = False
    long_name: str = ""

    @property
    def key(self) -> str:
        """``variable.label``."""
        return self.variable if self.label is None else f"{self.variable}.{self.label}"


def unit_of(variable: str) -> str:
    signal = signal_named(variable)
    return signal.units if signal is not None else ""


def in_si(series: Series) -> Series:
    """Convert to the signal's unit; units that nobody knows stay as they are."""
    if series.values.dtype.kind in "US":
        return series
    wanted = unit_of(series.variable) or None
    unit = series.unit or wanted or "1"
    if unit == wanted or (wanted is None and not known_unit(unit)):
        return replace(series, unit=unit, values=series.values.astype(np.float64))
    if unit == "us" and wanted == "us":
        return series
    try:
        reached, factor, offset = conversion(unit, wanted)
    except InputError as error:
        raise InputError(
            series.source, series.key, f"the unit {unit!r} {error.problem}", error.remedy
        ) from None
    return replace(series, unit=reached, values=series.values.astype(np.float64) * factor + offset)


def without_jumps(series: Series) -> Series:
    angle = series.variable.endswith("_attitude") or (series.label is None and series.variable in _ALIASES)
    if angle and series.unit == "rad":
        return replace(series, values=unwrap(series.values))
    return series


def _role(series: Series) -> tuple[str, str, int] | None:
    """("measured", "angle", 0) for the roll angle of measured_attitude or a column called roll or phi; else None."""
    prefix, _, kind = series.variable.partition("_")
    if kind == "attitude" and series.label in _ANGLES:
        return prefix, "angle", _ANGLES.index(series.label)
    if kind == "rates" and series.label in _RATES:
        return prefix, "rate", _RATES.index(series.label)
    if series.label is None and series.variable.lower() in _ALIASES:
        return "", "angle", _ANGLES.index(_ALIASES[series.variable.lower()])
    if series.label is None and series.variable in _RATES:
        return "", "rate", _RATES.index(series.variable)
    return None


def settle_angles(series: list[Series]) -> tuple[list[Series], list[str]]:
    """Guess the units of angles and rates that name none; check those that do. Says every guess."""
    groups: dict[str, dict[tuple[str, int], Series]] = {}
    for s in series:
        role = _role(s)
        if role is not None and s.values.dtype.kind not in "US":
            groups.setdefault(role[0], {})[role[1], role[2]] = s
    settled: dict[str, str] = {}
    words: list[str] = []
    for prefix in sorted(groups, key=lambda p: p != "measured"):
        group = groups[prefix]
        for kind in ("angle", "rate"):
            members = [s for (k, _), s in group.items() if k == kind]
            if not members:
                continue
            what = members[0].variable if prefix else ", ".join(s.variable for s in members)
            guess, unit = _guess(group, kind)
            unnamed = [s for s in members if not s.unit]
            si = "rad" if kind == "angle" else "rad/s"
            deg = "deg" if kind == "angle" else "deg/s"
            if unnamed:
                like = settled.get(f"{groups.get('measured', {}).get((kind, 0), unnamed[0]).key}", "")
                chosen = {"deg": deg, "rad": si}.get(unit) or like or si
                why = (
                    guess.reason if unit else "as in measured_" + {"angle": "attitude", "rate": "rates"}[kind]
                )
                if not unit and not like:
                    why = "nothing in the data tells otherwise"
                words.append(f"{what} names no unit and is taken to be in {chosen} ({why})")
                settled |= {s.key: chosen for s in unnamed}
            for s in members:
                if s.unit == si and unit == "deg":
                    words.append(
                        f"{s.key} ({s.source}) is said to be in {si} but looks like {deg} ({guess.reason}); "
                        f'if it is, give unit = "{deg}" in a column map'
                    )
                    break
                if s.unit == deg and unit == "rad":
                    words.append(
                        f"{s.key} ({s.source}) is said to be in {deg} but looks like {si} ({guess.reason}); "
                        f'if it is, give unit = "{si}" in a column map'
                    )
                    break
    return [replace(s, unit=settled.get(s.key, s.unit)) for s in series], words


def _guess(group: dict[tuple[str, int], Series], kind: str) -> tuple[UnitGuess, str]:
    """Judge by the first axis that tells."""
    last = UnitGuess("", "", "")
    for axis in range(3):
        angle, rate = group.get(("angle", axis)), group.get(("rate", axis))
        main = angle if kind == "angle" else rate
        if main is None:
            continue
        clock = (angle or main).time
        a = None if angle is None else _near_unwrapped(angle.values.astype(np.float64))
        if rate is None:
            r = None
        elif rate.time is clock:
            r = rate.values.astype(np.float64)
        else:
            known = np.isfinite(rate.values)
            r = np.interp(clock, rate.time[known], rate.values[known]) if known.any() else None
        last = guess_angle_units(clock, a, r, bounded=axis < 2)
        said = last.angle if kind == "angle" else last.rate
        if said:
            return last, said
    return last, ""


def _near_unwrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take out jumps by a full turn, be it 2 pi or 360."""
    known = np.isfinite(angle)
    out = angle.copy()
    if known.any():
        period = 360.0 if np.ptp(angle[known]) > 4 * np.pi else 2 * np.pi
        out[known] = np.unwrap(angle[known], period=period)
    return out
