"""Measure the consistency of an estimate: its errors relative to its own covariance.

The normalised estimation error squared (NEES) is e^T P^-1 e for an error e of n components. For a consistent P its mean
is n, and 95 % of its values lie below the 95 % point of the chi-square distribution (Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation, ch. 5.4). The normalised innovation squared (NIS) is the same
quantity of innovations. NIS needs no truth, but does not show errors that all readings share.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from mufly.errors import InputError
from mufly.estimate.estimator import Estimate
from mufly.estimate.filter.filter_records import ERROR_ATTITUDE, ERROR_GYRO_BIAS, ERROR_POSITION, ERROR_VELOCITY
from mufly.results import ResultColumn, ShownBlock, result, tabulate_fields, tabulate_results
from mufly.sensors import Truth

_Array = NDArray[np.float64]

ERROR_BLOCKS = {
    "position": slice(ERROR_POSITION, ERROR_VELOCITY),
    "velocity": slice(ERROR_VELOCITY, ERROR_ATTITUDE),
    "tilt": slice(ERROR_ATTITUDE, ERROR_ATTITUDE + 2),
    "heading": slice(ERROR_ATTITUDE + 2, ERROR_GYRO_BIAS),
}
"""Blocks of the error that are consistent one by one; an ellipsoid of all nine components hides a narrow block."""
_EMPTY_BLOCK_RESULT = (math.nan, math.nan)


def compute_normalised_squared_errors(errors: _Array, covariances: _Array) -> _Array:
    """Return e^T P^-1 e of each row; errors (k, n), covariances (k, n, n)."""
    solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
    found: _Array = np.einsum("ki,ki->k", errors, solved)
    return found


@result(
    json="count nees inside_share block_nees block_inside_shares nis xy_rms=xy_rms_m xy_peak=xy_peak_m z_rms=z_rms_m "
    "z_peak=z_peak_m tilt_rms=tilt_rms_rad tilt_peak=tilt_peak_rad yaw_rms=yaw_rms_rad"
)
class Consistency:
    """Errors of an estimate, and measures of how well its covariance predicts them.

    Attributes
    ----------
    count : int
        Number of instants.
    nees : float
        Mean of NEES / n over position, velocity and attitude (n = 9).
    inside_share : float
        Share of instants inside the 95 % ellipsoid.
    block_nees, block_inside_shares : (4,) tuples
        NEES / n of each block of :data:`ERROR_BLOCKS`, and the share of instants inside the block's 95 % ellipsoid.
    nis : float
        Mean square of the innovation ratios of the position fix.
    xy_rms_m, xy_peak_m, z_rms_m, z_peak_m : float
        Root mean square and peak errors of the position (m).
    tilt_rms_rad, tilt_peak_rad, yaw_rms_rad : float
        Root mean square and peak errors of the attitude (rad).
    """

    count: int
    nees: float
    inside_share: float
    block_nees: tuple[float, ...]
    block_inside_shares: tuple[float, ...]
    nis: float
    xy_rms_m: float
    xy_peak_m: float
    z_rms_m: float
    z_peak_m: float
    tilt_rms_rad: float
    tilt_peak_rad: float
    yaw_rms_rad: float

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return errors and consistency as printed text."""
        return self.tabulate_errors({"": self})

    @classmethod
    def tabulate_errors(cls, cases: Mapping[str, Consistency]) -> list[ShownBlock]:
        """Return as printed text the errors and consistency of named cases, and the blocks of the first."""
        first, *_ = cases.values()
        columns = [
            *(ResultColumn(name, "cm", ".1f") for name in ("xy_rms_m", "xy_peak_m", "z_rms_m", "z_peak_m")),
            *(ResultColumn(name, "deg", ".2f") for name in ("tilt_rms_rad", "tilt_peak_rad", "yaw_rms_rad")),
            ResultColumn("nees", form=".2f", head="NEES / n"),
            ResultColumn("inside_share", form=".1%", head="inside 95 %"),
        ]
        blocks = [
            ResultColumn("block_nees", form=".2f", head="NEES / n (1 if consistent)", entry_names=tuple(ERROR_BLOCKS)),
            ResultColumn(
                "block_inside_shares", form=".0%", head="inside 95 % ellipsoid", entry_names=tuple(ERROR_BLOCKS)
            ),
        ]
        names = list(cases) if any(cases) else ()
        return [tabulate_results([*cases.values()], columns, names=names), tabulate_fields(first, blocks)]

    @classmethod
    def merge_flights(cls, several: Sequence[Consistency]) -> Consistency:
        """Return the consistency of several flights together.

        Consistency and RMS errors are means over all instants of the flights, peak errors the largest of any flight.
        """
        n = np.array([c.count for c in several], dtype=float)
        n /= n.sum()
        mean = {k: float(n @ [getattr(c, k) for c in several]) for k in ("nees", "inside_share", "nis")}
        rms = {
            k: float(np.sqrt(n @ np.square([getattr(c, k) for c in several])))
            for k in ("xy_rms_m", "z_rms_m", "tilt_rms_rad", "yaw_rms_rad")
        }
        peak = {k: max(getattr(c, k) for c in several) for k in ("xy_peak_m", "z_peak_m", "tilt_peak_rad")}
        return cls(
            count=sum(one.count for one in several),
            block_nees=tuple((n @ np.array([one.block_nees for one in several])).tolist()),
            block_inside_shares=tuple((n @ np.array([one.block_inside_shares for one in several])).tolist()),
            **mean,
            **rms,
            **peak,
        )

    def format_row(self) -> str:
        """Return the errors (cm, degrees) and the consistency as one row of a table."""
        d = np.degrees
        cells = (
            f"{self.nees:.2f}", f"{100 * self.inside_share:.1f}", f"{100 * self.xy_rms_m:.1f}",
            f"{100 * self.xy_peak_m:.1f}", f"{100 * self.z_rms_m:.2f}", f"{100 * self.z_peak_m:.1f}",
            f"{d(self.tilt_rms_rad):.2f}", f"{d(self.tilt_peak_rad):.2f}", f"{d(self.yaw_rms_rad):.2f}",
            f"{self.nis:.2f}",
        )  # fmt: skip
        blocks = zip(self.block_nees, self.block_inside_shares, strict=True)
        return "".join(f"{c:>9s}" for c in cells) + "   " + ", ".join(f"{p:.2f} {100 * q:.1f} %" for p, q in blocks)


def measure_consistency(
    truths: Sequence[Truth], told: Sequence[Estimate], *, after_s: float = 0.0, every: int = 10
) -> Consistency:
    """Compare estimates with true states, and return the errors and the consistency of the covariance.

    Parameters
    ----------
    truths, told : sequences
        True and estimated states at the same instants.
    after_s : float
        Time before which instants are ignored (s).
    every : int
        NEES uses every ``every``-th instant.
    """
    true = np.array([np.concatenate([t.position, t.velocity, t.attitude]) for t in truths])
    return measure_row_consistency(true, told, after_s=after_s, every=every)


def measure_row_consistency(
    true: _Array, told: Sequence[Estimate], *, after_s: float = 0.0, every: int = 10
) -> Consistency:
    """Compare estimates with rows of true values, and return the errors and the consistency of the covariance.

    Parameters
    ----------
    true : (n, 9) array
        Position, velocity, attitude (m, m/s, rad). Components unknown throughout (NaN) are ignored.
    told, after_s, every
        As for :func:`measure_consistency`.

    Raises
    ------
    InputError
        If no instant has a valid estimate and a known truth.
    """
    known: Any = np.isfinite(true).any(axis=0)
    whole: Any = np.isfinite(true[:, known]).all(axis=1) & known.any()
    use = [k for k, e in enumerate(told) if e.valid and e.time_s >= after_s and whole[k]]
    if not use:
        raise InputError(
            "log", "", "has no instant at which truth is known and the estimate valid", "give a longer log"
        )
    said = np.array([np.concatenate([told[k].position, told[k].velocity, told[k].attitude]) for k in use])
    e = said - true[use]
    e[:, ERROR_ATTITUDE:] = np.angle(np.exp(1j * e[:, ERROR_ATTITUDE:]))
    some = e[::every]
    p = np.array([told[k].covariance[:ERROR_GYRO_BIAS, :ERROR_GYRO_BIAS] for k in use[::every]])
    nees = compute_normalised_squared_errors(some[:, known], p[:, known][:, :, known])
    blocks = [
        _measure_block_consistency(some[:, b], p[:, b, b]) if known[b].all() else _EMPTY_BLOCK_RESULT
        for b in ERROR_BLOCKS.values()
    ]
    ratios = []
    for k in use[::every]:
        b = told[k].auxiliary_states
        ratios += [c.ratio for c in b.checks if c.name == "position_fix"] if b else []
    xy, z, tilt = np.hypot(e[:, 0], e[:, 1]), np.abs(e[:, 2]), np.hypot(e[:, ERROR_ATTITUDE], e[:, ERROR_ATTITUDE + 1])
    count = int(known.sum())
    return Consistency(
        count=len(use),
        nees=float(nees.mean()) / count,
        inside_share=float(np.mean(nees < stats.chi2.ppf(0.95, count))),
        block_nees=tuple(b[0] for b in blocks),
        block_inside_shares=tuple(b[1] for b in blocks),
        nis=float(np.mean(np.square(ratios))) if ratios else np.nan,
        xy_rms_m=_root_mean_square(xy),
        xy_peak_m=float(xy.max()),
        z_rms_m=_root_mean_square(z),
        z_peak_m=float(z.max()),
        tilt_rms_rad=_root_mean_square(tilt),
        tilt_peak_rad=float(tilt.max()),
        yaw_rms_rad=_root_mean_square(e[:, ERROR_ATTITUDE + 2]),
    )


def _measure_block_consistency(errors: _Array, covariances: _Array) -> tuple[float, float]:
    """Return NEES / n of a block (k, n), and the share of its instants inside the 95 % ellipsoid."""
    nees, n = compute_normalised_squared_errors(errors, covariances), errors.shape[1]
    return float(nees.mean()) / n, float(np.mean(nees < stats.chi2.ppf(0.95, n)))


def _root_mean_square(x: _Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
