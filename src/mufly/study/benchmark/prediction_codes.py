"""Prediction codes of the benchmark: mufly's methods, and external codes by adapters.

A code is a function of a :class:`mufly.study.benchmark.RotorCase` that returns thrust (N) and torque (N m) of its
points, nan where it fails, and the reason. On the command line a code is one of:

* ``bemt``, ``wake``: this package's methods.
* ``cfd:DIR``: cases below a folder that ``mufly cfd`` has solved.
* ``module:name``: a Python function that takes a :data:`RotorDescription` and returns thrust and torque, arrays
  (points,).
* ``COMMAND``: a program with ``{folder}`` among its arguments. That folder contains ``blade.csv``, ``points.csv``, the
  contours of the sections and ``rotor.json`` (all inputs, SI units). The program writes ``answer.csv`` with the columns
  thrust_N, torque_Nm, a line for each point.
"""

from __future__ import annotations

import csv
import importlib
import json
import math
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.cfd import read_operating_point, read_solution
from mufly.errors import InputError, MuflyError
from mufly.files.text_table import read_text_table
from mufly.quantities.units import RPM
from mufly.rotor import SolverMethod, compare_measurements, load_airfoil, prepare_blading
from mufly.study.benchmark.rotor_cases import RotorCase

Array = NDArray[np.float64]

RotorDescription = dict[str, Any]
"""Dictionary of a rotor and its points.

* name, blades, radius_m, hub_radius_m, trailing_edge_m.
* (stations,) lists r_m, chord_m, twist_rad, airfoils (names).
* contours: name to (n, 2) list, Selig order.
* (points,) lists pitch_rad, speed_rad_s, climb_m_s (along the shaft).
* turbulence of the tunnel: rms over mean speed; None in hover.
* density_kg_m3, viscosity_Pa_s, sound_m_s.
"""


@dataclass(frozen=True, eq=False)
class RotorPrediction:
    """Predicted thrust (N) and torque (N m) of a case's points, (points,) arrays, nan where the code failed, and the
    reason of the failure.
    """

    thrust_N: Array
    torque_Nm: Array
    fault: str = ""


@dataclass(frozen=True)
class PredictionCode:
    """Prediction code: name, function, whether a point takes seconds, and the inputs that identify its stored
    predictions.
    """

    name: str
    predict: Callable[[RotorCase], RotorPrediction]
    is_slow: bool = False
    cache_settings: str = ""


def parse_code(text: str, *, n_crit: float | None = None, limit_s: float = 600.0) -> PredictionCode:
    """Return the prediction code that a text ``[NAME=]WHAT`` names; WHAT is a method, a Python function or a program.

    ``n_crit`` is the transition parameter of mufly's methods. The default is :data:`HOVER_N_CRIT` in hover, where a
    rotor works in its own turbulent wake, and in a tunnel the value for the tunnel's turbulence
    (:func:`compute_n_crit_from_turbulence`).

    Raises
    ------
    InputError
        If the text names no code, or the function cannot be imported.
    """
    name, equals, what = text.partition("=")
    if not equals or not name.replace("-", "_").isidentifier():
        name, what = "", text
    what = what.strip()
    if what in ("bemt", "wake"):
        how = f"n_crit {'by the air' if n_crit is None else n_crit}"
        method: SolverMethod = "wake" if what == "wake" else "bemt"
        return PredictionCode(name or what, _make_mufly_code(method, n_crit), what == "wake", how)
    if "{folder}" in what:
        return PredictionCode(
            name or Path(shlex.split(what)[0]).name, lambda case: _predict_by_command(what, case, limit_s)
        )
    module, colon, function = what.partition(":")
    if module == "cfd" and colon:
        return PredictionCode(name or "cfd", lambda case: _read_solved_cases(Path(function), case))
    if not colon or not all(part.isidentifier() for part in (*module.split("."), function)):
        raise InputError(
            "--code",
            text,
            "is not a known prediction code",
            "use bemt, wake, cfd:DIR, module:function, or a command with {folder} among its words",
        )
    sys.path.insert(0, "") if "" not in sys.path else None
    try:
        found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise InputError("--code", text, f"cannot be imported ({error})", "check PYTHONPATH and the name") from None
    return PredictionCode(name or function, lambda case: _predict_by_function(found, what, case))


def _strip_contour_path(airfoil: str) -> str:
    """Return an airfoil's name; that of a contour file is the file's name without folder and ending."""
    return Path(airfoil).stem if Path(airfoil).is_file() else airfoil


def make_rotor_description(case: RotorCase) -> RotorDescription:
    """Return the description of a case for an external code."""
    r, blade = case.rotor, case.rotor.blade
    x = np.unique(
        np.clip(np.concatenate(([float(r.hub_cutout)], blade.r_over_R.to_si_array())), float(r.hub_cutout), 1.0)
    )
    cut = r.sections_at(x)
    names = [
        cut.airfoil_names[int(k)] for k in np.where(cut.second_weight < 0.5, cut.first_airfoil, cut.second_airfoil)
    ]
    return {
        "name": case.name,
        "blades": r.blades,
        "radius_m": r.radius_m,
        "hub_radius_m": r.hub_radius_m,
        "r_m": (x * r.radius_m).tolist(),
        "chord_m": r.chord_m(x).tolist(),
        "twist_rad": r.twist_rad(x).tolist(),
        "trailing_edge_m": float(r.trailing_edge),
        "airfoils": [_strip_contour_path(n) for n in names],
        "contours": {_strip_contour_path(n): load_airfoil(n).coordinates.tolist() for n in dict.fromkeys(names)},
        "pitch_rad": case.measured.pitch_rad.tolist(),
        "speed_rad_s": case.measured.speed_rad_s.tolist(),
        "climb_m_s": case.measured.climb_m_s.tolist(),
        "turbulence": case.turbulence_intensity if case.measured.has_axial_flow else None,
        "density_kg_m3": case.air.density_kg_m3,
        "viscosity_Pa_s": case.air.viscosity_Pa_s,
        "sound_m_s": case.air.sound_m_s,
    }


HOVER_N_CRIT = 0.1


def compute_n_crit_from_turbulence(turbulence: float) -> float:
    """Return the n_crit of a stream with turbulence Tu (rms over mean speed): -8.43 - 2.4 ln Tu (Mack, AGARD R-709,
    1984).

    The formula is valid from 0.07 to 2.98 %, where it is 0.
    """
    return -8.43 - 2.4 * math.log(min(max(turbulence, 7e-4), 0.0298))


def _make_mufly_code(method: SolverMethod, n_crit: float | None) -> Callable[[RotorCase], RotorPrediction]:
    def predict_case(case: RotorCase) -> RotorPrediction:
        chosen = n_crit
        if chosen is None:
            chosen = (
                compute_n_crit_from_turbulence(case.turbulence_intensity)
                if case.measured.has_axial_flow
                else HOVER_N_CRIT
            )
        out = compare_measurements(
            prepare_blading(case.rotor, n_crit=chosen), case.measured, air=case.air, method=method
        )
        return RotorPrediction(
            out.thrust_N, out.torque_Nm, "; ".join(dict.fromkeys(f for f in out.prediction_faults if f))
        )

    return predict_case


def _read_solved_cases(folder: Path, case: RotorCase) -> RotorPrediction:
    """Return the results of solved OpenFOAM cases below a folder at a rotor's points, matched within 0.5 %."""
    if not folder.is_dir():
        raise InputError("--code", f"cfd:{folder}", "is not a folder", "name one that holds cases of `mufly cfd run`")
    m = case.measured
    thrust, torque = (np.full(m.thrust_N.size, math.nan) for _ in range(2))
    faults = []
    for mesh in sorted(folder.rglob("constant/polyMesh")):
        at = mesh.parent.parent
        try:
            point = read_operating_point(at)
            same = (
                (point.rotor == case.rotor.name)
                & (np.abs(m.speed_rad_s / point.speed_rad_s - 1.0) < 5e-3)
                & (np.abs(m.pitch_rad - point.pitch_rad) < 1e-3)
            )
            if same.any():
                found = read_solution(at)
                thrust[same], torque[same] = found.thrust_N, found.torque_Nm
        except MuflyError as error:
            faults.append(f"{at.name}: {error}")
    return RotorPrediction(thrust, torque, "; ".join(faults))


def _predict_by_function(function: Callable[[RotorDescription], Any], label: str, case: RotorCase) -> RotorPrediction:
    try:
        return _check_prediction(function(make_rotor_description(case)), label, case)
    except Exception as error:  # an external code may raise any exception on one rotor and work for the next
        return _failed_prediction(case, f"{type(error).__name__}: {error}")


def _failed_prediction(case: RotorCase, fault: str) -> RotorPrediction:
    nothing = np.full(case.measured.thrust_N.size, math.nan)
    return RotorPrediction(nothing, nothing.copy(), " ".join(fault.split())[:200])


def _check_prediction(answer: Any, label: str, case: RotorCase) -> RotorPrediction:
    thrust, torque = (np.asarray(v, dtype=np.float64).ravel() for v in answer)
    n = case.measured.thrust_N.size
    if thrust.size != n or torque.size != n:
        raise MuflyError(f"{label} gave {thrust.size} and {torque.size} numbers for {n} points")
    return RotorPrediction(thrust, torque)


def _predict_by_command(command: str, case: RotorCase, limit_s: float) -> RotorPrediction:
    question = make_rotor_description(case)
    with tempfile.TemporaryDirectory(prefix="mufly-benchmark-") as name:
        folder = Path(name)
        (folder / "rotor.json").write_text(json.dumps(question), encoding="utf-8")
        blade = zip(question["r_m"], question["chord_m"], question["twist_rad"], question["airfoils"], strict=True)
        rows = [(r, c, math.degrees(t), foil) for r, c, t, foil in blade]
        _write_input_csv(folder / "blade.csv", ("r_m", "chord_m", "twist_deg", "airfoil"), rows)
        points = zip(question["pitch_rad"], question["speed_rad_s"], question["climb_m_s"], strict=True)
        _write_input_csv(
            folder / "points.csv", ("pitch_deg", "speed_rpm", "climb_m_s"),
            [(math.degrees(p), s / RPM, v) for p, s, v in points],
        )  # fmt: skip
        for foil, xy in question["contours"].items():
            lines = "\n".join(f"{x:.6f} {y:.6f}" for x, y in xy)
            (folder / f"{foil}.dat").write_text(f"{foil}\n{lines}\n", encoding="utf-8")
        words = [w.replace("{folder}", name) for w in shlex.split(command)]
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=limit_s, errors="replace")
        except (OSError, subprocess.TimeoutExpired) as error:
            return _failed_prediction(case, str(error))
        if done.returncode:
            last = (done.stderr.strip().splitlines() or done.stdout.strip().splitlines() or ["no word"])[-1]
            return _failed_prediction(case, f"ended with status {done.returncode}: {last}")
        try:
            answer = read_text_table(folder / "answer.csv")
            found = [answer.read_numbers(answer.find_column_index(n), optional=True) for n in ("thrust_N", "torque_Nm")]
            return _check_prediction(np.array(found), words[0], case)
        except MuflyError as error:
            return _failed_prediction(case, str(error).replace(f"{folder}/", ""))


def _write_input_csv(path: Path, heads: tuple[str, ...], rows: list[tuple[Any, ...]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(heads)
        writer.writerows(rows)
