"""Records of claims, verdicts and findings; and the dissertation's claims about rotors, pairs and drives.

Claims are facts of the source, each stated once; no model is tuned to them. Only the text of the dissertation was
available. So a number of a figure comes from the sentences about it (basis ``text``), from a printed table (``table``)
or from the figure's axes and legend (``axis``), whose labels bound the ends of the curves. No curve was digitised.
``verdicts.toml`` holds claims, limits, rules and reasons; :func:`judge` applies them.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mufly.results import result

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

ClaimBasis = Literal["text", "table", "axis"]


@dataclass(frozen=True)
class Claim:
    """One claim of the dissertation about a figure or table.

    Attributes
    ----------
    where : str
        Figure, table or section.
    text : str
        Statement, paraphrased.
    value : float
        Number stated; nan if there is none.
    unit : str
    basis : str
        Source of the number: a sentence of the text, a table, or the labels of a figure's axes.
    reason : str
        Reason of a difference, as far as known.
    """

    where: str
    text: str
    value: float = float("nan")
    unit: str = ""
    basis: ClaimBasis = "text"
    reason: str = ""


@result(json="claim model=model_name ours agrees rule")
class Verdict:
    """A claim beside the computed result.

    Attributes
    ----------
    claim : Claim
    model_name : str
        Model of ``ours``: a name of ``mufly.study.BEMT_MODELS``, ``"wake"``, ``"constant coefficients"``, ...
    ours : str
        Computed numbers, as text.
    agrees : bool
    rule : str
        Criterion of agreement.
    """

    claim: Claim
    model_name: str
    ours: str
    agrees: bool
    rule: str

    def format_line(self) -> str:
        """Return claim, computed value and verdict in one line."""
        word = "agrees" if self.agrees else "DIFFERS"
        known = f" Why: {self.claim.reason}." if self.claim.reason and not self.agrees else ""
        return (
            f"{word} ({self.model_name}): {self.claim.where} ({self.claim.basis}): {self.claim.text}. "
            f"Ours: {self.ours}. Rule: {self.rule}.{known}"
        )


@dataclass(frozen=True, eq=False)
class StudyFindings:
    """Results of a study: verdicts, picture and data.

    Attributes
    ----------
    verdicts : sequence of Verdict
    figure : Figure
        Picture of the computed results, with the printed ones.
    data : mapping
        Results by name (mostly of a model); empty for a study that only draws a picture.
    note : str
        Note on all results.
    missing : str
        Missing requirement of a verdict, such as ``"CFD"``.
    """

    verdicts: Sequence[Verdict]
    figure: Figure
    data: Mapping[str, xr.Dataset] = field(default_factory=dict)
    note: str = ""
    missing: str = ""


ProgressCallback = Callable[[int, int], None]


@dataclass(frozen=True)
class Study:
    """A figure's or table's computation and cost.

    Attributes
    ----------
    compute : callable
        ``compute(progress)`` returns :class:`StudyFindings`; progress is called with (done, total), or is None.
    cost_s : float
        Approximate time on one core (s), for the order of ``run all``.
    """

    compute: Callable[[ProgressCallback | None], StudyFindings]
    cost_s: float


VERDICTS_FILE = Path(__file__).with_name("verdicts.toml")
"""File with one table for each verdict: claim, limits, rule in words, and the reason of a difference."""
_VERDICT_TABLE: dict[str, dict[str, Any]] = tomllib.loads(VERDICTS_FILE.read_text(encoding="utf-8"))

CLAIMS: dict[str, Claim] = {
    key: Claim(**{name: row[name] for name in ("where", "text", "value", "unit", "basis", "reason") if name in row})
    for key, row in _VERDICT_TABLE.items()
}
"""Claim of each verdict, by the verdict's key."""


def judge(key: str, model: str, ours: str, **quantities: Any) -> Verdict:
    """Return the verdict on a claim: whether quantities meet the limits of its row in :data:`VERDICTS_FILE`.

    Parameters
    ----------
    key : str
        Key of the row.
    model, ours : str
        As in :class:`Verdict`.
    **quantities : float, array or bool
        Quantities for which the row has limits; all elements of an array must meet them.

    Raises
    ------
    KeyError
        If there is no such row, or it has limits for other quantities.
    """
    row = _VERDICT_TABLE[key]
    limits = row["limits"]
    if set(limits) != set(quantities):
        raise KeyError(
            f"{VERDICTS_FILE.name}: {key}: has limits of {sorted(limits)}, but the study computes {sorted(quantities)}"
        )
    agrees = all(meets_limits(value, limits[name]) for name, value in quantities.items())
    reason = row.get("reason_by_model", {}).get(model, CLAIMS[key].reason)
    return Verdict(replace(CLAIMS[key], reason=reason), model, ours, agrees, row["rule"])


def make_item_judge(item: str, model: str) -> Callable[..., Verdict]:
    """Return the function :func:`judge` for claims about one figure or table (``"fig-6.5"``) by one model.

    Its arguments are the key of the claim after the item, the computed numbers as text, and the quantities.
    """
    return lambda claim, ours, **quantities: judge(f"{item}/{claim}", model, ours, **quantities)


def meets_limits(value: Any, limits: Mapping[str, float] | bool) -> bool:
    """Return whether all elements of a value meet limits; a nan meets none."""
    if isinstance(limits, bool):
        return bool(value) is limits
    v = np.asarray(value, dtype=np.float64)
    near = limits.get("near", math.nan)
    checks = {
        "above": lambda x: v > x,
        "below": lambda x: v < x,
        "at_least": lambda x: v >= x,
        "at_most": lambda x: v <= x,
        "equals": lambda x: v == x,
        "within": lambda x: np.abs(v - near) <= x,
        "within_share": lambda x: np.abs(v / near - 1.0) <= x,
        "brackets": lambda x: v.min() - limits["slack"] <= x <= v.max() + limits["slack"],
    }
    return all(bool(np.all(checks[name](x))) for name, x in limits.items() if name not in ("near", "slack"))


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

# Table 5.3: symbol as in `mufly vehicle show` -> printed value (SI; the angle in degrees).
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
