"""Two engines on the same sections: how far NeuralFoil and XFOIL lie apart.

python benchmarks/validate_polars.py            # the table of docs/log/2026-11-28-polars.md; needs xfoil
python benchmarks/validate_polars.py e387 goe394
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mufly.errors import MuflyError
from mufly.rotor import load_airfoil
from mufly.rotor.sections.neuralfoil_network import compute_neuralfoil_polars
from mufly.rotor.sections.polar_engines import compute_xfoil_polars

SECTIONS = ("naca0012", "naca4412", "goe394", "goe342", "gm15sm", "e387", "clarky", "s1223")
REYNOLDS = (1e4, 3e4, 1e5)
N_CRIT = (0.1, 9.0)
LOWEST_DEG, HIGHEST_DEG = -2.0, 12.0


@dataclass(frozen=True)
class Difference:
    """NeuralFoil minus XFOIL over the angles at which XFOIL converged.

    Attributes
    ----------
    name, n_crit, reynolds
        The case.
    angles : int
        Whole degrees from -2 to 12 at which XFOIL converged, of 15.
    cl_mean, cl_max : float
        Mean and greatest absolute difference in lift.
    ln_cd_mean, ln_cd_max : float
        The same for the logarithm of drag: 0.02 is 2 %.
    """

    name: str
    n_crit: float
    reynolds: float
    angles: int
    cl_mean: float
    cl_max: float
    ln_cd_mean: float
    ln_cd_max: float


def crosscheck(
    names: Sequence[str] = SECTIONS,
    *,
    n_crit: Sequence[float] = N_CRIT,
    reynolds: Sequence[float] = REYNOLDS,
    model: str = "xlarge",
) -> Iterator[Difference]:
    """Compare the engines on sections by name.

    Yields
    ------
    Difference
        One for each section, n_crit and Reynolds number.

    Raises
    ------
    MuflyError
        If XFOIL is not installed, or converges nowhere on a case.
    """
    alpha_deg = np.arange(LOWEST_DEG, HIGHEST_DEG + 0.5)
    for name in names:
        airfoil = load_airfoil(name)
        for n in n_crit:
            ours = compute_neuralfoil_polars([airfoil], reynolds, n_crit=n, model=model)[0]
            same = np.isin(np.round(np.rad2deg(ours.alpha_rad), 6), alpha_deg)
            theirs = compute_xfoil_polars(airfoil, reynolds, n_crit=n, alpha_deg=alpha_deg)
            for j, re in enumerate(reynolds):
                known = theirs.known[j]
                cl = np.abs(ours.cl[j, same] - theirs.cl[j])[known]
                cd = np.abs(np.log(ours.cd[j, same][known] / theirs.cd[j, known]))
                yield Difference(
                    name,
                    n,
                    re,
                    int(known.sum()),
                    float(cl.mean()),
                    float(cl.max()),
                    float(cd.mean()),
                    float(cd.max()),
                )


def main() -> int:
    """Print the comparison of the sections named on the command line as a Markdown table."""
    print("| section | n_crit |" + "".join(f" Re {re:.0f} |" for re in REYNOLDS))
    print("|---|---|" + "---|" * len(REYNOLDS))
    rows: list[Difference] = []
    try:
        for d in crosscheck(sys.argv[1:] or SECTIONS):
            rows.append(d)
            if d.reynolds == REYNOLDS[-1]:
                cells = " | ".join(_cell(r) for r in rows[-len(REYNOLDS) :])
                print(f"| {d.name} | {d.n_crit:g} | {cells} |", flush=True)
    except MuflyError as error:
        print(error, file=sys.stderr)
        return 1
    for n in N_CRIT:
        part = [d for d in rows if d.n_crit == n]
        cl, cd = np.array([d.cl_mean for d in part]), np.array([d.ln_cd_mean for d in part])
        print(
            f"\nn_crit {n:g}: c_l differs by {cl.mean():.4f} in the mean of the cases, {np.median(cl):.4f} in the "
            f"median; c_d by {100 * cd.mean():.1f} % and {100 * np.median(cd):.1f} %"
        )
    return 0


def _cell(d: Difference) -> str:
    missing = f" ({d.angles} of 15)" if d.angles < 15 else ""
    return f"{d.cl_mean:.3f}, {100 * d.ln_cd_mean:.1f} %{missing}"


if __name__ == "__main__":
    raise SystemExit(main())
