"""Which corrections a blade element calculation applies; derivations and what each does to the error: docs/bemt.md.

* ``tip_loss``: ``"prandtl"`` is F = (2/pi) acos exp(-f), f = N (R - r) / (2 r |sin phi|) (Glauert's form of
Prandtl's
  factor; Leishman, sec. 3.3.10); ``"effective_radius"`` is eq. 3.13 of the dissertation, no lift beyond
  R_e = R (1 - 1.386 lambda / (N sqrt(1 + lambda^2))); ``"none"``.
* ``hub_loss``: the same factor at the inner end of the blade, f = N (r - r0) / (2 r0 |sin phi|).
* ``swirl``: induced velocity at right angles to the relative wind, not to the disc.
* ``lifting_surface``: flow tangency at three quarters of the chord (module ``lifting_surface``).
* ``rotation``: on a rotating blade the air in a separated layer is flung outwards and pressed towards the trailing
  edge, and the pressure stays nearer to that of attached flow than in two dimensions. Attached potential flow
  presses on a thin section with c_n = 2 pi sin a cos a (a = alpha - alpha_0); a share g of what the polar lacks
  of its lift is given back. The suction on the leading edge is not: the recovered force is normal to the chord
  (own derivation)::

      delta c_l = g (2 pi sin a cos^2 a - c_l),    delta c_d = delta c_l tan alpha

  g is published, from boundary-layer theory and wind turbines: ``"dumitrescu-cardos"`` 1 - exp(-1.25 / (r/c - 1))
  (J. Phys. Conf. Ser. 75, 012022, 2007), which stays below 1 however wide the blade; ``"snel"`` 3 (c/r)^2
  (ECN-C-93-052, 1994); ``"chaviaropoulos-hansen"`` 2.2 (c/r) cos^4 theta (J. Fluids Eng. 122, 2000), both cut
  at 1; ``"none"``. Full to |alpha| = 30 degrees, gone at 50; it never lowers the lift.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.rotor.polar import PolarTable

__all__ = ["PLAIN", "Corrections", "rotation_strength", "zero_lift_angle"]

Array = NDArray[np.float64]

TipLoss = Literal["prandtl", "effective_radius", "none"]
Rotation = Literal["dumitrescu-cardos", "snel", "chaviaropoulos-hansen", "none"]


@dataclass(frozen=True)
class Corrections:
    """Switches of the blade element calculation. The default is the set that is compared with measurements.

    Attributes
    ----------
    tip_loss, hub_loss, swirl, lifting_surface, rotation
        See the module docstring.
    drag_factor, lift_factor : float
        Multipliers of the section coefficients: 1 unless a user calibrates on a rotor of his own.
    """

    tip_loss: TipLoss = "prandtl"
    hub_loss: bool = True
    swirl: bool = True
    lifting_surface: bool = True
    rotation: Rotation = "dumitrescu-cardos"
    lift_factor: float = 1.0
    drag_factor: float = 1.0

    def __post_init__(self) -> None:
        for key, allowed in (
            ("tip_loss", ("prandtl", "effective_radius", "none")),
            ("rotation", ("dumitrescu-cardos", "snel", "chaviaropoulos-hansen", "none")),
        ):
            if getattr(self, key) not in allowed:
                raise InputError(
                    "corrections",
                    key,
                    f"{getattr(self, key)!r} is unknown",
                    f"choose one of {', '.join(allowed)}",
                )
        for key in ("lift_factor", "drag_factor"):
            if not 0.0 < getattr(self, key) < 10.0:
                raise InputError(
                    "corrections", key, f"is {getattr(self, key):g}", "give a factor between 0 and 10"
                )

    @property
    def calibrated(self) -> bool:
        """True if a factor was set by hand or by calibration."""
        return self.lift_factor != 1.0 or self.drag_factor != 1.0


PLAIN = Corrections(lifting_surface=False, rotation="none")  # textbook blade element momentum theory


def rotation_strength(kind: Rotation, chord_over_r: Array) -> Array:
    """Return g of the module docstring, for Chaviaropoulos and Hansen without their cos^4 theta.

    Parameters
    ----------
    kind : str
        Model.
    chord_over_r : array
        Local chord over local radius.
    """
    if kind == "dumitrescu-cardos":
        return 1.0 - np.exp(-1.25 * chord_over_r / np.maximum(1.0 - chord_over_r, 1e-6))
    if kind == "snel":
        return np.minimum(3.0 * chord_over_r**2, 1.0)
    if kind == "chaviaropoulos-hansen":
        return np.minimum(2.2 * chord_over_r, 1.0)
    return np.zeros_like(chord_over_r)


def zero_lift_angle(table: PolarTable) -> float:
    """Angle of zero lift (rad) at the highest Reynolds number of a table, nearest to zero; 0 if there is none.

    The potential lift line of the rotation models goes through it: at the top of the table the boundary layer is
    thin and the angle is close to that of the section in an inviscid fluid.
    """
    near = np.abs(table.alpha_rad) <= np.deg2rad(20.0)
    a, cl = table.alpha_rad[near], table.cl[-1, near]
    cross = np.flatnonzero((cl[:-1] <= 0.0) & (cl[1:] > 0.0))
    if cross.size == 0:
        return 0.0
    angles = a[cross] - cl[cross] * (a[cross + 1] - a[cross]) / (cl[cross + 1] - cl[cross])
    return float(angles[np.argmin(np.abs(angles))])
