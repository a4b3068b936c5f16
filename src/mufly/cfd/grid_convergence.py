"""Grid convergence: observed order and grid convergence index of three meshes.

Celik and others, *Procedure for estimation and reporting of uncertainty due to discretization in CFD applications*, J.
Fluids Eng. 130 (2008) 078001. With cells of mean size h1 < h2 < h3 (finest first), results phi and their differences
e::

    p = |ln|e32 / e21| + q(p)| / ln r21,   q = ln((r21^p - s) / (r32^p - s)),   s = sign(e32 / e21),  r = ratios of h
    phi_ext = (r21^p phi1 - phi2) / (r21^p - 1)
    GCI = 1.25 |phi1 - phi2| / |phi1| / (r21^p - 1)

The procedure requires monotonic convergence. If the results oscillate (s = -1), or the order exceeds that of a
second-order scheme, order and index are returned but marked as unreliable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from mufly.cfd.meshes.polymesh import read_poly_mesh
from mufly.cfd.openfoam_case import read_operating_point
from mufly.cfd.solver_process import judge_case_convergence
from mufly.errors import InputError
from mufly.results import ResultColumn, ShownTable, result, tabulate_results

_CONVERGENCE_ORDER_RANGE = (0.5, 3.0)
_MAX_ORDER_ITERATIONS = 200


@result
class GridConvergence:
    """Grid convergence of a quantity on three meshes, the finest first.

    Attributes
    ----------
    name : str
        Name of the quantity.
    cells : tuple of int
        Numbers of cells.
    values : tuple of float
        Results.
    order : float
        Observed order; nan if the results agree to rounding.
    extrapolated_value : float
        Extrapolated result phi_ext.
    index : float
        Grid convergence index of the finest mesh, relative.
    last_step : float
        Relative change from the middle to the finest mesh.
    sound : bool
        True if convergence is monotonic with a possible order.
    """

    name: str
    cells: tuple[int, ...]
    values: tuple[float, ...]
    order: float
    extrapolated_value: float
    index: float
    last_step: float
    sound: bool


def tabulate_grid_convergence(found: Sequence[GridConvergence]) -> ShownTable:
    """Return the convergence of several quantities on the same meshes as a table."""
    meshes = [ResultColumn(f"values.{k}", form=".5g", head=f"{found[0].cells[k]} cells") for k in (2, 1, 0)]
    columns = [
        *meshes, ResultColumn("last_step", "%", "+.2g"), ResultColumn("order", form=".2f"),
        ResultColumn("extrapolated_value", form=".5g", head="limit"), ResultColumn("index", "%", ".2g"),
        ResultColumn("sound", head="reliable"),
    ]  # fmt: skip
    return tabulate_results(found, columns, names=[c.name for c in found])


def estimate_grid_convergence(name: str, cells: Sequence[int], values: Sequence[float]) -> GridConvergence:
    """Compute observed order and grid convergence index.

    Parameters
    ----------
    name : str
    cells : three int
        Numbers of cells of three meshes of the same volume, in any order.
    values : three float
        Results on these meshes.

    Raises
    ------
    InputError
        If there are not three meshes, or two have the same number of cells.
    """
    if len(cells) != 3 or len(values) != 3 or len(set(cells)) != 3:
        raise InputError(
            "mesh", name, f"there are {len(set(cells))} different meshes", "give three cases with different meshes"
        )
    (n1, v1), (n2, v2), (n3, v3) = sorted(zip(cells, values, strict=True), reverse=True)
    r21, r32 = (n1 / n2) ** (1 / 3), (n2 / n3) ** (1 / 3)
    e21, e32 = v2 - v1, v3 - v2
    last = (v1 - v2) / abs(v2)
    if e21 == 0.0 or e32 == 0.0:
        return GridConvergence(name, (n1, n2, n3), (v1, v2, v3), math.nan, v1, math.nan, last, False)
    s = math.copysign(1.0, e32 / e21)
    p = 1.0
    for _ in range(_MAX_ORDER_ITERATIONS):
        up, low = r21**p - s, r32**p - s
        q = math.log(up / low) if up > 0.0 and low > 0.0 else 0.0
        new = abs(math.log(abs(e32 / e21)) + q) / math.log(r21)
        new = min(max(new, 1e-3), 20.0)
        if abs(new - p) < 1e-10:
            break
        p = 0.5 * (p + new)
    gain = r21**p - 1.0
    return GridConvergence(
        name, (n1, n2, n3), (v1, v2, v3), p, (r21**p * v1 - v2) / gain, 1.25 * abs((v1 - v2) / v1) / gain, last,
        s > 0.0 and _CONVERGENCE_ORDER_RANGE[0] <= p <= _CONVERGENCE_ORDER_RANGE[1],
    )  # fmt: skip


def estimate_load_grid_convergence(cases: Sequence[Path]) -> tuple[GridConvergence, GridConvergence]:
    """Compute the grid convergence of thrust and torque from three converged cases of the same point.

    Raises
    ------
    InputError
        If there are not three cases, they differ in more than the mesh, or one has not converged.
    """
    points = [read_operating_point(case) for case in cases]
    for case, point in zip(cases, points, strict=True):
        for key in (
            "rotor",
            "pitch_rad",
            "speed_rad_s",
            "climb_m_s",
            "model",
            "density_kg_m3",
            "viscosity_Pa_s",
            "tip",
            "hub_m",
            "gurney",
            "domain",
        ):
            if getattr(point, key) != getattr(points[0], key):
                raise InputError(
                    str(case), key, f"is {getattr(point, key)}, not {getattr(points[0], key)}",
                    "give cases that differ in their meshes only",
                )  # fmt: skip
    verdicts = [judge_case_convergence(case) for case in cases]
    for case, verdict in zip(cases, verdicts, strict=True):
        if not verdict.settled:
            raise InputError(str(case), "", f"is not steady: {verdict.outcome}", "continue its run, or omit it")
    cells = [read_poly_mesh(case).cell_count for case in cases]
    return (
        estimate_grid_convergence("thrust", cells, [v.thrust_N for v in verdicts]),
        estimate_grid_convergence("torque", cells, [v.torque_Nm for v in verdicts]),
    )
