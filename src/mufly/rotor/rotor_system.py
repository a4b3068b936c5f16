"""What is solved and what comes out: rotors on one shaft, an operating point, the wakes, the result.

A :class:`RotorSystem` says which rotors stand where and turn which way, a :class:`OperatingCondition` what is given of
the operating point. :func:`mufly.rotor.solve_system` answers with a :class:`SystemSolution`, whatever the method.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.errors import InputError
from mufly.results import result
from mufly.rotor.blading import Blading, ensure_blading
from mufly.rotor.geometry import Rotor, blade_thickness_m
from mufly.units import RPM

Array = NDArray[np.float64]
SolverMethod = Literal["bemt", "tubes", "wake"]


SPEED_OF_SOUND_M_S = 343.2
"""Speed of sound in dry air at 20 C (ISO 2533)."""


@dataclass(frozen=True)
class Air:
    """The air: density (kg/m3), dynamic viscosity (Pa s), speed of sound (m/s).

    Default: 1.2 kg/m3, as in the dissertation, at 20 C.
    """

    density_kg_m3: float = 1.2
    viscosity_Pa_s: float = 1.81e-5
    sound_m_s: float = SPEED_OF_SOUND_M_S

    def __post_init__(self) -> None:
        for key in ("density_kg_m3", "viscosity_Pa_s", "sound_m_s"):
            if not 0.0 < getattr(self, key) < math.inf:
                raise InputError("air", key, f"is {getattr(self, key):g}", "give a number above 0")


def blade_stations(rotor: Rotor, speed_rad_s: float, air: Air | None = None) -> dict[str, Array]:
    """Return what a blade is along its radius: at the stations of its file, its cut-out and every quarter.

    Parameters
    ----------
    rotor : Rotor
    speed_rad_s : float
        For the Reynolds numbers of the chord in still air.
    air : Air, optional

    Returns
    -------
    dict of str to (stations,) array
        ``r_over_R``, ``chord_m``, ``twist_rad``, ``thickness_m`` and ``reynolds``.
    """
    air, cutout = air or Air(), float(rotor.hub_cutout)
    x = np.unique(np.concatenate(([cutout], rotor.blade.r_over_R.array(), [0.25, 0.5, 0.75, 1.0])))
    x = x[x >= cutout]
    chord = rotor.chord_m(x)
    return {
        "r_over_R": x, "chord_m": chord, "twist_rad": rotor.twist_rad(x), "thickness_m": blade_thickness_m(rotor, x),
        "reynolds": x * rotor.radius_m * speed_rad_s * chord * air.density_kg_m3 / air.viscosity_Pa_s,
    }  # fmt: skip


class RotorWarning(UserWarning):
    """A rotor is computed beyond what its theory was made for."""


VORTEX_RING_RANGE = (0.5, 2.0)
"""Descent over the velocity induced in hover between which a rotor is in its own wake (Leishman 2006, Sec. 2.13.6)."""

MAX_TIP_MACH = 0.7
"""Of the tips, up to which the correction for compressible flow serves
(:func:`mufly.rotor.bemt.equivalent_incompressible_alpha`)."""


def compute_tip_mach(radius_m: float, speed_rad_s: float, air: Air | None = None) -> float:
    """Return the Mach number of the blades' tips."""
    return radius_m * speed_rad_s / (air or Air()).sound_m_s


class VortexRingWarning(RotorWarning):
    """A rotor sinks into its own wake."""


def warn_vortex_ring(climb_m_s: float, thrust_N: float, area_m2: float, air: Air) -> None:
    """Give a :class:`VortexRingWarning` where a disc sinks within :data:`VORTEX_RING_RANGE`."""
    induced = math.sqrt(max(thrust_N, 0.0) / (2.0 * air.density_kg_m3 * area_m2))
    if VORTEX_RING_RANGE[0] * induced < -climb_m_s < VORTEX_RING_RANGE[1] * induced:
        warnings.warn(
            f"sinking at {VORTEX_RING_RANGE[0]:g} to {VORTEX_RING_RANGE[1]:g} times the velocity induced in "
            f"hover a rotor is in "
            "its own wake (vortex ring, turbulent wake state): no steady wake is there; blade elements follow a curve "
            "through measured means (Leishman 2006, eq. 2.99), about which real loads swing",
            VortexRingWarning,
            stacklevel=3,
        )


_MAX_PITCH_RAD = 0.5 * math.pi * (1.0 + 1e-9)
_RPM_HINT = " (speed_rad_s is in rad/s; a number in rpm has to be multiplied by pi / 30)"


def warn_tip_mach(mach: float) -> None:
    """Give a :class:`RotorWarning` where the tips are beyond :data:`MAX_TIP_MACH`."""
    if mach > MAX_TIP_MACH:
        warnings.warn(
            f"the tips move at Mach {mach:.2f}; beyond {MAX_TIP_MACH:g} shocks stall the sections, and thrust and "
            f"torque are a guess{_RPM_HINT if mach >= 1.0 else ''}",
            RotorWarning, stacklevel=3,
        )  # fmt: skip


def check_pitch(where: str, name: str, pitch_rad: ArrayLike) -> None:
    """Raise :class:`InputError` for a pitch that is not finite or beyond 90 degrees, such as one given in degrees."""
    values = np.asarray(pitch_rad, dtype=np.float64)
    beyond = ~(np.abs(values) <= _MAX_PITCH_RAD)
    if not np.any(beyond):
        return
    value = float(values[beyond].flat[0])
    if not math.isfinite(value):
        raise InputError(where, name, f"is {value:g}", "give a finite number")
    raise InputError(
        where, name, f"is {value:g} rad, which is {math.degrees(value):.0f} degrees: beyond 90 a blade flies backwards",
        f"give radians: math.radians({value:g}) is {math.radians(value):.4g}",
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class PlacedRotor:
    """A rotor in its place: pitch, speed, height of the disc along the shaft, sense of rotation (+1 or -1)."""

    blading: Blading
    pitch_rad: float
    speed_rad_s: float
    height_m: float = 0.0
    rotation_sign: int = 1
    rotor_index: int = 0


@dataclass(frozen=True, eq=False)
class RotorSystem:
    """Rotors on one shaft, the uppermost first. Make it with :meth:`single_rotor` or :meth:`coaxial_pair`.

    Attributes
    ----------
    bladings : tuple of Blading
    disc_heights_m : tuple of float
        Of each disc, along the shaft.
    rotation_signs : tuple of int
        Sense of rotation: 1 or -1.
    rotor_indices : tuple of int
        Which of its blading's rotors each one is.
    """

    bladings: tuple[Blading, ...]
    disc_heights_m: tuple[float, ...]
    rotation_signs: tuple[int, ...]
    rotor_indices: tuple[int, ...]

    def __post_init__(self) -> None:
        if not self.bladings or any(b >= a for a, b in zip(self.disc_heights_m, self.disc_heights_m[1:], strict=False)):
            raise InputError("rotor", "height_m", "does not fall", "give the uppermost rotor first")

    @classmethod
    def single_rotor(cls, blading: Blading | Rotor, *, which: int = 0) -> RotorSystem:
        """Return one rotor; a :class:`Rotor` is prepared with all defaults."""
        return cls((ensure_blading(blading),), (0.0,), (1,), (which,))

    @classmethod
    def coaxial_pair(cls, upper: Blading | Rotor, lower: Blading | Rotor, *, spacing_m: float) -> RotorSystem:
        """Return two rotors that turn against each other; the first rotor of each blading is taken.

        A :class:`Rotor` is prepared with all defaults.

        Raises
        ------
        InputError
            If the distance between the discs is not above zero.
        """
        if not 0.0 < spacing_m < math.inf:
            raise InputError("coaxial", "spacing_m", f"is {spacing_m:g}", "give a distance above 0")
        above = ensure_blading(upper)
        below = above if lower is upper else ensure_blading(lower)
        return cls((above, below), (0.0, -spacing_m), (1, -1), (0, 0))

    def place_rotors(self, pitch_rad: Sequence[float], speed_rad_s: Sequence[float]) -> tuple[PlacedRotor, ...]:
        """Return the rotors in their places, with the pitch and speed of each."""
        return tuple(
            PlacedRotor(b, p, s, h, hand, which)
            for b, p, s, h, hand, which in zip(
                self.bladings,
                pitch_rad,
                speed_rad_s,
                self.disc_heights_m,
                self.rotation_signs,
                self.rotor_indices,
                strict=True,
            )
        )


PerRotor = float | None | Sequence[float | None]


@dataclass(frozen=True)
class OperatingCondition:
    """An operating point: what is given; what is None is found.

    Attributes
    ----------
    pitch_rad, speed_rad_s : float or None, or a sequence with one for each rotor
        Pitch settings, added to the twist (rad), and speeds (rad/s).
    thrust_N : float, optional
        Of all rotors together.
    climb_m_s : float
        Axial speed through the air, positive in climb; 0 is hover.
    air : Air
    """

    pitch_rad: PerRotor
    speed_rad_s: PerRotor = None
    thrust_N: float | None = None
    climb_m_s: float = 0.0
    air: Air = field(default_factory=Air)


@result(eq=False, picture="mufly.rotor.rotor_pictures:stations_picture")
class RotorResult:
    """One operating point.

    Attributes
    ----------
    pitch_rad, speed_rad_s, climb_m_s : float
        The point.
    thrust_N, torque_Nm, power_W, c_T, c_Q : float
        Of the whole rotor.
    figure_of_merit : float
        Of the whole rotor; nan unless thrust and power are positive.
    r_m, dr_m, chord_m, theta_rad : (stations,) arrays
        Blade.
    alpha_rad : (stations,) array
        Angle of attack of the section.
    phi_rad : (stations,) array
        Inflow angle.
    inflow_m_s, swirl_m_s : (stations,) arrays
        Axial and tangential induced velocity.
    cl, cd, reynolds : (stations,) arrays
        Section coefficients, and the Reynolds number that they hold for.
    loss : (stations,) array
        Loss factor F.
    dT_N, dQ_Nm : (stations,) arrays
        Thrust and torque of the annulus (all blades).
    outside : (stations,) array of uint8
        0 where the polar answers from what its engine computed; bits ``OUTSIDE_ALPHA``, ``OUTSIDE_REYNOLDS``
        elsewhere.
    outside_share : float
        Part of the thrust, by size, that such stations carry.
    calibrated : bool
        True if the section coefficients were scaled to a measurement.
    """

    pitch_rad: float
    speed_rad_s: float
    climb_m_s: float
    thrust_N: float
    torque_Nm: float
    power_W: float
    figure_of_merit: float
    c_T: float
    c_Q: float
    r_m: Array
    dr_m: Array
    chord_m: Array
    theta_rad: Array
    alpha_rad: Array
    phi_rad: Array
    inflow_m_s: Array
    swirl_m_s: Array
    cl: Array
    cd: Array
    reynolds: Array
    loss: Array
    dT_N: Array
    dQ_Nm: Array
    outside: NDArray[np.uint8]
    outside_share: float
    calibrated: bool

    def as_record(self) -> dict[str, Any]:
        """Return its numbers, and what it has at each station as a table ``stations``."""
        stations = {k: v for k, v in vars(self).items() if getattr(v, "ndim", 0) == 1}
        return {**{k: v for k, v in vars(self).items() if k not in stations}, "stations": stations}


@dataclass(frozen=True)
class WakeSettings:
    """How a wake is solved; docs/log/2026-11-28-wake-convergence.md shows the effect of each number.

    Attributes
    ----------
    model : 'free' or 'prescribed'
        Free: the vortices go where the air takes them. Prescribed: Landgrebe's measured shape.
    step_deg : float
        Azimuth between the points of a filament that are moved.
    chord_deg : float
        Azimuth of the straight pieces that induce velocities, on the arcs between those points.
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
        Relative azimuths over which two rotors' influence on each other is averaged; one that does not go into the
        points of a turn, or all points of a wake keep meeting the other in the same places.
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
    ground_m : float, optional
        How far below height 0, a single rotor's disc, level ground lies. Vortices are mirrored in it.
    """

    model: Literal["free", "prescribed"] = "free"
    step_deg: float = 30.0
    chord_deg: float = 5.0
    turns: float = 4.0
    far_turns: float = 10.0
    far_step_deg: float = 30.0
    core: float = 0.1
    core_limit: float | None = None
    phases: int = 7
    relaxation: float = 0.35
    tolerance: float = 1e-3
    residual: float = 0.05
    iterations: int = 150
    inviscid: bool = False
    gpu: bool = False
    ground_m: float | None = None

    def __post_init__(self) -> None:
        if self.ground_m is not None and not self.ground_m > 0.0:
            raise InputError("wake", "ground_m", f"is {self.ground_m:g} m", "give a height above 0")
        if self.model not in ("free", "prescribed"):
            raise InputError("wake", "model", f"{self.model!r} is unknown", "use 'free' or 'prescribed'")
        coarse = "too coarse a wake; "
        for key, low, high, remedy in (
            ("step_deg", 1.0, 30.0, coarse + "give 1 to 30 degrees"),
            ("chord_deg", 1.0, 30.0, coarse + "give 1 to 30 degrees"),
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
class LiftingSurface:
    """One blade of a rotor at a pitch setting, in its own frame.

    Attributes
    ----------
    blade_count : int
    radius_m, speed_rad_s : float
    chord_m, pitch_rad : (n,) arrays
        Chord and angle of the chord to the disc, panels from root to tip.
    panel_width_m : (n,) array
        Width of the panels.
    quarter_chord_m, control_points_m : (n, 3) arrays
        Panel middles at one and three quarters of the chord.
    normal, tangent : (n, 3) arrays
        Directions normal to the chord (up) and along it (towards the tail).
    edge_quarter_chord_m, trailing_edge_m : (n + 1, 3) arrays
        Panel edges on the quarter chord line and at the trailing edge.
    edge_chord_m, filament_spacing_m : (n + 1,) arrays
        Chord, and distance of the trailing vortices, at the edges.
    """

    blade_count: int
    radius_m: float
    speed_rad_s: float
    chord_m: Array
    pitch_rad: Array
    panel_width_m: Array
    quarter_chord_m: Array
    control_points_m: Array
    normal: Array
    tangent: Array
    edge_quarter_chord_m: Array
    trailing_edge_m: Array
    edge_chord_m: Array
    filament_spacing_m: Array


@dataclass(frozen=True, eq=False)
class RotorWake:
    """The vortices of one rotor, blade 1 on the x axis.

    Attributes
    ----------
    filament_paths_m : (n + 1, points, 3) array
        Filaments from the quarter chord line down, in space (z up, the mirror image undone), blade 1 at azimuth 0.
    filament_ages_rad : (points,) array
    filament_circulation_m2_s : (n + 1,) array
        Circulation of the trailing filaments, along the path, in the rotor's own (unmirrored) frame.
    core_radius_m : (n + 1, points - 1) array
    bound_circulation_m2_s : (n,) array
        Of the panels.
    free_point_count : int
        Points of a filament that were moved, from the trailing edge on.
    chords_per_step : int
        Pieces of ``filament_paths_m`` from one of them to the next.
    """

    placed: PlacedRotor
    surface: LiftingSurface
    filament_paths_m: Array
    filament_ages_rad: Array
    filament_circulation_m2_s: Array
    core_radius_m: Array
    bound_circulation_m2_s: Array
    free_point_count: int
    chords_per_step: int = 1


@result(eq=False, picture="mufly.rotor.rotor_pictures:result_picture")
class SystemSolution:
    """A system at one operating point.

    Attributes
    ----------
    rotors : tuple of RotorResult
        Each rotor in the presence of the others, the uppermost first.
    placed : tuple of Placed
        Their blades, places, pitches and speeds.
    climb_m_s : float
    air : Air
    method : 'bemt', 'tubes' or 'wake'
    converged : bool
    message : str
        How it converged, or why not.
    iterations : int
        How often the rotors were solved in turn; iterations of the wake.
    streams : tuple of arrays
        What blade elements settled at, to start from again. Method bemt: axial velocity (m/s) that each rotor but the
        last gets from those below it, (stations,) each. Tubes: that at both discs, then p of the cells of both wakes.
    wakes : tuple of Wake
        Of each rotor, if that was the method, as what follows.
    settings : WakeSettings or None
        As used: with the core limit that the wakes settled with.
    residual : float
        Mismatch of the wakes' shape and the velocity of the air, over the velocity (root mean squares).
    history : (iterations, 1 + 2 rotors) array
        Residual, then thrust (N) and torque (N m) of each rotor; empty by blade elements.
    """

    rotors: tuple[RotorResult, ...]
    placed: tuple[PlacedRotor, ...]
    climb_m_s: float
    air: Air
    method: SolverMethod = "bemt"
    converged: bool = True
    message: str = ""
    iterations: int = 1
    streams: tuple[Array, ...] = ()
    wakes: tuple[RotorWake, ...] = ()
    settings: WakeSettings | None = None
    residual: float = math.nan
    history: Array = field(default_factory=lambda: np.empty((0, 0)))

    def __str__(self) -> str:
        lines = [
            f"{self.method} {self.message}",
            "rotor pitch_deg speed_rpm thrust_N torque_Nm power_W merit",
        ]
        for k, r in enumerate(self.rotors):
            lines.append(
                f"{k + 1:5d} {math.degrees(r.pitch_rad):9.2f} {r.speed_rad_s / RPM:9.0f} {r.thrust_N:8.4f} "
                f"{r.torque_Nm:9.6f} {r.power_W:7.3f} {r.figure_of_merit:5.3f}"
            )
        lines.append(
            f"  all {self.thrust_N:28.4f} {self.yaw_torque_Nm:9.6f} {self.power_W:7.3f} {self.figure_of_merit:5.3f}"
        )
        return "\n".join(lines)

    @property
    def upper(self) -> RotorResult:
        """The uppermost rotor."""
        return self.rotors[0]

    @property
    def lower(self) -> RotorResult:
        """The lowest rotor."""
        return self.rotors[-1]

    @property
    def lower_over_upper(self) -> dict[str, float]:
        """Speed, thrust, torque and power of the lowest rotor over those of the uppermost."""
        names = ("speed_rad_s", "thrust_N", "torque_Nm", "power_W")
        return {name.partition("_")[0]: getattr(self.lower, name) / getattr(self.upper, name) for name in names}

    def interference_losses(self, isolated: Sequence[RotorResult]) -> dict[str, float]:
        """Return what a pair changes of its rotors alone at the same pitch and speed: ratios less one.

        Keys are ``upper_thrust``, ``upper_torque``, those of the lower rotor, and ``thrust``, ``power`` and
        ``thrust_per_power`` of the pair.
        """
        thrust, power = sum(r.thrust_N for r in isolated), sum(r.power_W for r in isolated)
        losses = {}
        for side, r, alone in zip(("upper", "lower"), (self.upper, self.lower), isolated, strict=True):
            losses[f"{side}_thrust"] = r.thrust_N / alone.thrust_N - 1.0
            losses[f"{side}_torque"] = r.torque_Nm / alone.torque_Nm - 1.0
        losses |= {"thrust": self.thrust_N / thrust - 1.0, "power": self.power_W / power - 1.0}
        losses["thrust_per_power"] = (self.thrust_N / self.power_W) / (thrust / power) - 1.0
        return losses

    @property
    def spacing_m(self) -> float:
        """Distance between the uppermost and the lowest disc."""
        return self.placed[0].height_m - self.placed[-1].height_m

    @property
    def thrust_N(self) -> float:
        """Thrust of all rotors."""
        return sum(r.thrust_N for r in self.rotors)

    @property
    def power_W(self) -> float:
        """Mechanical power of all rotors."""
        return sum(r.power_W for r in self.rotors)

    @property
    def yaw_torque_Nm(self) -> float:
        """What the rotors turn their vehicle with: torque of the lower less that of the upper rotor; 0 in trim."""
        return sum(-p.rotation_sign * r.torque_Nm for p, r in zip(self.placed, self.rotors, strict=True))

    @property
    def figure_of_merit(self) -> float:
        """T sqrt(T / (2 rho A)) / P with one disc, the largest; nan unless thrust and power are positive."""
        thrust, power = self.thrust_N, self.power_W
        if not (thrust > 0.0 and power > 0.0):
            return math.nan
        area = math.pi * max(p.blading.rotors[p.rotor_index].radius_m for p in self.placed) ** 2
        return thrust * math.sqrt(thrust / (2.0 * self.air.density_kg_m3 * area)) / power


def check_rotors(rotors: Sequence[PlacedRotor], climb: float) -> None:
    """Raise :class:`InputError` with one line if the rotors cannot be solved together."""
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
                "let them turn against each other; a co-rotating pair has a wake that is not steady in any mean",
            )  # fmt: skip
        gap = abs(a.height_m - b.height_m)
        if not gap > 0.0:
            raise InputError("wake", "spacing", "is zero", "give a distance above 0")
        reach = sum(_blade_vertical_reach(p) for p in rotors)
        if gap <= reach:
            raise InputError(
                "wake", "spacing", f"{1e3 * gap:.3g} mm lets the blades overlap",
                f"give more than {1e3 * reach:.3g} mm, what the pitched blades take up",
            )  # fmt: skip


def _blade_vertical_reach(placed: PlacedRotor) -> float:
    """How far a blade reaches above or below its disc: the greater part of its chord, pitched."""
    b, k = placed.blading, placed.rotor_index
    return float(np.max(0.75 * b.chord_m[k] * np.abs(np.sin(b.twist_rad[k] + placed.pitch_rad))))
