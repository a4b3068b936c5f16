"""One coaxial pair at one point, by either method: what is given, what is found, what the pair costs.

A case is a dictionary of parameters (``parameters.PAIR``, SI values). It says spacing, pitch (or the pitch of each
rotor) and one of

* ``upper_speed`` with ``lower_speed`` or ``speed_ratio``: the pair is evaluated at these speeds;
* ``upper_speed`` alone: the lower speed is found at which the torques cancel;
* ``thrust``: both speeds are found, torques cancelled.

With ``free = "lower-pitch"`` the lower pitch cancels the torques instead, at the speeds given, or, with a thrust, at
speeds of the ratio given (1 if none is).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from mufly.errors import InputError, MuflyError
from mufly.rotor import Air, Blading, Corrections, Rotor, RotorResult, balance_torque, coaxial, hover, prepare
from mufly.rotor.blading import STATIONS
from mufly.rotor.wake import (
    Placed,
    WakeSettings,
    WakeSolution,
    balance_pitch,
    balance_pitch_wake,
    balance_torque_wake,
    coaxial_wake,
    hover_wake,
)
from mufly.rotor.wake.result import check_rotors
from mufly.study.evaluate import polar_tables
from mufly.study.parameters import PAIR, Value
from mufly.study.setup import METHODS
from mufly.study.shape import reshape

__all__ = ["Free", "PairPoint", "PairSetup", "alone", "bladings_of", "check_pair", "solve_pair"]

Free = Literal["lower-speed", "lower-pitch"]
Progress = Callable[[int, float, float], None]


@dataclass(frozen=True)
class PairSetup:
    """What all cases of a pair share.

    Attributes
    ----------
    upper, lower : Rotor
    fixed : mapping
        Parameters that hold in every case unless it names them itself.
    method : 'bemt' or 'wake'
    wake : WakeSettings
    corrections : Corrections
    engine, model : str
        Of the polars.
    stations : int
        Along each blade.
    free : 'lower-speed' or 'lower-pitch'
        What cancels the torques.
    """

    upper: Rotor
    lower: Rotor
    fixed: Mapping[str, Value] = field(default_factory=dict)
    method: str = "wake"
    wake: WakeSettings = field(default_factory=WakeSettings)
    corrections: Corrections = field(default_factory=Corrections)
    engine: str = "neuralfoil"
    model: str = "xlarge"
    stations: int = STATIONS
    free: Free = "lower-speed"

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(
                "coaxial", "method", f"{self.method!r} is unknown", f"use one of: {', '.join(METHODS)}"
            )
        if self.free not in ("lower-speed", "lower-pitch"):
            raise InputError(
                "coaxial",
                "free",
                f"{self.free!r} cannot balance the torques",
                "use lower-speed or lower-pitch",
            )


@dataclass(frozen=True, eq=False)
class PairPoint:
    """A pair at a point.

    Attributes
    ----------
    upper, lower : RotorResult
        Each rotor in the presence of the other.
    spacing_m, disc_m2 : float
        Distance of the discs, and the area of the larger one.
    air : Air
    solution : WakeSolution or None
        The wake, if that was the method.
    converged : bool
    message : str
        How it converged, or why not.
    """

    upper: RotorResult
    lower: RotorResult
    spacing_m: float
    disc_m2: float
    air: Air
    solution: WakeSolution | None
    converged: bool
    message: str

    @property
    def thrust_N(self) -> float:
        return self.upper.thrust_N + self.lower.thrust_N

    @property
    def power_W(self) -> float:
        return self.upper.power_W + self.lower.power_W

    @property
    def yaw_torque_Nm(self) -> float:
        """Torque of the lower less that of the upper rotor; 0 in trim."""
        return self.lower.torque_Nm - self.upper.torque_Nm

    @property
    def figure_of_merit(self) -> float:
        """T sqrt(T / (2 rho A)) / P with one disc, the larger; nan unless thrust and power are positive."""
        if not (self.thrust_N > 0.0 and self.power_W > 0.0):
            return math.nan
        return (
            self.thrust_N
            * math.sqrt(self.thrust_N / (2.0 * self.air.density_kg_m3 * self.disc_m2))
            / self.power_W
        )


def check_pair(setup: PairSetup, names: Iterable[str]) -> None:
    """Refuse a study of a pair whose parameters make no sense together.

    Raises
    ------
    InputError
        If spacing, a pitch or an operating point is missing, or there are two.
    """
    every = {*names, *setup.fixed}
    for name in every:
        if name not in PAIR:
            raise InputError("coaxial", name, "cannot be varied or set", f"use one of: {', '.join(PAIR)}")
    if "spacing" not in every:
        raise InputError("coaxial", "spacing", "is missing", "give it, as spacing=20mm")
    each = [n for n in ("upper_pitch", "lower_pitch") if n in every]
    if not ("pitch" in every or len(each) == 2 or (each == ["upper_pitch"] and setup.free == "lower-pitch")):
        raise InputError("coaxial", "pitch", "is missing", "give pitch=14deg, or upper_pitch and lower_pitch")
    if "pitch" in every and len(each) == 2:
        raise InputError("coaxial", "pitch", "is given beside both pitches", "leave it out")
    if setup.free == "lower-pitch" and "lower_pitch" in every:
        raise InputError(
            "coaxial", "lower_pitch", "is given and sought", "leave it out, or balance by lower-speed"
        )
    if ("thrust" in every) == ("upper_speed" in every):
        raise InputError(
            "coaxial", "", "needs one of thrust and upper_speed", "give thrust=0.9N or upper_speed=6000rpm"
        )
    below = [n for n in ("lower_speed", "speed_ratio") if n in every]
    if len(below) == 2:
        raise InputError("coaxial", "speed_ratio", "is given beside lower_speed", "leave one of the two out")
    if "thrust" in every and (below == ["lower_speed"] or (below and setup.free == "lower-speed")):
        raise InputError(
            "coaxial", below[0], "is given beside a thrust, which finds it", "leave one of the two out"
        )


def bladings_of(setup: PairSetup, case: Mapping[str, Value]) -> tuple[Blading, Blading]:
    """Both rotors of a case, reshaped and laid out.

    Raises
    ------
    MuflyError
        If a shape is impossible or an airfoil has no polar.
    """
    every = {**setup.fixed, **case}
    shapes = []
    for side, rotor in (("upper", setup.upper), ("lower", setup.lower)):
        own = {n: every[f"{side}_{n}"] for n in ("chord", "taper", "twist") if f"{side}_{n}" in every}
        shapes.append(reshape(rotor, own))
    names = list(dict.fromkeys(n for r in shapes for n in r.airfoil_names()))
    found = polar_tables(names, float(every.get("n_crit", 0.1)), setup)
    good = {}
    for name, table in found.items():
        if isinstance(table, str):
            raise MuflyError(table)
        good[name] = table
    upper, lower = (prepare(r, good, corrections=setup.corrections, stations=setup.stations) for r in shapes)
    return upper, lower


def air_of(setup: PairSetup, case: Mapping[str, Value]) -> Air:
    """The air of a case."""
    return Air(float({**setup.fixed, **case}.get("density", Air().density_kg_m3)))


def solve_pair(
    setup: PairSetup,
    case: Mapping[str, Value] | None = None,
    *,
    bladings: tuple[Blading, Blading] | None = None,
    start: WakeSolution | None = None,
    progress: Progress | None = None,
) -> PairPoint:
    """Solve a pair at a point.

    Parameters
    ----------
    setup : PairSetup
    case : mapping, optional
        What changes from ``setup.fixed``; see the module docstring.
    bladings : (upper, lower), optional
        From :func:`bladings_of`, if they are at hand.
    start : WakeSolution, optional
        A similar wake to start from.
    progress : callable, optional
        Of the wake: iteration, residual, thrust (N).

    Raises
    ------
    InputError
        If parameters make no sense together, or the blades would touch.
    MuflyError
        If no balance is found. A single wake that does not converge is returned, marked so.
    """
    every = {**setup.fixed, **(case or {})}
    check_pair(setup, every)
    upper, lower = bladings or bladings_of(setup, every)
    air = air_of(setup, every)
    number = {k: float(v) for k, v in every.items() if not isinstance(v, str)}
    spacing, climb, thrust = number["spacing"], number.get("climb", 0.0), number.get("thrust")
    above = number.get("upper_pitch", number.get("pitch", math.nan))
    below = number.get("lower_pitch", number.get("pitch", above))
    first = number.get("upper_speed", 300.0)
    second = number.get("lower_speed", first * number.get("speed_ratio", 1.0))
    check_rotors((Placed(upper, above, first, 0.0, 1), Placed(lower, below, second, -spacing, -1)), climb)
    common = {"spacing_m": spacing, "upper_pitch_rad": above, "climb_m_s": climb}
    wake = setup.method == "wake"
    more = {"settings": setup.wake, "start": start, "progress": progress}
    fixed = "lower_speed" in number or "speed_ratio" in number
    if setup.free == "lower-pitch":
        speeds = {"upper_speed_rad_s": first, "lower_speed_rad_s": second, "thrust_N": thrust}
        answer = (
            balance_pitch_wake(upper, lower, **common, **speeds, air=air, **more)  # type: ignore[arg-type]
            if wake
            else balance_pitch(upper, lower, **common, **speeds, air=air)  # type: ignore[arg-type]
        )
    elif fixed:
        at = {"lower_pitch_rad": below, "upper_speed_rad_s": first, "lower_speed_rad_s": second}
        answer = (
            coaxial_wake(upper, lower, **common, **at, air=air, **more)  # type: ignore[arg-type]
            if wake
            else coaxial(upper, lower, **common, **at, air=air)  # type: ignore[arg-type]
        )
    else:
        given = {"thrust_N": thrust} if thrust is not None else {"upper_speed_rad_s": first}
        answer = (
            balance_torque_wake(upper, lower, **common, **given, lower_pitch_rad=below, air=air, **more)  # type: ignore[arg-type]
            if wake
            else balance_torque(upper, lower, **common, **given, lower_pitch_rad=below, air=air)
        )
    disc = math.pi * max(upper.rotors[0].radius_m, lower.rotors[0].radius_m) ** 2
    if isinstance(answer, WakeSolution):
        a, b = answer.rotors
        return PairPoint(a, b, spacing, disc, air, answer, answer.converged, answer.message)
    return PairPoint(
        answer.upper, answer.lower, spacing, disc, air, None, True, f"settled in {answer.turns} turns"
    )


def alone(
    setup: PairSetup, point: PairPoint, bladings: tuple[Blading, Blading], progress: Progress | None = None
) -> tuple[RotorResult, RotorResult]:
    """Both rotors of a point without each other: same pitch, speed and climb.

    Raises
    ------
    MuflyError
        If a wake does not converge.
    """
    out: list[RotorResult] = []
    for blading, r in zip(bladings, (point.upper, point.lower), strict=True):
        same = out and blading.rotors == bladings[0].rotors
        if same and (r.pitch_rad, r.speed_rad_s) == (out[0].pitch_rad, out[0].speed_rad_s):
            out.append(out[0])
            continue
        at = {"pitch_rad": r.pitch_rad, "speed_rad_s": r.speed_rad_s, "climb_m_s": r.climb_m_s}
        if point.solution is None:
            out.append(hover(blading, **at, air=point.air))  # type: ignore[arg-type]
            continue
        s = hover_wake(blading, **at, air=point.air, settings=setup.wake, progress=progress)  # type: ignore[arg-type]
        if not s.converged:
            raise MuflyError(
                f"coaxial: the wake of the {('upper', 'lower')[len(out)]} rotor alone is {s.message}"
            )
        out.append(s.rotors[0])
    return out[0], out[1]
