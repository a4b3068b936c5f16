"""Sweeps of coaxial pairs: the grid of :mod:`mufly.study.sweep` over spacing, speeds, pitches and blades.

By the wake method one case is solved at a time, on all cores, from the wake of the case before (see
:mod:`mufly.study.evaluate_wake`), and is kept as soon as it is there. A case that fails holds nan and its reason.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from mufly.errors import InputError, MuflyError
from mufly.rotor.wake import WakeSettings, WakeSolution
from mufly.study.evaluate import Case, Results
from mufly.study.evaluate_wake import WAKE_LOCK, remember
from mufly.study.pair import PairPoint, PairSetup, check_pair, solve_pair
from mufly.study.parameters import Value
from mufly.study.setup import WAKE_OUTPUTS
from mufly.study.sweep import Progress, contours_of, dataset, grid
from mufly.version import __version__

__all__ = ["PAIR_OUTPUTS", "evaluate_pairs", "sweep_pairs"]

_EACH = {
    "thrust_N": ("N", "thrust of the {} rotor"),
    "torque_Nm": ("N m", "torque of the {} rotor"),
    "power_W": ("W", "power of the {} rotor"),
    "speed_rad_s": ("rad/s", "speed of the {} rotor"),
    "pitch_rad": ("rad", "pitch setting of the {} rotor"),
    "c_T": ("1", "c_T of the {} rotor"),
    "c_Q": ("1", "c_Q of the {} rotor"),
    "outside_share": ("1", "share of the {} rotor's thrust from sections beyond the polar's range"),
}
PAIR_OUTPUTS: dict[str, tuple[str, str]] = {
    "thrust_N": ("N", "thrust of the pair"),
    "power_W": ("W", "mechanical power of the pair"),
    "yaw_torque_Nm": ("N m", "torque of the lower less that of the upper rotor"),
    "figure_of_merit": ("1", "figure of merit of the pair, one disc"),
    "thrust_ratio": ("1", "lower over upper thrust"),
    "torque_ratio": ("1", "lower over upper torque"),
    **{
        f"{side}_{key}": (unit, text.format(side))
        for side in ("upper", "lower")
        for key, (unit, text) in _EACH.items()
    },
    "iterations": ("1", "iterations of the last wake"),
    **WAKE_OUTPUTS,
}

_CHUNK = 16  # cases by blade elements
_LAST: dict[WakeSettings, WakeSolution] = {}


def _row(point: PairPoint) -> dict[str, float]:
    up, low = point.upper, point.lower
    row = {
        "thrust_N": point.thrust_N,
        "power_W": point.power_W,
        "yaw_torque_Nm": point.yaw_torque_Nm,
        "figure_of_merit": point.figure_of_merit,
        "thrust_ratio": low.thrust_N / up.thrust_N,
        "torque_ratio": low.torque_Nm / up.torque_Nm,
        "iterations": float(point.solution.iterations) if point.solution is not None else np.nan,
        "core_limit": np.nan,
    }
    if point.solution is not None and point.solution.settings.core_limit is not None:
        row["core_limit"] = point.solution.settings.core_limit
    for side, r in (("upper", up), ("lower", low)):
        row |= {f"{side}_{key}": float(getattr(r, key)) for key in _EACH}
    return row


def _solved(setup: PairSetup, case: Case) -> PairPoint:
    """A case, from the last wake if there is one, afresh if that does not converge."""
    if setup.method != "wake":
        return solve_pair(setup, case)
    with WAKE_LOCK:
        known = _LAST.get(setup.wake)
        point: PairPoint | None = None
        if known is not None:
            try:
                point = solve_pair(setup, case, start=known)
            except InputError:
                raise
            except MuflyError:
                point = None
        if point is None or not point.converged:
            point = solve_pair(setup, case)
        if not point.converged:
            raise MuflyError(f"wake {point.message}")
        assert point.solution is not None
        remember(_LAST, setup.wake, point.solution)
        return point


def evaluate_pairs(setup: PairSetup, cases: Sequence[Case]) -> Results:
    """Solve cases of a pair; one that fails gets nan and its reason.

    Raises
    ------
    InputError
        If the parameters make no sense together.
    """
    check_pair(setup, list(cases[0]) if cases else [])
    out = Results({name: np.full(len(cases), np.nan) for name in PAIR_OUTPUTS}, [""] * len(cases))
    for k, case in enumerate(cases):
        try:
            row = _row(_solved(setup, case))
        except MuflyError as error:
            out.fault[k] = str(error)
            continue
        for name, value in row.items():
            out.values[name][k] = value
    return out


def sweep_pairs(
    setup: PairSetup,
    vary: Mapping[str, Sequence[Value]],
    *,
    folder: str | Path | None = None,
    progress: Progress | None = None,
    cluster: str | None = None,
) -> xr.Dataset:
    """Evaluate every combination; arguments as for :func:`mufly.study.sweep`, parameters as in ``parameters.PAIR``.

    Returns
    -------
    xarray.Dataset
        Variables :data:`PAIR_OUTPUTS` with units, and ``fault``.

    Raises
    ------
    InputError
        If parameters make no sense together, a value is listed twice, or the folder holds another sweep.
    """
    names, values = list(vary), [list(v) for v in vary.values()]
    both = [n for n in names if n in setup.fixed]
    setup = replace(setup, fixed={k: v for k, v in setup.fixed.items() if k not in both})
    check_pair(setup, names)
    for name, listed in zip(names, values, strict=True):
        if not listed or len(set(listed)) != len(listed):
            raise InputError("coaxial", name, "lists a value twice, or none", "give each value once")
    chunk = 1 if setup.method == "wake" else _CHUNK
    content = {
        "version": __version__,
        "pair": [setup.upper.model_dump(mode="json"), setup.lower.model_dump(mode="json")],
        "fixed": dict(sorted(setup.fixed.items())),
        "method": [setup.method, setup.free, setup.stations, vars(setup.wake)],
        "corrections": vars(setup.corrections),
        "polars": [setup.engine, setup.model],
        "vary": [names, values],
        "contours": contours_of([*setup.upper.airfoil_names(), *setup.lower.airfoil_names()]),
    }
    question = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    parts = grid(
        evaluate_pairs, setup, names, values, chunk, question, folder=folder, progress=progress, cluster=cluster,
        workers=1 if setup.method == "wake" else None,
    )  # fmt: skip
    attributes = {
        "rotor": f"{setup.upper.name} over {setup.lower.name}",
        "fixed": json.dumps(dict(setup.fixed), sort_keys=True),
        "method": setup.method if setup.method == "bemt" else f"wake, {setup.wake.model}",
        "balanced_by": setup.free,
        "polars": f"{setup.engine} {setup.model}",
        "corrections": json.dumps(vars(setup.corrections)),
        "mufly": __version__,
    }
    return dataset(PAIR_OUTPUTS, names, values, parts, attributes)
