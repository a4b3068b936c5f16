"""Data types of rotor systems: rotors on one shaft, operating condition, wakes and solution.

A :class:`RotorSystem` holds rotors, positions and senses of rotation, an :class:`OperatingCondition` the given values
of the operating point. :func:`mufly.rotor.solve_system` returns a :class:`SystemSolution` for every method.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.quantities.units import RPM
from mufly.results import (
    ResultColumn,
    ShownBlock,
    columns_to_rows,
    make_lines_block,
    result,
    tabulate_fields,
    tabulate_results,
)
from mufly.rotor.blading import Blading, ensure_blading
from mufly.rotor.geometry import Rotor, blade_thickness_m

Array = NDArray[np.float64]
SolverMethod = Literal["bemt", "tubes", "wake"]


SPEED_OF_SOUND_M_S = 343.2
"""Speed of sound in dry air at 20 C (ISO 2533)."""


_VALID_AIR_RANGES = {"density_kg_m3": (1e-3, 20.0), "viscosity_Pa_s": (0.0, 1e-4), "sound_m_s": (100.0, math.inf)}
"""Ranges of gases in which rotors run, tunnels under pressure or vacuum included; water and g/m3 lie outside. A great
speed of sound stands for incompressible flow, a small viscosity for none."""


@dataclass(frozen=True)
class Air:
    """Properties of the air: density (kg/m^3), dynamic viscosity (Pa s), speed of sound (m/s).

    Default: 1.2 kg/m3, as in the dissertation, at 20 C.
    """

    density_kg_m3: float = 1.2
    viscosity_Pa_s: float = 1.81e-5
    sound_m_s: float = SPEED_OF_SOUND_M_S

    def __post_init__(self) -> None:
        for key, (low, high) in _VALID_AIR_RANGES.items():
            if not 0.0 < getattr(self, key) < math.inf:
                raise InputError("air", key, f"is {getattr(self, key):g}", "give a number above 0")
            if not low <= getattr(self, key) <= high:
                raise InputError(
                    "air",
                    key,
                    f"is {getattr(self, key):g}, which is impossible for air",
                    f"give {low:g} to {high:g}, in SI units",
                )


def tabulate_blade_stations(rotor: Rotor, speed_rad_s: float) -> dict[str, Array]:
    """Return spanwise data of a blade at the stations of its file, at the cut-out, and at each quarter of the radius.

    Parameters
    ----------
    rotor : Rotor
    speed_rad_s : float
        Rotor speed (rad/s) for the chord Reynolds numbers in still air.

    Returns
    -------
    dict of str to (stations,) array
        ``r_over_R``, ``chord_m``, ``twist_rad``, ``thickness_m`` and ``reynolds``.
    """
    air, cutout = Air(), float(rotor.hub_cutout)
    x = np.unique(np.concatenate(([cutout], rotor.blade.r_over_R.to_si_array(), [0.25, 0.5, 0.75, 1.0])))
    x = x[x >= cutout]
    chord = rotor.chord_m(x)
    return {
        "r_over_R": x, "chord_m": chord, "twist_rad": rotor.twist_rad(x), "thickness_m": blade_thickness_m(rotor, x),
        "reynolds": x * rotor.radius_m * speed_rad_s * chord * air.density_kg_m3 / air.viscosity_Pa_s,
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class PlacedRotor:
    """Rotor with pitch (rad), speed (rad/s), height of the disc along the shaft (m) and sense of rotation (+1 or
    -1)."""

    blading: Blading
    pitch_rad: float
    speed_rad_s: float
    height_m: float = 0.0
    rotation_sign: int = 1
    index_in_blading: int = 0


@dataclass(frozen=True, eq=False)
class RotorSystem:
    """Rotors on one shaft, the uppermost first; created by :meth:`from_single_rotor` or :meth:`from_coaxial_pair`.

    Attributes
    ----------
    bladings : tuple of Blading
    disc_heights_m : tuple of float
        Height of each disc along the shaft (m).
    rotation_signs : tuple of int
        Sense of rotation: 1 or -1.
    indices_in_blading : tuple of int
        Index of each rotor in its blading.
    """

    bladings: tuple[Blading, ...]
    disc_heights_m: tuple[float, ...]
    rotation_signs: tuple[int, ...]
    indices_in_blading: tuple[int, ...]

    def __post_init__(self) -> None:
        if not self.bladings or any(b >= a for a, b in zip(self.disc_heights_m, self.disc_heights_m[1:], strict=False)):
            raise InputError(
                "rotor", "height_m", "does not decrease from rotor to rotor", "give the uppermost rotor first"
            )

    @classmethod
    def from_single_rotor(cls, blading: Blading | Rotor, *, which: int = 0) -> RotorSystem:
        """Return a system of one rotor; a :class:`Rotor` is prepared with all defaults."""
        return cls((ensure_blading(blading),), (0.0,), (1,), (which,))

    @classmethod
    def from_coaxial_pair(cls, upper: Blading | Rotor, lower: Blading | Rotor, *, spacing_m: float) -> RotorSystem:
        """Return a pair of counter-rotating rotors on one shaft; of a blading with several rotors, the first is used.

        A :class:`Rotor` is prepared with all defaults.

        Raises
        ------
        InputError
            If the distance between the discs is not positive.
        """
        if not 0.0 < spacing_m < math.inf:
            raise InputError("coaxial", "spacing_m", f"is {spacing_m:g}", "give a distance above 0")
        above = ensure_blading(upper)
        below = above if lower is upper else ensure_blading(lower)
        return cls((above, below), (0.0, -spacing_m), (1, -1), (0, 0))

    def place_rotors(self, pitch_rad: Sequence[float], speed_rad_s: Sequence[float]) -> tuple[PlacedRotor, ...]:
        """Return the rotors of the system, each with its pitch, its speed and its place on the shaft."""
        return tuple(
            PlacedRotor(b, p, s, h, hand, which)
            for b, p, s, h, hand, which in zip(
                self.bladings,
                pitch_rad,
                speed_rad_s,
                self.disc_heights_m,
                self.rotation_signs,
                self.indices_in_blading,
                strict=True,
            )
        )


PerRotor = float | None | Sequence[float | None]


@dataclass(frozen=True)
class OperatingCondition:
    """Given values of an operating point; values that are None are unknowns.

    Attributes
    ----------
    pitch_rad, speed_rad_s : float or None, or a sequence with one for each rotor
        Pitch settings, added to the twist (rad), and speeds (rad/s).
    thrust_N : float, optional
        Thrust of all rotors together (N).
    climb_m_s : float
        Axial speed through the air (m/s), positive in climb; 0 is hover.
    air : Air
    """

    pitch_rad: PerRotor
    speed_rad_s: PerRotor = None
    thrust_N: float | None = None
    climb_m_s: float = 0.0
    air: Air = field(default_factory=Air)


_STATION_COLUMNS = (
    ResultColumn("r_over_R", head="r/R"),
    ResultColumn("alpha_rad", "deg", ".2f"),
    ResultColumn("axial_induced_m_s", form=".3g", head="inflow"),
    ResultColumn("cl", form=".3f"),
    ResultColumn("cd", form=".4f"),
    ResultColumn("reynolds", form=".0f", head="Reynolds number"),
    ResultColumn("loss", form=".3f", head="loss F"),
    ResultColumn("thrust_N_m", form=".3g", head="dT/dr", own_unit="N/m"),
)


@result(eq=False)
class RotorResult:
    """Loads of a rotor at an operating point, in total and along the blade.

    Attributes
    ----------
    pitch_rad, speed_rad_s, climb_m_s : float
        Operating point.
    thrust_N, torque_Nm, power_W, c_T, c_Q : float
        Loads and coefficients of the whole rotor.
    figure_of_merit : float
        Figure of merit of the rotor; nan unless thrust and power are positive.
    r_m, dr_m, chord_m, theta_rad : (stations,) arrays
        Radius, width and chord of each station (m), pitch (rad).
    alpha_rad : (stations,) array
        Angle of attack of the section (rad).
    phi_rad : (stations,) array
        Inflow angle (rad).
    axial_induced_m_s, swirl_m_s : (stations,) arrays
        Axial and tangential induced velocity (m/s).
    cl, cd, reynolds : (stations,) arrays
        Section coefficients, and their Reynolds number.
    loss : (stations,) array
        Loss factor F.
    dT_N, dQ_Nm : (stations,) arrays
        Thrust (N) and torque (N m) of the annulus, all blades.
    outside : (stations,) array of uint8
        0 inside the computed range of the polar; bits ``OUTSIDE_ALPHA_BIT``, ``OUTSIDE_REYNOLDS_BIT`` elsewhere.
    outside_share : float
        Fraction of the absolute thrust at stations outside that range.
    calibrated : bool
        True if the section coefficients were calibrated on a measurement.
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
    axial_induced_m_s: Array
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
        """Return the result's scalars by name and, under the key ``stations``, a dictionary of its spanwise arrays."""
        stations = {k: v for k, v in vars(self).items() if getattr(v, "ndim", 0) == 1}
        return {**{k: v for k, v in vars(self).items() if k not in stations}, "stations": stations}

    def load_blocks(self, radius_m: float) -> tuple[ShownBlock, ...]:
        """Return the loads of a rotor of this radius, some twelve stations of its blade, and the use of polars beyond
        their range, as printed text.
        """
        hover = [ResultColumn("figure_of_merit", form=".3f")] if self.climb_m_s == 0.0 else []
        loads: list[ResultColumn | tuple[str, str]] = [
            ResultColumn("thrust_N"), ResultColumn("torque_Nm"), ResultColumn("power_W", head="power at the rotor"),
            *hover, ("c_T, c_Q", f"{self.c_T:.5f}, {self.c_Q:.6f}"),
        ]  # fmt: skip
        if self.climb_m_s > 0.0:
            advance = self.climb_m_s * math.pi / (self.speed_rad_s * radius_m)
            loads.append(("advance ratio V/(n D)", f"{advance:.4f}"))
            if self.thrust_N > 0.0 and self.power_W > 0.0:
                loads.append(("efficiency T V/P", f"{self.climb_m_s * self.thrust_N / self.power_W:.1%}"))
        marks = [" *" if outside else "" for outside in self.outside]
        names = "alpha_rad axial_induced_m_s cl cd reynolds loss"
        table = {
            "r_over_R": [f"{r / radius_m:.3f}{mark}" for r, mark in zip(self.r_m, marks, strict=True)],
            **{name: getattr(self, name) for name in names.split()}, "thrust_N_m": self.dT_N / self.dr_m,
        }  # fmt: skip
        rows = columns_to_rows(table)[:: max(1, self.r_m.size // 12)]
        star = f"* outside the range of the polar; such sections carry {self.outside_share:.0%} of the thrust."
        return (
            tabulate_fields(self, loads),
            tabulate_results(rows, _STATION_COLUMNS),
            *((make_lines_block(star, style="yellow"),) if self.outside_share > 0 else ()),
        )


@dataclass(frozen=True)
class WakeSettings:
    """Settings of the wake solver; docs/log/2026-11-28-wake-convergence.md shows the effect of each number.

    Attributes
    ----------
    model : 'free' or 'prescribed'
        Free: vortices move with the air. Prescribed: Landgrebe's measured shape.
    step_deg : float
        Azimuth between the moving points of a filament (degrees).
    chord_deg : float
        Azimuth of the straight vortex segments on the arcs between those points (degrees).
    turns, far_turns : float
        Turns of the free wake, and of the helices of the far wake below it.
    far_step_deg : float
        Azimuth between the points of the far wake (degrees).
    core : float
        Initial core radius over the local chord.
    core_limit : float, optional
        Core radius of an old wake over R. Default: 0.15 for one rotor and 0.2 for two. If the wake does not converge,
        two larger limits are tried; settings and message of the solution report the limit used.
    phases : int
        Number of relative azimuths over which the mutual influence of two rotors is averaged. It should not divide the
        number of points per turn, or every point of a wake meets the other wake at the same places.
    relaxation : float
        Fraction of the step of the points in one iteration. It decreases with age by 1 / (1 + zeta / (4 pi)), because
        errors accumulate downstream.
    tolerance : float
        Greatest deviation of thrust and torque from their mean over the last ten iterations, relative, at convergence.
    residual : float
        Greatest mismatch of wake shape and air velocity at convergence, relative to the velocity.
    iterations : int
        Greatest number of iterations with each core limit.
    inviscid : bool
        No boundary layer: c_l = 2 pi sin(alpha), no drag.
    gpu : bool
        Sum the velocities of the wake on a CUDA device.
    ground_m : float, optional
        Distance of level ground below height 0, which is the disc of a single rotor (m). Vortices are mirrored in it.
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
    """Lifting surface of one blade of a rotor at a pitch setting, in the blade's frame.

    Attributes
    ----------
    blade_count : int
    radius_m, speed_rad_s : float
    chord_m, pitch_rad : (n,) arrays
        Chord (m) and angle of the chord to the disc (rad), panels from root to tip.
    panel_width_m : (n,) array
        Width of the panels (m).
    quarter_chord_m, control_points_m : (n, 3) arrays
        Panel middles at one and three quarters of the chord.
    normal, tangent : (n, 3) arrays
        Unit vectors normal to the chord (up) and along it (towards the trailing edge).
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
    """Vortices of one rotor, with blade 1 on the x axis.

    Attributes
    ----------
    filament_paths_m : (n + 1, points, 3) array
        Filaments from the quarter chord line down, in space (z up, not mirrored), blade 1 at azimuth 0.
    filament_ages_rad : (points,) array
    filament_circulation_m2_s : (n + 1,) array
        Circulation of the trailing filaments, along the path, in the rotor's own (unmirrored) frame.
    core_radius_m : (n + 1, points - 1) array
    bound_circulation_m2_s : (n,) array
        Bound circulation of the panels.
    free_point_count : int
        Number of free points of a filament, counted from the trailing edge.
    segments_per_free_step : int
        Number of segments of ``filament_paths_m`` between free points.
    """

    placed: PlacedRotor
    surface: LiftingSurface
    filament_paths_m: Array
    filament_ages_rad: Array
    filament_circulation_m2_s: Array
    core_radius_m: Array
    bound_circulation_m2_s: Array
    free_point_count: int
    segments_per_free_step: int = 1


@result(eq=False)
class SystemSolution:
    """Solution of a rotor system at an operating point.

    Attributes
    ----------
    rotors : tuple of RotorResult
        Loads of each rotor in the presence of the others, the uppermost first.
    placed : tuple of PlacedRotor
        Blades, positions, pitches and speeds of the rotors.
    climb_m_s : float
    air : Air
    method : 'bemt', 'tubes' or 'wake'
    converged : bool
    message : str
        Description of the convergence, or of its failure.
    iterations : int
        Number of iterations of the coupling or of the wake.
    coupling_variables : tuple of arrays
        Converged coupling variables, for a restart. Method bemt: axial velocity (m/s) induced at each rotor but the
        last by the rotors below it, (stations,) each. Tubes: axial velocity at both discs, then p of the cells of both
        wakes.
    wakes : tuple of RotorWake
        Wake of each rotor; this and the following fields are set by the wake method only.
    settings : WakeSettings or None
        Settings with the core limit used.
    residual : float
        Mismatch of wake shape and velocity of the air, over the velocity (root mean squares).
    history : (iterations, 1 + 2 rotors) array
        Residual, then thrust (N) and torque (N m) of each rotor; empty for blade elements.
    """

    rotors: tuple[RotorResult, ...]
    placed: tuple[PlacedRotor, ...]
    climb_m_s: float
    air: Air
    method: SolverMethod = "bemt"
    converged: bool = True
    message: str = ""
    iterations: int = 1
    coupling_variables: tuple[Array, ...] = ()
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
        """Loads of the uppermost rotor."""
        return self.rotors[0]

    @property
    def lower(self) -> RotorResult:
        """Loads of the lowest rotor."""
        return self.rotors[-1]

    @property
    def lower_over_upper(self) -> dict[str, float]:
        """Ratios lower over upper of speed, thrust, torque and power."""
        names = ("speed_rad_s", "thrust_N", "torque_Nm", "power_W")
        both = {name: (getattr(self.lower, name), getattr(self.upper, name)) for name in names}
        return {name.partition("_")[0]: low / up if up else math.nan for name, (low, up) in both.items()}

    def compute_interference_changes(self, isolated: Sequence[RotorResult]) -> dict[str, float]:
        """Return the relative changes of the loads of a pair against its isolated rotors at the same pitch and speed.

        Keys are ``upper_thrust``, ``upper_torque``, those of the lower rotor, and ``thrust``, ``power`` and
        ``thrust_per_power`` of the pair; nan where the isolated rotors have none, as a symmetric blade at pitch 0.
        """

        def relative_change(value: float, reference: float) -> float:
            return value / reference - 1.0 if reference else math.nan

        thrust, power = sum(r.thrust_N for r in isolated), sum(r.power_W for r in isolated)
        losses = {}
        for side, r, alone in zip(("upper", "lower"), (self.upper, self.lower), isolated, strict=True):
            losses[f"{side}_thrust"] = relative_change(r.thrust_N, alone.thrust_N)
            losses[f"{side}_torque"] = relative_change(r.torque_Nm, alone.torque_Nm)
        losses |= {"thrust": relative_change(self.thrust_N, thrust), "power": relative_change(self.power_W, power)}
        losses["thrust_per_power"] = relative_change(self.thrust_N / self.power_W, thrust / power)
        return losses

    @property
    def spacing_m(self) -> float:
        """Distance between the uppermost and the lowest disc (m)."""
        return self.placed[0].height_m - self.placed[-1].height_m

    @property
    def thrust_N(self) -> float:
        """Thrust of all rotors (N)."""
        return sum(r.thrust_N for r in self.rotors)

    @property
    def power_W(self) -> float:
        """Mechanical power of all rotors (W)."""
        return sum(r.power_W for r in self.rotors)

    @property
    def yaw_torque_Nm(self) -> float:
        """Yaw torque on the vehicle (N m): torque of the lower less that of the upper rotor; 0 in trim."""
        return sum(-p.rotation_sign * r.torque_Nm for p, r in zip(self.placed, self.rotors, strict=True))

    @property
    def figure_of_merit(self) -> float:
        """Figure of merit T sqrt(T / (2 rho A)) / P with A the largest disc; nan unless thrust and power are
        positive."""
        thrust, power = self.thrust_N, self.power_W
        if not (thrust > 0.0 and power > 0.0):
            return math.nan
        area = math.pi * max(p.blading.rotors[p.index_in_blading].radius_m for p in self.placed) ** 2
        return thrust * math.sqrt(thrust / (2.0 * self.air.density_kg_m3 * area)) / power
