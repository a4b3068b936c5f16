"""Runs of the solver as a separate process: monitoring, convergence verdict and resumption.

The solver runs in stages: 80 iterations upwind, then second order to 1200 iterations, then by 400 until thrust and
torque converge, at most to 2800. Every 40 iterations it writes its state with the fluxes; an interrupted case resumes
from that state and repeats the later iterations.

A solution is settled if, after at least 1200 iterations,

* thrust and torque of the last 400 iterations drift by less than 0.3 % (linear fit, end to end) and
  their range about that line is below 1 %. Shorter windows fail, because thrust can be constant for 200 to 300
  iterations at a level 3 to 4 % below its final value;
* air leaves through the bottom (not required in descent);
* the solver's sum of local continuity errors (mean of |div u| over the volume, 1/s; median of the last iterations) is
  below 1e-3.

Otherwise the verdict names the fault: ``diverged`` (a load that is no number, or ten times the first guess),
``sloshing`` (oscillation about the mean), ``plateau`` (still drifting), ``blown back`` (air enters through the bottom),
``leaking`` (continuity).
"""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.openfoam_case import (
    LOAD_FUNCTION_OBJECTS,
    STATE_WRITE_ITERATIONS,
    OperatingPoint,
    read_operating_point,
    set_schemes_and_end,
)
from mufly.cfd.rotor_pair import read_actuator_disc
from mufly.errors import MuflyError
from mufly.results import result

Array = NDArray[np.float64]

MAX_ITERATIONS, ASSESSMENT_WINDOW_ITERATIONS = 2800, 400
"""Greatest number of iterations, and length of the window for the verdict."""
_MAX_LOAD_DRIFT, _MAX_LOAD_SWING, _MAX_CONTINUITY_ERROR = 3e-3, 1e-2, 1e-3
_DEBIAN_OPENFOAM_FOLDER = Path("/usr/share/openfoam")
_LOG_FILE = "log.simpleFoam"


@dataclass(frozen=True)
class SolverProgress:
    """Progress of a solver run at one iteration.

    Attributes
    ----------
    iteration : int
    thrust_N, torque_Nm : float
        Thrust and torque of the whole rotor.
    residuals : dict of str to float
        Initial residual of each equation in this iteration.
    continuity : float
        Sum of local continuity errors reported by the solver.
    seconds_left : float
        Estimated time to the end of the stage.
    """

    iteration: int
    thrust_N: float
    torque_Nm: float
    residuals: dict[str, float]
    continuity: float
    seconds_left: float


@result
class ConvergenceAssessment:
    """Convergence verdict on a solution.

    Attributes
    ----------
    settled : bool
        True if the solution has converged.
    outcome : str
        'settled', or the name of the fault.
    iterations : int
        Number of iterations.
    thrust_N : float
        Thrust of the whole rotor, mean of the window.
    torque_Nm : float
        Torque of the whole rotor, mean of the window.
    drift : float
        Greater relative drift of thrust and torque in the window.
    swing : float
        Greater relative range of thrust and torque about their drift.
    outflow_m3_s : float
        Volume flow out of the sector's bottom.
    leak : float
        The solver's sum of local continuity errors, median of the last iterations.
    """

    settled: bool
    outcome: str
    iterations: int
    thrust_N: float
    torque_Nm: float
    drift: float
    swing: float
    outflow_m3_s: float
    leak: float


def find_solver(name: str = "simpleFoam") -> str:
    """Return the path of the solver's executable.

    Raises
    ------
    MuflyError
        If OpenFOAM is not installed; the message states how to install it.
    """
    found = shutil.which(name)
    if found is None:
        raise MuflyError(
            f"{name} was not found: install OpenFOAM (Debian, Ubuntu: apt-get install --no-install-recommends "
            "openfoam; elsewhere: openfoam.com) or use --save-only and run the case where it is"
        )
    return found


def openfoam_environment() -> dict[str, str]:
    """Return the environment in which OpenFOAM's programs find their own files."""
    env = dict(os.environ)
    if "WM_PROJECT_DIR" not in env and _DEBIAN_OPENFOAM_FOLDER.is_dir():
        env["WM_PROJECT_DIR"] = str(_DEBIAN_OPENFOAM_FOLDER)
    return env


def list_complete_states(folder: Path) -> list[int]:
    """Return the iterations with a complete written state, increasing; 0 is the start."""
    found = []
    for place in folder.glob("[0-9]*"):
        if place.name.isdigit():
            names = ("U", "p") if place.name == "0" else ("U", "p", "phi")
            if all(_is_field_file_complete(place / name) for name in names):
                found.append(int(place.name))
    return sorted(found)


def list_processor_states(folder: Path) -> list[int]:
    """Return the iterations with a complete state in every part of a parallel run, increasing."""
    of = [set(list_complete_states(place)) for place in folder.glob("processor[0-9]*")]
    return sorted(set.intersection(*of)) if of else []


def _is_field_file_complete(file: Path) -> bool:
    """Return True if a field's file is complete; a full disk or a killed process truncates it."""
    try:
        with file.open("rb") as f:
            f.seek(max(0, f.seek(0, 2) - 200))
            return f.read().rstrip().endswith((b"}", b"//"))
    except OSError:
        return False


def run_case(
    folder: Path,
    *,
    cores: int = 1,
    progress: Callable[[SolverProgress], None] | None = None,
    most: int = MAX_ITERATIONS,
) -> ConvergenceAssessment:
    """Run a case until its convergence verdict; an interrupted case resumes from its last written state.

    Parameters
    ----------
    folder : Path
        A case of :func:`mufly.cfd.openfoam_case.write_case`.
    cores : int
        Number of processes.
    progress : callable, optional
        Called after each iteration.
    most : int
        Greatest number of iterations.

    Raises
    ------
    MuflyError
        If there is no solver, the solver fails (the message contains its first error), the disk is full, or another run
        uses this case.

    Thesis: Sec. 3.3.3.
    """
    find_solver()
    point = _point_for_assessment(folder)
    verdict, done = _judge_rotors(folder, point)
    if _is_finished(verdict, done, most):
        return verdict
    try:
        with (folder / _LOG_FILE).open("a", encoding="utf-8") as log:
            _lock_case(log, folder)
            _reconstruct_state(folder, done)
            verdict, done = _judge_rotors(folder, point)
            while not _is_finished(verdict, done, most):
                end = (
                    point.upwind
                    if done < point.upwind
                    else min(most, max(point.least, done + ASSESSMENT_WINDOW_ITERATIONS))
                )
                end = STATE_WRITE_ITERATIONS * math.ceil(
                    end / STATE_WRITE_ITERATIONS
                )  # so that the last state is written
                set_schemes_and_end(folder, upwind=done < point.upwind, end=end)
                _remove_partial_states(folder, done)
                _run_solver(folder, log, done, end, cores, progress)
                verdict, done = _judge_rotors(folder, point)
    except BrokenPipeError:
        raise  # the reader of the progress is closed
    except OSError as error:
        raise MuflyError(
            f"{error.filename or folder}: cannot be written ({error.strerror}): free disk space; the written state "
            "is kept, and the same command resumes"
        ) from error
    return verdict


def _judge_rotors(folder: Path, point: OperatingPoint) -> tuple[ConvergenceAssessment, int]:
    """Return the convergence verdict of a rotor that has not settled, or of the first rotor if all have, and the
    iteration of the last state.
    """
    done = (list_complete_states(folder) or [0])[-1]
    return min(
        (judge_case_convergence(folder, patch=name) for name in point.patch_speeds_rad_s), key=lambda v: v.settled
    ), done


def _is_finished(verdict: ConvergenceAssessment, done: int, most: int) -> bool:
    return verdict.settled or done >= most or verdict.outcome == "diverged"


def _lock_case(log: IO[str], folder: Path) -> None:
    """Lock a case against a second run while the log is open; the lock ends with the process."""
    try:
        from fcntl import LOCK_EX, LOCK_NB, flock
    except ImportError:  # on systems without OpenFOAM
        return
    try:
        flock(log, LOCK_EX | LOCK_NB)
    except BlockingIOError as error:
        raise MuflyError(f"{folder}: another run uses this case: wait for its end, or give another --out") from error


def _reconstruct_state(folder: Path, done: int) -> None:
    """Reconstruct the last state of a killed parallel run from its parts."""
    last = max(list_processor_states(folder), default=0)
    if last > done:
        _run_utility(folder, ("reconstructPar", "-time", str(last)), openfoam_environment())


def _remove_partial_states(folder: Path, after: int) -> None:
    """Remove truncated states, because the solver starts from the last folder with a number as name."""
    whole = list_complete_states(folder)
    for place in folder.glob("[0-9]*"):
        if place.name.isdigit() and int(place.name) > after and int(place.name) not in whole:
            shutil.rmtree(place, ignore_errors=True)


def _run_solver(
    folder: Path,
    log: IO[str],
    done: int,
    end: int,
    cores: int,
    progress: Callable[[SolverProgress], None] | None,
) -> None:
    env = openfoam_environment()
    if cores > 1:
        _run_utility(folder, ("decomposePar", "-force", "-latestTime"), env)
        command = [
            "mpirun",
            "--allow-run-as-root",
            "--oversubscribe",
            "-np",
            str(cores),
            "simpleFoam",
            "-parallel",
        ]
    else:
        command = ["simpleFoam"]
    began = time.monotonic()
    residuals: dict[str, float] = {}
    iteration, continuity = done, math.nan
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )
    assert process.stdout is not None
    try:
        for line in process.stdout:
            log.write(line)
            if line.startswith("Time = "):
                iteration = int(float(line.split()[2]))
            elif found := _RESIDUAL_LINE_PATTERN.search(line):
                residuals[found[1]] = float(found[2])
            elif found := _CONTINUITY_LINE_PATTERN.search(line):
                continuity = float(found[1])
            elif line.startswith("ExecutionTime") and progress is not None:
                loads = read_load_history(folder, last=1)
                spent = time.monotonic() - began
                left = spent / max(iteration - done, 1) * (end - iteration)
                thrust, torque = (loads[-1, 1], loads[-1, 2]) if len(loads) else (math.nan, math.nan)
                progress(SolverProgress(iteration, thrust, torque, dict(residuals), continuity, left))
    except BaseException:
        process.terminate()
        process.wait()
        raise
    status = process.wait()
    log.flush()
    if status:
        if iteration > done and "Floating point" in _read_tail(folder / _LOG_FILE):
            return  # judged as diverged
        if status < 0:
            raise MuflyError(
                f"simpleFoam was killed (signal {-status}) at iteration {iteration}: its written state is "
                "kept, and the same command resumes"
            )
        raise MuflyError(
            f"simpleFoam ended with status {status}: {_find_error_text(folder / _LOG_FILE)}; see {folder / _LOG_FILE}"
        )
    if cores > 1:
        _run_utility(folder, ("reconstructPar", "-latestTime"), env)


def _run_utility(folder: Path, command: tuple[str, ...], env: dict[str, str]) -> None:
    find_solver(command[0])
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, errors="replace")
    (folder / f"log.{command[0]}").write_text(done.stdout + done.stderr, encoding="utf-8")
    if done.returncode:
        raise MuflyError(f"{command[0]} ended with status {done.returncode}; see {folder / f'log.{command[0]}'}")


_RESIDUAL_LINE_PATTERN = re.compile(r"Solving for (\w+), Initial residual = ([^,]+),")
_CONTINUITY_LINE_PATTERN = re.compile(r"continuity errors : sum local = ([^,]+),")


def _read_tail(log: Path, size: int = 6000) -> str:
    data = log.read_bytes()[-size:]
    return data.decode("utf-8", errors="replace")


_SHOWN_ERROR_LINE_COUNT = 3
"""Lines of a fatal error that state it."""


def _find_error_text(log: Path) -> str:
    lines = _read_tail(log).splitlines()
    for i, line in enumerate(lines):
        if "FOAM FATAL" in line:
            return " ".join(" ".join(lines[i : i + _SHOWN_ERROR_LINE_COUNT]).split())
    return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")


def read_load_history(folder: Path, last: int | None = None, *, patch: str = "blade") -> Array:
    """Read thrust and torque of every iteration; for a pair ``patch`` ``blade_lower`` selects the lower rotor.

    Returns
    -------
    (iterations, 3) array
        Iteration, thrust (N) and torque (N m) of the whole rotor. Iterations repeated by a resumed run occur once, with
        their last values.
    """
    point = read_operating_point(folder)
    rows: dict[int, tuple[float, float]] = {}
    sense = math.copysign(1.0, point.patch_speeds_rad_s[patch])
    forces = _read_function_object_rows(folder, LOAD_FUNCTION_OBJECTS[patch], "force.dat", last)
    moments = _read_function_object_rows(folder, LOAD_FUNCTION_OBJECTS[patch], "moment.dat", last)
    for iteration, values in forces.items():
        if iteration in moments:
            rows[iteration] = (point.blades * values[2], -sense * point.blades * moments[iteration][2])
    return np.array([(i, *rows[i]) for i in sorted(rows)]).reshape(-1, 3)


def _read_function_object_rows(folder: Path, what: str, file: str, last: int | None = None) -> dict[int, list[float]]:
    """Return the rows that a function object wrote, by iteration; each start of the solver has written its own file."""
    out: dict[int, list[float]] = {}
    places = sorted((folder / "postProcessing" / what).glob("*"), key=lambda p: float(p.name))
    for place in places[-1:] if last else places:
        for each in sorted(place.glob(f"{Path(file).stem}*{Path(file).suffix}")):
            with each.open("rb") as f:
                if last:
                    f.seek(max(0, f.seek(0, 2) - 600 * last))
                lines = f.read().decode("utf-8", errors="replace").split("\n")[:-1]
            for line in lines[1:] if last else lines:
                if line.startswith("#"):
                    continue
                numbers = line.replace("(", " ").replace(")", " ").split()
                try:
                    out[int(float(numbers[0]))] = [float(x) for x in numbers[1:]]
                except (ValueError, IndexError):
                    continue  # a truncated line
    return out


def judge_case_convergence(folder: Path, *, patch: str = "blade") -> ConvergenceAssessment:
    """Judge the convergence of a case; for a pair, that of the rotor with the walls ``patch``."""
    point = _point_for_assessment(folder)
    loads = read_load_history(folder, patch=patch)
    flow = _read_function_object_rows(folder, "flows", "surfaceFieldValue.dat")
    continuity = _recent_continuity_error(folder / _LOG_FILE)
    outflow = flow[max(flow)][0] if flow else math.nan
    return judge_load_convergence(loads, outflow, continuity, point)


def _point_for_assessment(folder: Path) -> OperatingPoint:
    """Return a case's operating point, with ``least`` raised after a change of its actuator disc.

    ``least``, the iteration before which there is no convergence verdict, then lies at least one assessment window
    after the change.
    """
    point, disc = read_operating_point(folder), read_actuator_disc(folder)
    return (
        point
        if disc is None
        else replace(point, least=max(point.least, disc.set_iteration + ASSESSMENT_WINDOW_ITERATIONS))
    )


def judge_load_convergence(
    loads: Array, outflow_m3_s: float, continuity: float, point: OperatingPoint
) -> ConvergenceAssessment:
    """Return the convergence verdict from the loads, the flow through the bottom and the solver's continuity error.

    Parameters
    ----------
    loads : (iterations, 3) array
        Loads from :func:`read_load_history`.
    outflow_m3_s : float
        Volume flow out of the bottom of the sector.
    continuity : float
        The solver's ``sum local``: divergence of the fluxes, averaged over volume, times its step of 1 s.
    point : OperatingPoint
    """
    count = int(loads[-1, 0]) if len(loads) else 0
    if not len(loads):
        return ConvergenceAssessment(
            False, "not begun", 0, math.nan, math.nan, math.nan, math.nan, outflow_m3_s, math.nan
        )
    window = loads[-ASSESSMENT_WINDOW_ITERATIONS:]
    mean = window[:, 1:].mean(axis=0)
    size = np.maximum(np.abs(mean), 1e-300)
    # A thrust that is physically impossible: c_T of 1 or more.
    area = math.pi * point.radius_m**2
    most = point.density_kg_m3 * area * (point.speed_rad_s * point.radius_m) ** 2
    x = window[:, 0] - window[:, 0].mean()
    leak = continuity
    if not np.all(np.isfinite(loads[-20:, 1:])) or np.max(np.abs(loads[-20:, 1])) > most:
        nan = math.nan
        return ConvergenceAssessment(
            False, "diverged", count, float(mean[0]), float(mean[1]), nan, nan, outflow_m3_s, leak
        )
    slope = (x @ (window[:, 1:] - mean)) / max(float(x @ x), 1e-300)
    drift = np.abs(slope) * max(float(np.ptp(window[:, 0])), 1.0) / size
    rest = window[:, 1:] - mean - x[:, None] * slope
    swing = np.ptp(rest, axis=0) / size
    what = "settled"
    if count < point.least:
        what = "not done"
    elif not outflow_m3_s > 0.0 and not point.climb_m_s < 0.0:
        what = "blown back"
    elif swing.max() > _MAX_LOAD_SWING:
        what = "sloshing"
    elif drift.max() > _MAX_LOAD_DRIFT:
        what = "plateau"
    elif not leak < _MAX_CONTINUITY_ERROR:
        what = "leaking"
    return ConvergenceAssessment(
        what == "settled", what, count, float(mean[0]), float(mean[1]), float(drift.max()), float(swing.max()),
        float(outflow_m3_s), float(leak),
    )  # fmt: skip


def _recent_continuity_error(log: Path) -> float:
    if not log.is_file():
        return math.nan
    # Single iterations jump by a factor of two or more; the window has about twenty iterations.
    found = _CONTINUITY_LINE_PATTERN.findall(_read_tail(log, 20000))
    return float(np.median([float(x) for x in found])) if found else math.nan
