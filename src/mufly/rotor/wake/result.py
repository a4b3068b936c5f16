"""What goes into the wake method and what comes out: rotors in their places, settings, wakes, the solution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.rotor.bemt import Air, RotorResult
from mufly.rotor.blading import Blading
from mufly.rotor.wake.blade import Surface

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WakeSettings:
    """How a wake is solved; docs/wake.md shows what each number does to the answer.

    Attributes
    ----------
    model : 'free' or 'prescribed'
        Free: the vortices go where the air takes them. Prescribed: Landgrebe's measured shape.
    step_deg : float
        Azimuth between the points of a filament.
    turns, far_turns : float
        Turns of free wake, and of helices below it.
    far_step_deg : float
        Azimuth between their points.
    core : float
        First core radius over the local chord.
    core_limit : float, optional
        Core radius of an old wake over R. By default 0.15 for one rotor and 0.2 for two, and more, in two steps, where
        the wake does not settle with it; the solution's settings and message say which.
    phases : int
        Relative azimuths over which two rotors' influence on each other is averaged.
    relaxation : float
        Part of the way that the points go in one iteration; less with age, by 1 / (1 + zeta / (4 pi)): what is wrong
        above adds up below.
    tolerance : float
        Converged when thrust and torque of the last ten iterations lie within this part of their mean.
    residual : float
        ... and the wake follows the air within this part of its velocity.
    iterations : int
        At most, with each core limit.
    inviscid : bool
        No boundary layer: c_l = 2 pi sin(alpha), no drag.
    gpu : bool
        Sum the velocities of the wake on a CUDA device.
    """

    model: Literal["free", "prescribed"] = "free"
    step_deg: float = 15.0
    turns: float = 4.0
    far_turns: float = 10.0
    far_step_deg: float = 30.0
    core: float = 0.1
    core_limit: float | None = None
    phases: int = 6
    relaxation: float = 0.35
    tolerance: float = 1e-3
    residual: float = 0.05
    iterations: int = 150
    inviscid: bool = False
    gpu: bool = False

    def __post_init__(self) -> None:
        if self.model not in ("free", "prescribed"):
            raise InputError("wake", "model", f"{self.model!r} is unknown", "use 'free' or 'prescribed'")
        coarse = "too coarse a wake; "
        for key, low, high, remedy in (
            ("step_deg", 1.0, 30.0, coarse + "give 1 to 30 degrees"),
            ("turns", 1.5, 40.0, coarse + "give 1.5 to 40 turns"),
            ("far_turns", 0.0, 100.0, "give 0 to 100 turns"),
            ("far_step_deg", 1.0, 45.0, coarse + "give 1 to 45 degrees"),
            ("core", 1e-3, 1.0, "give 0.001 to 1 of the chord"),
            ("phases", 2, 72, "give 2 to 72"),
            ("relaxation", 0.01, 1.0, "give 0.01 to 1"),
            ("tolerance", 1e-7, 0.1, "give 1e-7 to 0.1"),
            ("residual", 1e-6, 0.5, "give 1e-6 to 0.5"),
            ("iterations", 1, 100_000, "give 1 to 100000"),
        ):
            if not low <= getattr(self, key) <= high:
                raise InputError("wake", key, f"is {getattr(self, key):g}", remedy)
        if self.core_limit is not None and not 0.0 <= self.core_limit <= 0.5:
            raise InputError("wake", "core_limit", f"is {self.core_limit:g}", "give 0 to 0.5 of the radius")


@dataclass(frozen=True, eq=False)
class Placed:
    """A rotor in its place: pitch, speed, height of the disc along the shaft, sense of rotation (+1 or -1)."""

    blading: Blading
    pitch_rad: float
    speed_rad_s: float
    height_m: float = 0.0
    hand: int = 1
    which: int = 0


@dataclass(frozen=True, eq=False)
class Wake:
    """The vortices of one rotor, blade 1 on the x axis.

    Attributes
    ----------
    paths_m : (n + 1, points, 3) array
        Filaments from the quarter chord line down, in space (z up, the mirror image undone), blade 1 at azimuth 0.
    age_rad : (points,) array
    strength_m2_s : (n + 1,) array
        Circulation of the trailing filaments, along the path, in the rotor's own (unmirrored) frame.
    core_m : (n + 1, points - 1) array
    circulation_m2_s : (n,) array
        Of the panels.
    free_points : int
        Points that are free (the first ones after the quarter chord line).
    """

    placed: Placed
    surface: Surface
    paths_m: Array
    age_rad: Array
    strength_m2_s: Array
    core_m: Array
    circulation_m2_s: Array
    free_points: int


@dataclass(frozen=True, eq=False)
class WakeSolution:
    """What a solution holds.

    Attributes
    ----------
    rotors : tuple of RotorResult
    wakes : tuple of Wake
    converged : bool
    message : str
        One line: converged, or why not.
    residual : float
        Mismatch of the wake's shape and the velocity of the air, over the velocity (root mean squares).
    iterations : int
    history : (iterations, 1 + 2 rotors) array
        Residual, then thrust (N) and torque (N m) of each rotor.
    settings : WakeSettings
    air : Air
    climb_m_s : float
    """

    rotors: tuple[RotorResult, ...]
    wakes: tuple[Wake, ...]
    converged: bool
    message: str
    residual: float
    iterations: int
    history: Array
    settings: WakeSettings
    air: Air
    climb_m_s: float


def check_rotors(rotors: Sequence[Placed], climb: float) -> None:
    """Raise :class:`InputError` with one line if the rotors cannot be solved together."""
    if len(rotors) not in (1, 2):
        raise InputError("wake", "rotors", f"{len(rotors)} given", "give one rotor, or two")
    if not math.isfinite(climb):
        raise InputError("wake", "climb_m_s", f"is {climb:g}", "give a finite number")
    for p in rotors:
        if not (math.isfinite(p.speed_rad_s) and p.speed_rad_s > 0.0):
            raise InputError("wake", "speed_rad_s", f"is {p.speed_rad_s:g}", "give a number above 0")
        if not math.isfinite(p.pitch_rad):
            raise InputError("wake", "pitch_rad", f"is {p.pitch_rad:g}", "give a finite number")
        if p.hand not in (1, -1):
            raise InputError("wake", "hand", f"is {p.hand}", "give 1 or -1")
    if len(rotors) == 2:
        a, b = rotors
        if a.hand == b.hand:
            raise InputError(
                "wake", "hand", "both rotors turn the same way",
                "let them turn against each other; a co-rotating pair has a wake that is not steady in any mean",
            )  # fmt: skip
        gap = abs(a.height_m - b.height_m)
        if not gap > 0.0:
            raise InputError("wake", "spacing", "is zero", "give a distance above 0")
        reach = sum(_depth(p) for p in rotors)
        if gap <= reach:
            raise InputError(
                "wake", "spacing", f"{1e3 * gap:.3g} mm lets the blades overlap",
                f"give more than {1e3 * reach:.3g} mm, what the pitched blades take up",
            )  # fmt: skip


def _depth(placed: Placed) -> float:
    """How far a blade reaches above or below its disc: the greater part of its chord, pitched."""
    b, k = placed.blading, placed.which
    return float(np.max(0.75 * b.chord_m[k] * np.abs(np.sin(b.twist_rad[k] + placed.pitch_rad))))
