"""Results of a rotor in forward flight, and their text."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.results import ResultColumn, ShownBlock, make_lines_block, result, tabulate_results
from mufly.rotor.rotor_system import Air

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RigidFlapMode:
    """Flap mode of a rigid blade on a hinge, with a given natural frequency.

    Attributes
    ----------
    frequency_ratio : float
        Frequency over rotor speed, nu: 1 for a free hinge at the shaft, infinite for a blade that does not flap.
    inertia_kg_m2 : float
        Moment of inertia of one blade about the shaft.
    """

    frequency_ratio: float
    inertia_kg_m2: float


@dataclass(frozen=True)
class ForwardCondition:
    """Operating point of a rotor in any direction of flight.

    Attributes
    ----------
    pitch_rad : float
        Collective pitch, added to the twist (rad).
    speed_rad_s : float
        Rotor speed (rad/s), above 0.
    edgewise_m_s : float
        Airspeed in the plane of the disc (m/s), 0 or more.
    climb_m_s : float
        Airspeed along the shaft (m/s), positive in climb.
    wind_azimuth_rad : float
        Direction from which the edgewise air comes: 0 from the front, positive to the right (rad).
    cyclic_rad : (float, float)
        th1c and th1s of theta = th0 + th1c cos psi + th1s sin psi; psi = 0 aft, increasing with the rotation (rad).
    rates_rad_s : (float, float)
        Roll rate p (right side down) and pitch rate q (nose up) of the hub (rad/s).
    rotation_sign : int
        1 anticlockwise from above, -1 clockwise.
    air : Air
    """

    pitch_rad: float
    speed_rad_s: float
    edgewise_m_s: float = 0.0
    climb_m_s: float = 0.0
    wind_azimuth_rad: float = 0.0
    cyclic_rad: tuple[float, float] = (0.0, 0.0)
    rates_rad_s: tuple[float, float] = (0.0, 0.0)
    rotation_sign: int = 1
    air: Air = field(default_factory=Air)


@dataclass(frozen=True, eq=False)
class DiscFields:
    """Values over the disc in wind axes, (azimuths, stations); psi = 0 downwind, increasing with the rotation.

    Attributes
    ----------
    azimuth_rad : (azimuths,) array
    r_m : (stations,) array
    axial_induced_m_s : array
        Induced velocity of the rotor itself, down positive.
    onset_angle_rad : array
        Onset angle of the section: angle of attack, and the part that finite chord takes.
    lift_coefficient, drag_coefficient, reynolds : arrays
    thrust_per_length_N_m : array
        Thrust of one blade per length.
    """

    azimuth_rad: Array
    r_m: Array
    axial_induced_m_s: Array
    onset_angle_rad: Array
    lift_coefficient: Array
    drag_coefficient: Array
    reynolds: Array
    thrust_per_length_N_m: Array


@dataclass(frozen=True, eq=False)
class SolverState:
    """Unknowns of a solved operating point, from which the solution of a similar point can start.

    It holds the inflow of the annuli (m/s), the unknowns of flapping and inflow, and for each annulus swirl (m/s),
    Prandtl's factor and drag per length (N/m).
    """

    axial_induced_m_s: Array
    unknowns: Array
    annulus_values: Array


@result(eq=False)
class ForwardResult:
    """Loads of a rotor in forward flight; forces and moments of the hub in axes forward, right, with the shaft up.

    Attributes
    ----------
    edgewise_m_s, climb_m_s : float
        Airspeed in the disc and along the shaft.
    pitch_rad, speed_rad_s : float
        Collective pitch and rotor speed.
    flap_frequency_ratio : float
        Flap frequency over rotor speed.
    lock_number : float
        Lock number with a lift slope of 5.7 per rad.
    advance_ratio : float
        Edgewise speed over tip speed.
    thrust_N, torque_Nm, power_W : float
        Thrust along the shaft, torque and shaft power.
    h_force_N, y_force_N : float
        Force aft and to the right.
    roll_moment_Nm, pitch_moment_Nm : float
        Hub moments, right side down and nose up.
    coning_rad, flap_cos_rad, flap_sin_rad : float
        Flapping beta = coning + cos psi and sin psi parts; psi = 0 aft, with the rotation.
    flap_2_per_rev_rad : float
        Amplitude of flapping twice per revolution.
    blade_thrust_2_per_rev_N : float
        Amplitude of the thrust of one blade twice per revolution.
    inflow_mean, inflow_cos, inflow_sin : float
        l0, lc and ls of the induced velocity over the tip speed, in wind axes.
    induced_power_W, profile_power_W : float
        Parts of the power; shaft power + H V = induced + profile + thrust times climb.
    c_T, c_Q, c_H : float
        Coefficients over rho pi R^4 Omega^2 (times R for the torque).
    is_outside_range : bool
        True if the point lies outside the range of the method.
    notes : tuple of str
        Reasons for ``is_outside_range``.
    steps : int
        Newton steps.
    disc : DiscFields
        Values over the disc.
    state : SolverState
        Start for similar points.
    """

    edgewise_m_s: float
    climb_m_s: float
    pitch_rad: float
    speed_rad_s: float
    flap_frequency_ratio: float
    lock_number: float
    advance_ratio: float
    thrust_N: float
    torque_Nm: float
    power_W: float
    h_force_N: float
    y_force_N: float
    roll_moment_Nm: float
    pitch_moment_Nm: float
    coning_rad: float
    flap_cos_rad: float
    flap_sin_rad: float
    flap_2_per_rev_rad: float
    blade_thrust_2_per_rev_N: float
    inflow_mean: float
    inflow_cos: float
    inflow_sin: float
    induced_power_W: float
    profile_power_W: float
    c_T: float
    c_Q: float
    c_H: float
    is_outside_range: bool
    notes: tuple[str, ...]
    steps: int
    disc: DiscFields
    state: SolverState

    def as_record(self) -> dict[str, object]:
        """Return the scalars; arrays over the disc are left out."""
        return {k: v for k, v in vars(self).items() if k not in ("disc", "state")}


@result
class CyclicResponse:
    """Change of flapping and hub moment with cyclic pitch, mean of both directions of the cyclic input.

    Attributes
    ----------
    tilt_per_cyclic : float
        Amplitude of 1/rev flapping over amplitude of the cyclic pitch.
    lag_rad : float
        Angle along the rotation from greatest pitch to greatest flapping.
    moment_Nm_rad : float
        Hub moment per cyclic pitch (N m/rad).
    moment_lag_rad : float
        Angle along the rotation from greatest pitch to the side that the hub moment raises.
    """

    tilt_per_cyclic: float
    lag_rad: float
    moment_Nm_rad: float
    moment_lag_rad: float

    @property
    def moment_Nm_deg(self) -> float:
        """Hub moment per degree of cyclic pitch (N m)."""
        return self.moment_Nm_rad * math.pi / 180.0


ROTOR_TABLE_COLUMNS = (
    ResultColumn("flap_frequency_ratio", form=".3g", head="nu"),
    ResultColumn("edgewise_m_s", form=".3g", head="V", own_unit="m/s"),
    ResultColumn("advance_ratio", form=".3f", head="mu"),
    ResultColumn("thrust_N", "N", ".4g"),
    ResultColumn("power_W", "W", ".4g"),
    ResultColumn("h_force_N", "mN", "z.1f", head="H"),
    ResultColumn("y_force_N", "mN", "z.1f", head="Y"),
    ResultColumn("roll_moment_Nm", "mN m", "z.2f", head="roll"),
    ResultColumn("pitch_moment_Nm", "mN m", "z.2f", head="pitch"),
)
_FLAP_COLUMNS = (
    ResultColumn("point.flap_frequency_ratio", form=".3g", head="nu"),
    ResultColumn("point.edgewise_m_s", form=".3g", head="V", own_unit="m/s"),
    ResultColumn("point.coning_rad", "deg", ".2f", head="coning"),
    ResultColumn("point.flap_cos_rad", "deg", "z.2f", head="b1c"),
    ResultColumn("point.flap_sin_rad", "deg", "z.2f", head="b1s"),
    ResultColumn("response.tilt_per_cyclic", form=".3f", head="tilt / cyclic"),
    ResultColumn("response.lag_rad", "deg", ".1f", head="lag"),
    ResultColumn("response.moment_Nm_deg", "mN m", ".3f", head="moment per degree", own_unit="N m"),
    ResultColumn("response.moment_lag_rad", "deg", ".1f", head="its lag"),
)


@dataclass(frozen=True)
class _SweepRow:
    """Loads at an airspeed with the response to cyclic pitch, as a row of a table."""

    point: ForwardResult
    response: CyclicResponse


@result(eq=False)
class ForwardSweep:
    """Results of a rotor over airspeed, for one or several flap frequencies.

    Attributes
    ----------
    rotor : str
        Name of the rotor.
    flaps : tuple of RigidFlapMode
        Flap modes, the values of the first axis of the points.
    flap_basis : str
        Origin of flap frequency and inertia.
    points : tuple of tuples of ForwardResult
        Points by flap mode and airspeed.
    responses : tuple of tuples of CyclicResponse
        Response to cyclic pitch at the same points.
    cyclic_rad : float
        Amplitude of cyclic pitch of the responses.
    """

    rotor: str
    flaps: tuple[RigidFlapMode, ...]
    flap_basis: str
    points: tuple[tuple[ForwardResult, ...], ...]
    responses: tuple[tuple[CyclicResponse, ...], ...]
    cyclic_rad: float

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the results over airspeed as printed text."""
        first = self.points[0][0]
        rows = [p for line in self.points for p in line]
        answers = [r for line in self.responses for r in line]
        both = [_SweepRow(p, r) for p, r in zip(rows, answers, strict=True)]
        blocks: list[ShownBlock] = [
            make_lines_block(
                f" at {math.degrees(first.pitch_rad):.2f}° and {first.speed_rad_s * 30.0 / math.pi:.0f} rpm, "
                f"Lock number {first.lock_number:.2f}; {self.flap_basis}",
                head=self.rotor,
            ),
            tabulate_results(rows, ROTOR_TABLE_COLUMNS),
            tabulate_results(
                both, _FLAP_COLUMNS,
                title=f"Flapping, and the response to {math.degrees(self.cyclic_rad):g}° of cyclic pitch",
            ),
        ]  # fmt: skip
        for note in dict.fromkeys(n for p in rows for n in p.notes):
            at = [f"{p.edgewise_m_s:g}" for p in rows if note in p.notes]
            blocks.append(
                make_lines_block(f"{', '.join(dict.fromkeys(at))} m/s: {note}", mark="Outside", style="yellow")
            )
        return tuple(blocks)

    def as_record(self) -> dict[str, object]:
        """Return the rotor, the flap modes and a row for each point with its response."""
        rows = []
        for line, answers in zip(self.points, self.responses, strict=True):
            for p, r in zip(line, answers, strict=True):
                rows.append({**p.as_record(), "cyclic": r})
        return {"rotor": self.rotor, "flap": self.flaps, "flap_basis": self.flap_basis, "points": rows}
