"""Which corrections a blade element calculation applies; derivations and what each does to the error: docs/bemt.md.

* ``tip_loss``: ``"prandtl"`` is F = (2/pi) acos exp(-f), f = N (R - r) / (2 r |sin phi|) (Glauert's form of
Prandtl's
  factor; Leishman, sec. 3.3.10); ``"effective_radius"`` is eq. 3.13 of the dissertation, no lift beyond
  R_e = R (1 - 1.386 lambda / (N sqrt(1 + lambda^2))); ``"none"``.
* ``hub_loss``: the same factor at the inner end of the blade, f = N (r - r0) / (2 r0 |sin phi|).
* ``swirl``: induced velocity at right angles to the relative wind, not to the disc.
* ``lifting_surface``: flow tangency at three quarters of the chord (module ``lifting_surface``).
* ``rotation``: lift recovered and drag added where boundary layers separate on a rotating blade::

      c_l = c_l2D + g (c_lpot - c_l2D)        c_lpot = 2 pi sin(alpha - alpha_0)
      c_d = c_d2D + h (c_d2D - min c_d2D)

  ``"chaviaropoulos-hansen"``: g = h = 2.2 (c/r) cos^4 theta (Chaviaropoulos and Hansen, J. Fluids Eng. 122,
  2000, from quasi-three-dimensional Navier-Stokes); ``"snel"``: g = 3 (c/r)^2, h = 0 (Snel, Houwink and
  Bosschers, ECN-C-93-052, 1994); ``"none"``. g never exceeds 1, is full to 30 degrees and gone at 50, and never
  lowers the lift.
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
Rotation = Literal["chaviaropoulos-hansen", "snel", "none"]


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
    rotation: Rotation = "chaviaropoulos-hansen"
    lift_factor: float = 1.0
    drag_factor: float = 1.0

    def __post_init__(self) -> None:
        for key, allowed in (
            ("tip_loss", ("prandtl", "effective_radius", "none")),
            ("rotation", ("chaviaropoulos-hansen", "snel", "none")),
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


def rotation_strength(kind: Rotation, chord_over_r: Array) -> tuple[Array, float]:
    """Return g of the module docstring without its cos^4 theta, and h / g.

    Parameters
    ----------
    kind : str
        Model.
    chord_over_r : array
        Local chord over local radius.
    """
    if kind == "chaviaropoulos-hansen":
        return 2.2 * chord_over_r, 1.0
    if kind == "snel":
        return 3.0 * chord_over_r**2, 0.0
    return np.zeros_like(chord_over_r), 0.0


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
