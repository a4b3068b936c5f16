"""What a claim, a verdict and a study's findings are; and what the dissertation claims of rotors, pairs and drives.

Claims are facts of the source, each written down once; nothing is tuned to them. Of the dissertation only its text is
at hand. So a number of a figure comes from the sentences about it (basis ``text``), from a printed table (``table``)
or from the figure's axes and legend (``axis``), whose texts tell between which ticks the curves end; no curve was
digitised. The numbers of Secs 3.1.4 and 3.4 stand here, those of the other sections beside the studies of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

ClaimBasis = Literal["text", "table", "axis"]


@dataclass(frozen=True)
class Claim:
    """One statement.

    Attributes
    ----------
    where : str
        Figure, table or section.
    text : str
        What is stated, in our words.
    value : float
        The number it gives; nan if it gives none.
    unit : str
    basis : str
        What was read: a sentence of the text, a table, or the texts of a figure's axes.
    reason : str
        Why ours differs, where it does and as far as it is known.
    """

    where: str
    text: str
    value: float = float("nan")
    unit: str = ""
    basis: ClaimBasis = "text"
    reason: str = ""


@dataclass(frozen=True)
class Verdict:
    """A claim beside what we compute.

    Attributes
    ----------
    claim : Claim
    model : str
        What ``ours`` was computed with: a name of ``mufly.study.BEMT_MODELS``, ``"wake"``, ``"constant coefficients"``,
        ...
    ours : str
        Our numbers.
    agrees : bool
    rule : str
        When we call it agreement.
    """

    claim: Claim
    model: str
    ours: str
    agrees: bool
    rule: str

    def format_line(self) -> str:
        """Return the verdict in one line."""
        word = "agrees" if self.agrees else "DIFFERS"
        known = f" Why: {self.claim.reason}." if self.claim.reason and not self.agrees else ""
        return (
            f"{word} ({self.model}): {self.claim.where} ({self.claim.basis}): {self.claim.text}. Ours: {self.ours}. "
            f"Rule: {self.rule}.{known}"
        )


@dataclass(frozen=True, eq=False)
class StudyFindings:
    """What a study computed.

    Attributes
    ----------
    verdicts : sequence of Verdict
    figure : Figure
        Ours, with what is printed beside it.
    data : mapping
        Name (a model, mostly) to results; empty where nothing but a picture is drawn.
    note : str
        What to know about all of it.
    lacking : str
        What is needed for a verdict and was not there, as ``"CFD"``.
    """

    verdicts: Sequence[Verdict]
    figure: Figure
    data: Mapping[str, xr.Dataset] = field(default_factory=dict)
    note: str = ""
    lacking: str = ""


ProgressCallback = Callable[[int, int], None]


@dataclass(frozen=True)
class Study:
    """How a figure or table is answered.

    Attributes
    ----------
    compute : callable
        ``compute(progress)`` gives :class:`StudyFindings`; progress is called with (done, total), or is None.
    cost_s : float
        About how long one core takes, for the order of ``run all``.
    """

    compute: Callable[[ProgressCallback | None], StudyFindings]
    cost_s: float


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure (inches)."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


_CLAIMS: dict[str, Claim] = {
    "gear-power": Claim("Fig. 3.7", "mechanical power and thrust are greatest at a gear ratio of about 1.5", 1.5),
    "gear-efficiency": Claim("Fig. 3.7", "the drive is most efficient at a gear ratio of about 3", 3.0),
    "gear-thrust-per-power": Claim("Fig. 3.7", "thrust per power is greatest at a gear ratio of about 4", 4.0),
    "gear-thrust": Claim("Fig. 3.7", "0.6 N are reached with a gear ratio of about 2", 2.0),
    "coefficients-torque": Claim("Fig. 3.25", "the torque coefficient hardly changes from 3 000 to 7 000 rpm"),
    "coefficients-thrust": Claim("Fig. 3.25", "the thrust coefficient changes more, and grows with the speed"),
    "blades-two": Claim("Fig. 3.26", "two blades are best up to 16 degrees of pitch", 16.0, "deg"),
    "blades-more": Claim("Fig. 3.26", "at higher pitch three and four blades are slightly better"),
    "blades-five": Claim("Fig. 3.26", "five blades are worst at every pitch"),
    "radius": Claim("Fig. 3.27", "a larger radius is better"),
    "radius-size": Claim("Fig. 3.27", "the radii from 50 to 80 mm differ by about 15 %", 15.0, "%"),
    "chord-best": Claim("Fig. 3.28", "a chord of 30 mm is best", 30.0, "mm"),
    "chord-flat": Claim("Fig. 3.28", "the three largest chords differ little"),
    "chord-pitch": Claim("Fig. 3.28", "larger chords have their best pitch higher"),
    "thickness": Claim("Fig. 3.30", "the thinnest section beats the thickest by more than 10 %", 10.0, "%"),
    "camber": Claim("Fig. 3.31", "at 12 % thickness a camber of 4 % is best", 4.0, "%"),
    "camber-position": Claim("Fig. 3.32", "the place of the camber hardly matters"),
    "airfoils-top": Claim("Table 3.3", "goe394, goe342, gm15sm and goe142 are the best four of 247"),
    "airfoils-bottom": Claim("Table 3.3", "lnv109a, NACA25516, n642-015 and NACA6415 are the worst four of 247"),
    "airfoils-spread": Claim("Table 3.3", "the best takes 6.04 W, NACA6415 9.63 W: 3.6 W more", 3.585, "W"),
    "taper": Claim("Fig. 3.35", "the strongest taper is better than the straight blade by more than 10 %", 10.0, "%"),
    "twist": Claim("Fig. 3.36", "strong twist is better"),
    "twist-pitch": Claim("Fig. 3.36", "the best pitch falls with stronger twist"),
    "coax-thrust": Claim("Fig. 3.43", "at equal speeds the lower rotor has 55 % of the upper one's thrust", 0.55),
    "coax-torque": Claim("Fig. 3.43", "at equal speeds the lower rotor's torque is about 20 % less", 20.0, "%"),
    "coax-constant": Claim("Fig. 3.43", "at equal speeds the lower rotor's coefficients hardly change with the speed"),
    "coax-upper": Claim("Fig. 3.43", "the upper rotor has slightly more thrust and torque than alone"),
    "coax-upper-speed": Claim("Fig. 3.44", "the lower coefficients fall strongly as the upper rotor turns faster"),
    "coax-lower-speed": Claim("Fig. 3.44", "they rise even more with the lower speed, from a negative thrust on"),
    "coax-trim": Claim("Sec. 3.4.7", "with the upper rotor at 6 000 rpm torques cancel at 6 650 rpm", 6650.0, "rpm"),
    "coax-deficit": Claim("Sec. 3.4.7", "the lower rotor then has 23 % less thrust", 23.0, "%"),
    "coax-excess": Claim("Sec. 3.4.7", "and takes 10 % more mechanical power", 10.0, "%"),
    "coax-pitch-speed": Claim("Table 3.4", "lower speeds at 14, 16 and 18 deg: 6 650, 5 750 and 5 025 rpm"),
    "coax-pitch-thrust": Claim("Table 3.4", "lower thrusts: 0.1949, 0.1820 and 0.1709 N"),
    "coax-pitch-power": Claim("Table 3.4", "lower powers: 2.0531, 1.7413 and 1.5286 W"),
    "coax-spacing": Claim("Fig. 3.45", "a spacing of 1 to 4 cm has little influence on the lower rotor"),
}

_TUNING_REASON = (
    "polars, the unstated hub cut-out (here 0.15 R) and the tuning, which is not printed (docs/explanation/studies.md)"
)
_WAKE_REASON = (
    "our wakes take more from the lower rotor: no swirl from drag, a stream with a sharp edge "
    "(docs/explanation/wake.md)"
)
_REASONS_BY_CLAIM = {
    "gear-thrust": "it holds at 6.4 V, the voltage of a used battery (docs/thesis/thesis-errata.md, points 6 and 22)",
    "coefficients-torque": "the corrections for a short blade move with the Reynolds number",
    "coefficients-thrust": "the corrections for a short blade move with the Reynolds number; without them it agrees",
    "blades-two": _TUNING_REASON,
    "blades-more": _TUNING_REASON,
    "blades-five": _TUNING_REASON,
    "radius-size": "momentum theory alone gives +60 % from 50 to 80 mm; 15 % is one step of 10 mm "
    "(docs/explanation/studies.md)",
    "thickness": _TUNING_REASON,
    "airfoils-bottom": "polars that did not converge would explain it (docs/thesis/thesis-errata.md, points 23 and 24)",
    "airfoils-spread": "NACA6415's 9.6 W cannot be had from theory and polar alone "
    "(docs/thesis/thesis-errata.md, point 24)",
    "taper": "a hub chord of 35 mm is no lifting line, and the tip works at Re 10 000 (docs/explanation/studies.md)",
    "twist": "within 1 % of each other with the corrections; with the dissertation's own theory it agrees",
    "coax-thrust": _WAKE_REASON,
    "coax-torque": _WAKE_REASON,
    "coax-upper": "coaxial blade elements let the lower rotor's suction through to the upper one "
    "(docs/explanation/coax.md)",
    "coax-pitch-power": "the printed torque is above its own bench's (docs/thesis/thesis-errata.md, point 26)",
    "coax-lower-speed": "a lower rotor that windmills in the upper one's wake has no wake that settles "
    "(docs/explanation/wake.md)",
    "coax-pitch-speed": "both are computed, and no bench decides; ours wants more speed at more pitch "
    "(docs/explanation/wake.md)",
    "coax-spacing": "most of it between 1 and 2 cm; blade elements let the upper wake grow stronger with the distance",
}
CLAIMS: dict[str, Claim] = {
    key: replace(
        claim,
        basis="table" if claim.where.startswith("Table") else "text",
        reason=_REASONS_BY_CLAIM.get(key, ""),
    )
    for key, claim in _CLAIMS.items()
}

# Table 3.3: airfoil -> rank of 247, thrust per electrical power (N/W), electrical power (W) at 0.4 N.
TABLE_3_3_VALUES: dict[str, tuple[int, float, float]] = {
    "goe394": (1, 0.0663, 6.043),
    "goe342": (2, 0.0660, 6.062),
    "gm15sm": (3, 0.0657, 6.085),
    "goe142": (4, 0.0656, 6.096),
    "lnv109a": (244, 0.0503, 7.954),
    "NACA25516": (245, 0.0480, 8.350),
    "n642-015": (246, 0.0436, 9.171),
    "NACA6415": (247, 0.0415, 9.628),
}

# Table 3.4: pitch of the lower rotor (deg) -> its speed (rpm), thrust (N), power (W) at equal torques.
TABLE_3_4_VALUES: dict[int, tuple[float, float, float]] = {
    14: (6650.0, 0.1949, 2.0531),
    16: (5750.0, 0.1820, 1.7413),
    18: (5025.0, 0.1709, 1.5286),
}

# Table 3.2: pitch (deg), speed (rpm) -> method -> thrust (N), torque (N m).
TABLE_3_2_VALUES: dict[tuple[int, int], dict[str, tuple[float, float]]] = {
    (12, 5000): {
        "measured": (0.151, 0.0015), "laminar": (0.136, 0.00174), "k-epsilon": (0.135, 0.00153),
        "k-omega": (0.132, 0.00170), "BSL": (0.123, 0.00191),
    },
    (12, 7000): {
        "measured": (0.298, 0.0027), "laminar": (0.273, 0.00337), "k-epsilon": (0.266, 0.00297),
        "k-omega": (0.261, 0.00319), "BSL": (0.273, 0.00678),
    },
    (16, 5000): {
        "measured": (0.218, 0.0023), "laminar": (0.206, 0.00299), "k-epsilon": (0.203, 0.00248),
        "k-omega": (0.202, 0.00288), "BSL": (0.184, 0.00299),
    },
    (16, 7000): {
        "measured": (0.425, 0.0042), "laminar": (0.399, 0.00561), "k-epsilon": (0.400, 0.00483),
        "k-omega": (0.393, 0.00544), "BSL": (0.334, 0.00630),
    },
}  # fmt: skip

# Table 5.3: symbol as `mufly vehicle show` has it -> value as printed (SI; the angle in degrees).
TABLE_5_3_VALUES: dict[str, float] = {
    "body.mass": 0.095, "battery.nominal_voltage": 7.2, "body.inertia_xx": 1.12e-4, "body.inertia_yy": 1.43e-4,
    "body.inertia_zz": 2.66e-5, "rotors.lower.hub_z": -0.051, "rotors.upper.hub_z": -0.091,
    "swash_plate.max_tilt": 15.0,
    "rotors.radius": 0.0875, "rotors.lower.thrust_coefficient": 0.0117, "rotors.upper.thrust_coefficient": 0.0138,
    "rotors.lower.torque_coefficient": 0.0018, "rotors.upper.torque_coefficient": 0.0025,
    "rotors.lower.drive_inertia": 7.04e-6, "rotors.upper.drive_inertia": 2.11e-5, "motor.back_emf_constant": 0.0045,
    "motor.torque_constant": 0.0035, "motor.friction": 5.2107e-7, "motor.resistance": 1.3811, "gear.ratio": 1.5,
    "gear.efficiency": 0.84, "body.downwash_drag": 0.009, "swash_plate.time_constant": 0.001,
    "stabiliser_bar.time_constant": 0.24, "swash_plate.linkage": 0.77, "stabiliser_bar.linkage": 0.48,
}  # fmt: skip
