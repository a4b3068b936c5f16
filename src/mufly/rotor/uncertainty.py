"""How sure is a prediction? A band from what is not known of the blade's sections, and of the method.

Causes are varied one at a time about the nominal rotor, each by one standard deviation:

* ``n_crit``: transition early or late, 4 and 9 beside the nominal value (the dissertation's Table 3.1);
* ``engine``: 4 % of the lift coefficient, 8 % of the drag coefficient: network, boundary-layer code and wind tunnel do
  not agree better below Re 1e5 (docs/polars.md);
* ``camber``: 0.3 % of the chord for a known section, 1 % for a guess; zero-lift angle -2 f (thin airfoil, parabola);
* ``thickness``: 0.5 % of the chord, 2 % for a guess; drag 1 + 2 t (Hoerner, Fluid-Dynamic Drag, 1965, ch. II);
* ``pitch``: half a degree of setting and twist;
* ``method``: 5 % of thrust, 8 % of torque, the size of what a lattice with a contracting wake changes (docs/bemt.md).

They are taken as independent, variances add, and the 90 % interval is 1.645 standard deviations to either side. None of
these numbers was fitted to the measurements that docs/validation.md checks them on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.errors import InputError
from mufly.results import result
from mufly.rotor.bemt import hover_batch
from mufly.rotor.blading import Corrections, prepare
from mufly.rotor.engines import Engine
from mufly.rotor.geometry import Rotor
from mufly.rotor.system import Air

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Doubt:
    """Standard deviations of what is not known; the defaults belong to a known section."""

    n_crit: tuple[float, ...] = (4.0, 9.0)
    lift: float = 0.04
    drag: float = 0.08
    camber: float = 0.003
    thickness: float = 0.005
    pitch_rad: float = math.radians(0.5)
    method_thrust: float = 0.05
    method_torque: float = 0.08

    def __post_init__(self) -> None:
        for key in ("lift", "drag", "camber", "thickness", "pitch_rad", "method_thrust", "method_torque"):
            if not 0.0 <= getattr(self, key) < 1.0:
                raise InputError("uncertainty", key, f"is {getattr(self, key):g}", "give 0 or more, below 1")

    @classmethod
    def of_unknown_section(cls) -> Doubt:
        """Return the doubt about a blade whose airfoil was guessed."""
        return cls(camber=0.01, thickness=0.02)


@result(eq=False)
class Band:
    """A prediction with its interval.

    Attributes
    ----------
    thrust_N, torque_Nm : (n,) arrays
        Nominal prediction.
    thrust_low_N, thrust_high_N, torque_low_Nm, torque_high_Nm : (n,) arrays
        Interval.
    level : float
        Probability that it is meant to hold.
    thrust_share, torque_share : dict of str to (n,) arrays
        Relative standard deviation that each cause brings.
    """

    thrust_N: Array
    torque_Nm: Array
    thrust_low_N: Array
    thrust_high_N: Array
    torque_low_Nm: Array
    torque_high_Nm: Array
    level: float
    thrust_share: Mapping[str, Array]
    torque_share: Mapping[str, Array]


_SIGMAS = {0.5: 0.674, 0.68: 0.994, 0.8: 1.282, 0.9: 1.645, 0.95: 1.960, 0.99: 2.576}
_ZERO_LIFT_PER_CAMBER = 2.0  # rad per chord: thin-airfoil theory, parabolic camber line
_DRAG_PER_THICKNESS = 2.0  # skin friction of a section of thickness t: 1 + 2 t


def interval(
    rotor: Rotor,
    *,
    pitch_rad: ArrayLike,
    speed_rad_s: ArrayLike,
    climb_m_s: ArrayLike = 0.0,
    air: Air | None = None,
    corrections: Corrections | None = None,
    n_crit: float = 0.1,
    engine: Engine = "neuralfoil",
    doubt: Doubt | None = None,
    level: float = 0.9,
) -> Band:
    """Predict thrust and torque with an interval.

    Parameters
    ----------
    rotor : Rotor
        The rotor.
    pitch_rad, speed_rad_s, climb_m_s : array_like
        Points, broadcast against each other.
    air, corrections, n_crit, engine
        As for :func:`mufly.rotor.blading.prepare` and :func:`mufly.rotor.bemt.hover`.
    doubt : Doubt, optional
        What is not known; :meth:`Doubt.of_unknown_section` where the airfoil is a guess.
    level : float
        0.5, 0.68, 0.8, 0.9, 0.95 or 0.99.

    Raises
    ------
    InputError
        If the level is none of these.
    """
    if level not in _SIGMAS:
        raise InputError(
            "uncertainty", "level", f"is {level:g}", f"choose one of {', '.join(map(str, _SIGMAS))}"
        )
    unsure = doubt or Doubt()
    fixes = corrections or Corrections()
    pitch, speed, climb = np.broadcast_arrays(*np.atleast_1d(pitch_rad, speed_rad_s, climb_m_s))
    nominal = prepare(rotor, n_crit=n_crit, engine=engine, corrections=fixes)

    def solve(blading=nominal, turned: float = 0.0) -> tuple[Array, Array]:  # type: ignore[no-untyped-def]
        out = hover_batch(blading, pitch_rad=pitch + turned, speed_rad_s=speed, climb_m_s=climb, air=air)
        return out.thrust_N, out.torque_Nm

    def scaled(lift: float, drag: float) -> tuple[Array, Array]:
        changed = replace(fixes, lift_factor=fixes.lift_factor * lift, drag_factor=fixes.drag_factor * drag)
        return solve(replace(nominal, corrections=changed))

    thrust, torque = solve()

    def spread(*others: tuple[Array, Array]) -> tuple[Array, Array]:
        """Root mean square departure from the nominal point."""
        return (
            np.sqrt(np.mean([(t - thrust) ** 2 for t, _ in others], axis=0)),
            np.sqrt(np.mean([(q - torque) ** 2 for _, q in others], axis=0)),
        )

    shift = _ZERO_LIFT_PER_CAMBER * unsure.camber
    causes = {
        "n_crit": spread(
            *(solve(prepare(rotor, n_crit=n, engine=engine, corrections=fixes)) for n in unsure.n_crit),
            (thrust, torque),
        ),
        "engine": _added(
            spread(scaled(1 + unsure.lift, 1.0), scaled(1 - unsure.lift, 1.0)),
            spread(scaled(1.0, 1 + unsure.drag), scaled(1.0, 1 - unsure.drag)),
        ),
        "camber": spread(solve(turned=shift), solve(turned=-shift)),
        "thickness": spread(
            scaled(1.0, 1 + _DRAG_PER_THICKNESS * unsure.thickness),
            scaled(1.0, 1 - _DRAG_PER_THICKNESS * unsure.thickness),
        ),
        "pitch": spread(solve(turned=unsure.pitch_rad), solve(turned=-unsure.pitch_rad)),
        "method": (unsure.method_thrust * np.abs(thrust), unsure.method_torque * np.abs(torque)),
    }
    sigma_t, sigma_q = _added(*causes.values())
    k = _SIGMAS[level]
    size_t, size_q = (np.where(v == 0.0, np.nan, np.abs(v)) for v in (thrust, torque))
    return Band(
        thrust, torque, thrust - k * sigma_t, thrust + k * sigma_t, torque - k * sigma_q, torque + k * sigma_q, level,
        {name: t / size_t for name, (t, _) in causes.items()}, {name: q / size_q for name, (_, q) in causes.items()},
    )  # fmt: skip


def _added(*pairs: tuple[Array, Array]) -> tuple[Array, Array]:
    """Standard deviations of independent causes, together."""

    def root(parts: Sequence[Array]) -> Array:
        return np.sqrt(np.sum(np.square(parts), axis=0))

    return root([t for t, _ in pairs]), root([q for _, q in pairs])
