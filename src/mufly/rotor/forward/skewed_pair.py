"""Coaxial pair in forward flight: the lower rotor in the skewed stream of the upper one.

The coupling is that of :mod:`mufly.rotor.rotor_solver`, with the stream shifted. h is the distance of the discs, k the
factor of a vortex tube on its axis. The lower rotor meets k(h) times the velocity induced by the upper rotor. The
stream is contracted by 1 / sqrt(k(h)), and its axis is displaced downwind by

    h tan chi,    tan chi = V / (V_z + mean velocity through the upper disc)

Swirl turns about the displaced axis; only its component against the motion of the blades is used. Outside the stream
the air is that of the flight. The upper rotor meets k(-h) times the velocity induced by the lower one, not displaced,
because it lies upstream. At V = 0 the pair is that of coaxial blade element momentum theory. The delay from disc to
disc, about 10 ms, is left out.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError, MuflyError
from mufly.results import ResultColumn, ShownBlock, make_lines_block, result, tabulate_results
from mufly.rotor.bemt import compute_drag_swirl_momentum
from mufly.rotor.blading import Blading, ensure_blading
from mufly.rotor.forward.azimuth_kernel import UNKNOWN_INFLOW_COS, UNKNOWN_INFLOW_SIN
from mufly.rotor.forward.forward_results import ForwardCondition, ForwardResult, RigidFlapMode
from mufly.rotor.forward.forward_solver import AZIMUTH_COUNT, make_azimuth_grid, solve_forward
from mufly.rotor.geometry import Rotor
from mufly.rotor.vortex_tube import (
    compute_tube_axis_velocity_ratio,
    make_stream_interpolation,
    make_swirl_influence_matrix,
)

Array = NDArray[np.float64]

_MAX_COUPLING_ITERATIONS = 60
_COUPLING_TOLERANCE = 1e-7  # of the greatest induced velocity
_MAX_STREAM_SHIFT_RADII = 20.0  # of the radius; beyond, nothing of the stream meets the lower disc

PAIR_COLUMNS = (
    ResultColumn("upper.flap_frequency_ratio", form=".3g", head="nu"),
    ResultColumn("upper.edgewise_m_s", form=".3g", head="V", own_unit="m/s"),
    ResultColumn("stream_share_on_lower_disc", form=".2f", head="overlap"),
    ResultColumn("upper.thrust_N", "N", ".4g", head="T upper"),
    ResultColumn("lower.thrust_N", "N", ".4g", head="T lower"),
    ResultColumn("power_W", "W", ".4g", head="power"),
    ResultColumn("h_force_N", "mN", "z.1f", head="H"),
    ResultColumn("y_force_N", "mN", "z.1f", head="Y"),
    ResultColumn("roll_moment_Nm", "mN m", "z.2f", head="roll"),
    ResultColumn("pitch_moment_Nm", "mN m", "z.2f", head="pitch"),
    ResultColumn("yaw_torque_Nm", "mN m", "z.2f", head="yaw"),
)


@result(
    eq=False,
    json="upper lower spacing_m shift_m stream_share_on_lower_disc thrust_N power_W h_force_N y_force_N "
    "roll_moment_Nm pitch_moment_Nm yaw_torque_Nm",
)
class ForwardPair:
    """Loads of a coaxial pair in forward flight: sums of both rotors' forces and of their moments about their own hubs.

    Attributes
    ----------
    upper, lower : ForwardResult
        Loads of the rotors.
    spacing_m : float
        Distance of the discs.
    shift_m : float
        Displacement of the upper stream at the lower disc, downwind.
    stream_share_on_lower_disc : float
        Share of the contracted stream that meets the lower disc.
    coupling_iterations : int
        Iterations of the coupling.
    """

    upper: ForwardResult
    lower: ForwardResult
    spacing_m: float
    shift_m: float
    stream_share_on_lower_disc: float
    coupling_iterations: int

    @property
    def thrust_N(self) -> float:
        """Thrust of both rotors (N)."""
        return self.upper.thrust_N + self.lower.thrust_N

    @property
    def power_W(self) -> float:
        """Shaft power of both rotors (W)."""
        return self.upper.power_W + self.lower.power_W

    @property
    def h_force_N(self) -> float:
        """Sum of the in-plane forces of both rotors towards the tail (N)."""
        return self.upper.h_force_N + self.lower.h_force_N

    @property
    def y_force_N(self) -> float:
        """Sum of the in-plane forces of both rotors to the right (N)."""
        return self.upper.y_force_N + self.lower.y_force_N

    @property
    def roll_moment_Nm(self) -> float:
        """Sum of the hub moments, right side down (N m)."""
        return self.upper.roll_moment_Nm + self.lower.roll_moment_Nm

    @property
    def pitch_moment_Nm(self) -> float:
        """Sum of the hub moments, nose up (N m)."""
        return self.upper.pitch_moment_Nm + self.lower.pitch_moment_Nm

    @property
    def yaw_torque_Nm(self) -> float:
        """Torque of the lower rotor less that of the upper (N m)."""
        return self.lower.torque_Nm - self.upper.torque_Nm

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return loads and moments of the pair as printed text."""
        return format_forward_pairs((self,))


def format_forward_pairs(pairs: tuple[ForwardPair, ...]) -> tuple[ShownBlock, ...]:
    """Return results of pairs as text: a table, and why points lie outside the range of the method."""
    blocks: list[ShownBlock] = [tabulate_results(pairs, PAIR_COLUMNS)]
    notes: dict[str, list[str]] = {}
    for pair in pairs:
        for side in ("upper", "lower"):
            rotor = getattr(pair, side)
            for note in rotor.notes:
                notes.setdefault(f"{side} rotor: {note}", []).append(f"{rotor.edgewise_m_s:g}")
    for note, at in notes.items():
        blocks.append(make_lines_block(f"{', '.join(dict.fromkeys(at))} m/s: {note}", mark="Outside", style="yellow"))
    return tuple(blocks)


def _disc_overlap(shift_m: float, inner_m: float, outer_m: float) -> float:
    """Return the share of a circle of radius ``inner_m`` inside one of ``outer_m`` whose centre is ``shift_m`` away."""
    d, a, b = shift_m, inner_m, outer_m
    if d >= a + b:
        return 0.0
    if d <= abs(b - a):
        return min(1.0, (b / a) ** 2)
    one = a * a * math.acos((d * d + a * a - b * b) / (2.0 * d * a))
    two = b * b * math.acos((d * d + b * b - a * a) / (2.0 * d * b))
    kite = 0.5 * math.sqrt((-d + a + b) * (d + a - b) * (d - a + b) * (d + a + b))
    return (one + two - kite) / (math.pi * a * a)


def _shifted_stream(
    upper: ForwardResult, upper_dr: Array, met: Array, shift_m: float, spacing_m: float, radius_m: float,
    lower_r: Array, lower_dr: Array, psi: Array, density: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the upper rotor's axial stream and swirl at the stations of the lower rotor, (azimuths, stations)."""
    along = lower_r * np.cos(psi)[:, None] - shift_m
    across = lower_r * np.sin(psi)[:, None]
    r = np.hypot(along, across)
    width = np.broadcast_to(lower_dr, r.shape).ravel()
    k = compute_tube_axis_velocity_ratio(spacing_m, radius_m)
    state, own_r = upper.state, upper.disc.r_m
    read = make_stream_interpolation(own_r, radius_m, 1.0 / math.sqrt(k), r.ravel(), width)
    mean = (read @ state.axial_induced_m_s).reshape(r.shape)
    # First harmonics of the upper inflow about the displaced axis; the rotors turn against each other.
    lc, ls = state.unknowns[[UNKNOWN_INFLOW_COS, UNKNOWN_INFLOW_SIN]]
    gradient = (read @ (upper.speed_rad_s * own_r)).reshape(r.shape)
    safe = np.maximum(r, 1e-9 * radius_m)
    axial = k * (mean + gradient * (lc * along - ls * across) / safe)
    swirl, loss, drag = state.annulus_values.T
    down = upper.climb_m_s + met + loss * state.axial_induced_m_s
    turning = 2.0 * loss * swirl * own_r + compute_drag_swirl_momentum(drag, down, density, own_r, upper_dr)
    around = (make_swirl_influence_matrix(own_r, radius_m, spacing_m, safe.ravel(), width) @ turning).reshape(r.shape)
    facing = (lower_r - shift_m * np.cos(psi)[:, None]) / safe
    return axial, around * facing


def solve_forward_pair(
    upper: Blading | Rotor,
    lower: Blading | Rotor,
    conditions: tuple[ForwardCondition, ForwardCondition],
    flaps: tuple[RigidFlapMode | None, RigidFlapMode | None] = (None, None),
    *,
    spacing_m: float,
    start: ForwardPair | None = None,
    tolerance: float = _COUPLING_TOLERANCE,
) -> ForwardPair:
    """Solve a coaxial pair of counter-rotating rotors in forward flight.

    Parameters
    ----------
    upper, lower : Blading or Rotor
    conditions : (ForwardCondition, ForwardCondition)
        Points of upper and lower rotor, with the same airspeed and rates and opposite senses of rotation.
    flaps : (RigidFlapMode, RigidFlapMode)
        Flap modes; None for blades that do not flap.
    spacing_m : float
        Distance of the discs.
    start : ForwardPair, optional
        Similar point to start from.
    tolerance : float
        Greatest change of the coupling at convergence, over the greatest induced velocity.

    Raises
    ------
    InputError
        If the conditions do not belong together, or a value is impossible.
    MuflyError
        If a rotor or the coupling does not converge.
    """
    above, below = ensure_blading(upper), ensure_blading(lower)
    first, second = conditions
    if not 0.0 < spacing_m < math.inf:
        raise InputError("coax forward", "spacing_m", f"is {spacing_m:g}", "give a distance above 0")
    if first.rotation_sign == second.rotation_sign:
        raise InputError("coax forward", "rotation_sign", "is the same for both rotors", "give 1 and -1")
    for name in ("edgewise_m_s", "climb_m_s", "wind_azimuth_rad", "air"):
        if getattr(first, name) != getattr(second, name):
            raise InputError("coax forward", name, "differs between the rotors", "give both the same")
    radii = float(above.radius_m[0]), float(below.radius_m[0])
    psi = make_azimuth_grid(AZIMUTH_COUNT)[0]
    back = compute_tube_axis_velocity_ratio(-spacing_m, radii[1])
    upward = back * make_stream_interpolation(
        below.r_m[0], radii[1], 1.0 / math.sqrt(back), above.r_m[0], above.dr_m[0]
    )
    met = np.zeros(above.r_m.shape[1])
    one, two = (None, None) if start is None else (start.upper, start.lower)
    if two is not None:
        met = upward @ two.state.axial_induced_m_s
    step, scale = math.inf, 1.0
    last_change, last_image = np.empty(0), np.empty(0)
    for turn in range(1, _MAX_COUPLING_ITERATIONS + 1):
        one = solve_forward(above, first, flaps[0], start=one, stream_m_s=np.tile(met, (AZIMUTH_COUNT, 1)))
        mean = one.state.axial_induced_m_s + met
        through = first.climb_m_s + 2.0 * float(np.sum(mean * above.r_m[0] * above.dr_m[0])) / radii[0] ** 2
        slope = first.edgewise_m_s / max(through, 1e-3 * first.edgewise_m_s + 1e-9)
        shift = min(spacing_m * slope, _MAX_STREAM_SHIFT_RADII * radii[0])
        axial, around = _shifted_stream(
            one, above.dr_m[0], met, shift, spacing_m, radii[0], below.r_m[0], below.dr_m[0], psi,
            first.air.density_kg_m3,
        )  # fmt: skip
        two = solve_forward(below, second, flaps[1], start=two, stream_m_s=axial, swirl_m_s=around)
        image = upward @ two.state.axial_induced_m_s
        step, scale = float(np.max(np.abs(image - met))), float(np.max(np.abs(one.state.axial_induced_m_s))) + 1e-9
        change = image - met
        following = image if turn < 25 else 0.5 * (met + image)
        if last_change.size and turn < 25:  # Anderson acceleration of depth one
            bend = change - last_change
            weight = float(bend @ change) / max(float(bend @ bend), 1e-300)
            if abs(weight) < 5.0:
                following = image - weight * (image - last_image)
        last_change, last_image, met = change, image, following
        if step <= tolerance * scale:
            narrow = radii[0] / math.sqrt(compute_tube_axis_velocity_ratio(spacing_m, radii[0]))
            return ForwardPair(one, two, spacing_m, shift, _disc_overlap(shift, narrow, radii[1]), turn)
    raise MuflyError(
        f"coax forward: the two rotors do not converge at {first.edgewise_m_s:g} m/s edgewise and "
        f"{first.climb_m_s:g} "
        f"m/s climb; the inflow still changes by {step / scale:.1e} of itself a turn"
    )


@result(eq=False)
class PairSweep:
    """Results of a coaxial pair over airspeed, for one or several flap frequencies.

    Attributes
    ----------
    rotors : (str, str)
        Names of upper and lower rotor.
    flap_basis : str
        Origin of the flap frequencies.
    points : tuple of tuples of ForwardPair
        Points by flap frequency and airspeed.
    """

    rotors: tuple[str, str]
    flap_basis: str
    points: tuple[tuple[ForwardPair, ...], ...]

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the results of the pair over airspeed as printed text."""
        head = make_lines_block(
            f", {1e3 * self.points[0][0].spacing_m:g} mm apart; {self.flap_basis}", head=" over ".join(self.rotors)
        )
        return (head, *format_forward_pairs(tuple(p for line in self.points for p in line)))

    def as_record(self) -> dict[str, object]:
        """Return the rotors and a row for each point."""
        return {
            "rotors": self.rotors, "flap_basis": self.flap_basis,
            "points": [p for line in self.points for p in line],
        }  # fmt: skip


def sweep_forward_pair(
    upper: Blading | Rotor,
    lower: Blading | Rotor,
    conditions: tuple[ForwardCondition, ForwardCondition],
    airspeeds: tuple[tuple[float, float], ...],
    flaps: tuple[tuple[RigidFlapMode, RigidFlapMode], ...],
    *,
    spacing_m: float,
    flap_basis: str = "",
) -> PairSweep:
    """Solve a pair at several airspeeds, (edgewise, along the shaft), for several pairs of flap modes."""
    if not airspeeds or not flaps:
        raise InputError("coax forward", "", "has no points", "give at least one airspeed and one flap frequency")
    above, below = ensure_blading(upper), ensure_blading(lower)
    lines = []
    for modes in flaps:
        line: list[ForwardPair] = []
        for edgewise, climb in airspeeds:
            one, two = (replace(c, edgewise_m_s=edgewise, climb_m_s=climb) for c in conditions)
            line.append(
                solve_forward_pair(
                    above, below, (one, two), modes, spacing_m=spacing_m, start=line[-1] if line else None
                )
            )
        lines.append(tuple(line))
    return PairSweep((above.rotors[0].name, below.rotors[0].name), flap_basis, tuple(lines))
