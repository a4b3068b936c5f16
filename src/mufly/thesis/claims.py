"""What the dissertation says about rotors, pairs and drives (Secs 3.1.4 and 3.4): numbers, with where they stand.

These are facts of the source, each written down once; the studies compare with them.
"""

from __future__ import annotations

from dataclasses import dataclass


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
    """

    where: str
    text: str
    value: float = float("nan")
    unit: str = ""


@dataclass(frozen=True)
class Verdict:
    """A claim beside what we compute.

    Attributes
    ----------
    claim : Claim
    model : str
        Model that ``ours`` was computed with: of ``mufly.study.MODELS``, ``"wake"``, or ``"constant coefficients"``.
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

    def line(self) -> str:
        """Return the verdict in one line."""
        word = "agrees" if self.agrees else "DIFFERS"
        return f"{word} ({self.model}): {self.claim.where}: {self.claim.text}. Ours: {self.ours}. Rule: {self.rule}."


CLAIMS: dict[str, Claim] = {
    "gear-power": Claim(
        "Fig. 3.7", "mechanical power and thrust are greatest at a gear ratio of about 1.5", 1.5
    ),
    "gear-efficiency": Claim("Fig. 3.7", "the drive is most efficient at a gear ratio of about 3", 3.0),
    "gear-thrust-per-power": Claim(
        "Fig. 3.7", "thrust per power is greatest at a gear ratio of about 4", 4.0
    ),
    "gear-thrust": Claim("Fig. 3.7", "0.6 N are reached with a gear ratio of about 2", 2.0),
    "coefficients-torque": Claim(
        "Fig. 3.25", "the torque coefficient hardly changes from 3 000 to 7 000 rpm"
    ),
    "coefficients-thrust": Claim(
        "Fig. 3.25", "the thrust coefficient changes more, and grows with the speed"
    ),
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
    "airfoils-bottom": Claim(
        "Table 3.3", "lnv109a, NACA25516, n642-015 and NACA6415 are the worst four of 247"
    ),
    "airfoils-spread": Claim("Table 3.3", "the best takes 6.04 W, NACA6415 9.63 W: 3.6 W more", 3.585, "W"),
    "taper": Claim(
        "Fig. 3.35", "the strongest taper is better than the straight blade by more than 10 %", 10.0, "%"
    ),
    "twist": Claim("Fig. 3.36", "strong twist is better"),
    "twist-pitch": Claim("Fig. 3.36", "the best pitch falls with stronger twist"),
    "coax-thrust": Claim(
        "Fig. 3.43", "at equal speeds the lower rotor has 55 % of the upper one's thrust", 0.55
    ),
    "coax-torque": Claim(
        "Fig. 3.43", "at equal speeds the lower rotor's torque is about 20 % less", 20.0, "%"
    ),
    "coax-constant": Claim(
        "Fig. 3.43", "at equal speeds the lower rotor's coefficients hardly change with the speed"
    ),
    "coax-upper": Claim("Fig. 3.43", "the upper rotor has slightly more thrust and torque than alone"),
    "coax-upper-speed": Claim(
        "Fig. 3.44", "the lower coefficients fall strongly as the upper rotor turns faster"
    ),
    "coax-lower-speed": Claim(
        "Fig. 3.44", "they rise even more with the lower speed, from a negative thrust on"
    ),
    "coax-trim": Claim(
        "Sec. 3.4.7", "with the upper rotor at 6 000 rpm torques cancel at 6 650 rpm", 6650.0, "rpm"
    ),
    "coax-deficit": Claim("Sec. 3.4.7", "the lower rotor then has 23 % less thrust", 23.0, "%"),
    "coax-excess": Claim("Sec. 3.4.7", "and takes 10 % more mechanical power", 10.0, "%"),
    "coax-pitch-speed": Claim("Table 3.4", "lower speeds at 14, 16 and 18 deg: 6 650, 5 750 and 5 025 rpm"),
    "coax-pitch-thrust": Claim("Table 3.4", "lower thrusts: 0.1949, 0.1820 and 0.1709 N"),
    "coax-pitch-power": Claim("Table 3.4", "lower powers: 2.0531, 1.7413 and 1.5286 W"),
    "coax-spacing": Claim("Fig. 3.45", "a spacing of 1 to 4 cm has little influence on the lower rotor"),
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
