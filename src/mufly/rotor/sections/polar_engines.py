"""Polar engines: computation of the polar table of an airfoil by one of three engines.

``neuralfoil``
    Network trained on XFOIL (:mod:`.neuralfoil_network`); the default, milliseconds per table.
``xfoil``
    M. Drela's panel and boundary-layer code, if installed (:func:`compute_xfoil_polars`), for cross-checks; minutes per
    table.
``table``
    The user's numbers from a CSV file (:mod:`.polar_file`).
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache as once
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.compiled.toolchain import build_cached_library, find_compiler
from mufly.errors import InputError, MuflyError
from mufly.files.answer_store import hash_inputs
from mufly.rotor.sections import neuralfoil_network
from mufly.rotor.sections.airfoil import Airfoil, load_airfoil
from mufly.rotor.sections.polar_file import is_polar_file, read_polar_file
from mufly.rotor.sections.polar_table import DEFAULT_ASPECT_RATIO, PolarTable, extend_polar_to_full_circle
from mufly.rotor.sections.section_data import EnginePolars, load_cached_polars, store_cached_polars

PolarEngine = Literal["neuralfoil", "xfoil", "table"]

DEFAULT_REYNOLDS: NDArray[np.float64] = 2e3 * 150.0 ** (np.arange(33) / 20.0)  # to 6e6, in steps of a factor 1.28


def compute_polar(
    airfoil: str | Path | Airfoil,
    *,
    n_crit: float = 0.1,
    engine: PolarEngine = "neuralfoil",
    reynolds: ArrayLike | None = None,
    xtr: tuple[float, float] = (1.0, 1.0),
    model: str = "xlarge",
    aspect_ratio: float = DEFAULT_ASPECT_RATIO,
) -> PolarTable:
    """Return the section coefficients of an airfoil over the full circle.

    Parameters
    ----------
    airfoil : str, Path or Airfoil
        Airfoil as for :func:`mufly.rotor.load_airfoil`. A file of coefficients (columns alpha_deg, cl, cd, and if known
        cm and reynolds; XFOIL's, XFLR5's, Airfoil Tools', AeroDyn's) is read as a table for every engine.
    n_crit : float
        Amplification exponent at transition, 0 to 18. The default suits a vibrating rotor in its own wake (thesis,
        Table 3.1); 9 is a quiet wind tunnel. Ignored for a table.
    engine : {'neuralfoil', 'xfoil', 'table'}
        Engine; see the module docstring.
    reynolds : (nr,) array_like, optional
        Chord Reynolds numbers in geometric progression; the default covers 2e3 to 6e6.
    xtr : (float, float)
        Forced transition on upper and lower side, x/c; 1 leaves it free.
    model : str
        Size of NeuralFoil's network.
    aspect_ratio : float
        Span over chord of the blade, for the drag across the flow (see ``extend_polar_to_full_circle``).

    Raises
    ------
    InputError
        If the airfoil, an option or the file is wrong.
    MuflyError
        If the engine is not installed or does not converge.

    Thesis: Table 3.1.
    """
    given = airfoil.name if isinstance(airfoil, Airfoil) else str(airfoil)
    found = compute_airfoil_polars(
        [airfoil],
        n_crit=n_crit,
        engine=engine,
        reynolds=reynolds,
        xtr=xtr,
        model=model,
        aspect_ratio=aspect_ratio,
    )
    return found[given]


def compute_airfoil_polars(
    airfoils: Iterable[str | Path | Airfoil],
    *,
    n_crit: float = 0.1,
    engine: PolarEngine = "neuralfoil",
    reynolds: ArrayLike | None = None,
    xtr: tuple[float, float] = (1.0, 1.0),
    model: str = "xlarge",
    aspect_ratio: float = DEFAULT_ASPECT_RATIO,
    faults: dict[str, str] | None = None,
) -> dict[str, PolarTable]:
    """Return the polar tables of many airfoils by their requested names.

    Parameters
    ----------
    airfoils : iterable of str, Path or Airfoil
        Airfoils; the other parameters are those of :func:`compute_polar`.
    faults : dict, optional
        If given, an airfoil that fails is omitted from the result and its one-line message is stored here under its
        name. Otherwise the first failure is raised.
    """
    re = _check_arguments(n_crit, engine, reynolds, xtr)
    tables: dict[str, EnginePolars] = {}
    todo: list[tuple[str, str, Airfoil]] = []
    for item in airfoils:
        name = item.name if isinstance(item, Airfoil) else str(item)
        try:
            if engine == "table" or (not isinstance(item, Airfoil) and is_polar_file(name)):
                tables[name] = read_polar_file(name)
                continue
            section = item if isinstance(item, Airfoil) else load_airfoil(item)
            which = (
                (neuralfoil_network.neuralfoil_version(), model)
                if engine == "neuralfoil"
                else ("xfoil", XFOIL_SETTINGS)
            )
            key = hash_inputs(section.contour_hash(), engine, *which, float(n_crit), tuple(map(float, xtr)), re)
            known = load_cached_polars(key, section.name)
            if known is not None:
                tables[name] = known
            elif engine == "neuralfoil":
                neuralfoil_network.require_kulfan_fit(section)
                todo.append((name, key, section))
            else:
                tables[name] = compute_xfoil_polars(section, re, n_crit=n_crit, xtr=xtr)
                store_cached_polars(key, tables[name])
        except InputError as error:
            if faults is None:
                raise
            faults[name] = str(error)
    if todo:
        computed = neuralfoil_network.compute_neuralfoil_polars(
            [s for _, _, s in todo], re, n_crit=n_crit, xtr=xtr, model=model
        )
        for (name, key, _), data in zip(todo, computed, strict=True):
            tables[name] = data
            store_cached_polars(key, data)
    return {name: extend_polar_to_full_circle(data, aspect_ratio=aspect_ratio) for name, data in tables.items()}


def _check_arguments(
    n_crit: float, engine: str, reynolds: ArrayLike | None, xtr: tuple[float, float]
) -> NDArray[np.float64]:
    if engine not in ("neuralfoil", "xfoil", "table"):
        raise InputError("polar", "engine", f"{engine!r} is unknown", "use neuralfoil, xfoil or table")
    if not 0.0 <= n_crit <= 18.0:
        raise InputError("polar", "n_crit", f"{n_crit:g} is out of range", "give 0 (noisy) to 18 (glider)")
    if len(xtr) != 2 or not all(0.0 <= x <= 1.0 for x in xtr):
        raise InputError("polar", "xtr", f"{xtr} is out of range", "give two positions x/c between 0 and 1")
    re = DEFAULT_REYNOLDS if reynolds is None else np.atleast_1d(np.asarray(reynolds, dtype=np.float64))
    steps = np.diff(np.log(re)) if np.all(re > 0) else np.array([-1.0])
    if re.ndim != 1 or not np.all(np.isfinite(re)) or np.any(steps <= 0):
        raise InputError("polar", "reynolds", "are not positive and rising", "give for example geomspace(2e3, 5e6, 33)")
    if steps.size > 1 and not np.allclose(steps, steps.mean(), rtol=1e-6):
        raise InputError("polar", "reynolds", "are not in geometric progression", "use numpy.geomspace")
    return re


# ----------------------------------------------------------------------------
# XFOIL (M. Drela, MIT; GPL, run as a separate program) for cross-checks.
#
# One run covers one Reynolds number: angles increase from zero, then decrease from zero, each starting from the last
# converged boundary layer. Angles that do not converge are repeated once from a fresh start. A gap of up to two degrees
# between converged angles is interpolated; beyond a wider gap the result is unknown. Every run has a time limit; the
# output written until then is used.
#
# Debian's build stops at the first floating-point exception, which XFOIL raises in normal operation (the main program
# requests traps by `_gfortran_set_fpe`). If a run ends with that signal, a library with an empty replacement of this
# function is compiled with the system's C compiler, stored in the cache folder and preloaded.


Array = NDArray[np.float64]

XFOIL_SETTINGS = (-16.0, 22.0, 0.5, 160, 100)  # lowest, highest, step (deg); panels; iterations
_XFOIL_TIME_LIMIT_S = 60.0  # of one process
_MAX_BRIDGED_GAP_DEG = 2.0
_FPE_STUB_SOURCE = "void _gfortran_set_fpe(int exceptions) { (void)exceptions; }\n"


@once
def xfoil_unavailable_reason() -> str:
    """Return the reason why XFOIL cannot be used on this machine, or ``""`` if it can."""
    if shutil.which("xfoil") is None:
        return "xfoil is not installed (on Debian: apt install xfoil)"
    try:
        with tempfile.TemporaryDirectory(prefix="mufly-xfoil-") as folder:
            found = _run_xfoil(load_airfoil("naca0012"), 1e5, 9.0, (1.0, 1.0), [2.0], Path(folder))
    except MuflyError as error:
        return str(error)
    return "" if found else "xfoil is installed but does not converge on a NACA 0012 at 2 degrees"


def _xfoil_environment(preload: str | None) -> dict[str, str]:
    environment = {**os.environ, "GFORTRAN_UNBUFFERED_ALL": "y"}
    if preload:
        environment["LD_PRELOAD"] = preload
    return environment


@once
def _build_fpe_stub() -> str:
    """Build the library that disables XFOIL's floating-point traps; return its path."""
    trapped = "this xfoil stops at floating-point exceptions"
    try:
        find_compiler()
    except MuflyError as error:
        raise MuflyError(
            f"{trapped}, and without a C compiler this cannot be disabled; install gcc, or use engine 'neuralfoil'"
        ) from error
    try:
        return str(build_cached_library("xfoil-quiet", {"quiet.c": _FPE_STUB_SOURCE}))
    except MuflyError as error:
        raise MuflyError(f"{trapped}; {error}") from error


_needs_fpe_stub: list[bool] = []  # known after the first run


def _run_xfoil(
    airfoil: Airfoil,
    reynolds: float,
    n_crit: float,
    xtr: tuple[float, float],
    angles_deg: list[float],
    folder: Path,
) -> dict[float, tuple[float, float, float]]:
    """Run XFOIL once over the angles in order; return (cl, cd, cm) by alpha_deg for those that converge.

    A nan among the angles initialises the boundary layer afresh.
    """
    contour, polar = folder / "contour.dat", folder / "polar.txt"
    rows = "\n".join(f"{x:.7f} {y:.7f}" for x, y in airfoil.coordinates)
    contour.write_text(f"contour\n{rows}\n", encoding="utf-8")
    polar.unlink(missing_ok=True)
    *_, panels, iterations = XFOIL_SETTINGS
    script = [
        "PLOP",
        "G F",
        "",
        "LOAD contour.dat",
        "PPAR",
        f"N {panels}",
        "",
        "",
        "OPER",
        f"ITER {iterations}",
    ]
    script += ["VPAR", f"N {n_crit:g}", f"XTR {xtr[0]:g} {xtr[1]:g}", "", f"VISC {reynolds:.6g}"]
    script += ["PACC", "polar.txt", ""]
    script += ["INIT" if np.isnan(angle) else f"ALFA {angle:.3f}" for angle in angles_deg]
    script += ["PACC", "", "QUIT", ""]
    text = "\n".join(script)
    for attempt in range(2):
        quiet = bool(_needs_fpe_stub) and _needs_fpe_stub[0]
        try:
            done = subprocess.run(
                ["xfoil"],
                input=text,
                cwd=folder,
                env=_xfoil_environment(_build_fpe_stub() if quiet else None),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=_XFOIL_TIME_LIMIT_S,
                text=True,
            )
            code = done.returncode
        except subprocess.TimeoutExpired:
            break
        except OSError as error:
            raise MuflyError(f"xfoil cannot be started ({error}); use engine 'neuralfoil'") from error
        if code != -signal.SIGFPE or attempt:
            break
        _needs_fpe_stub[:] = [True]
    return _parse_xfoil_polar(polar)


def _parse_xfoil_polar(file: Path) -> dict[float, tuple[float, float, float]]:
    found = {}
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    for line in lines:
        try:
            numbers = [float(w) for w in line.split()]
        except ValueError:
            continue
        if len(numbers) >= 7:
            alpha_deg, cl, cd, _, cm, *_ = numbers
            if cd > 0 and abs(cl) < 5:
                found[round(alpha_deg, 3)] = (cl, cd, cm)
    return found


def _compute_xfoil_polar(
    airfoil: Airfoil,
    reynolds: float,
    n_crit: float,
    xtr: tuple[float, float],
    alpha_deg: Array,
) -> Array:
    """Return the coefficients (na, 3) at a Reynolds number, nan where XFOIL does not converge."""
    upwards, downwards = alpha_deg[alpha_deg >= 0], alpha_deg[alpha_deg < 0][::-1]
    with tempfile.TemporaryDirectory(prefix="mufly-xfoil-") as name:
        folder = Path(name)
        order = [*upwards, np.nan, *downwards]
        found = _run_xfoil(airfoil, reynolds, n_crit, xtr, order, folder)
        missing = [a for a in alpha_deg if round(float(a), 3) not in found]
        if missing:
            again = [v for a in missing for v in (np.nan, a)]
            found = {**_run_xfoil(airfoil, reynolds, n_crit, xtr, again, folder), **found}
    nothing = (np.nan, np.nan, np.nan)
    return np.array([found.get(round(float(a), 3), nothing) for a in alpha_deg])


def _bridge_gaps(alpha_deg: Array, table: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Interpolate across narrow gaps of unconverged angles; return the table and a mask of its usable angles.

    The usable angles lie around zero lift, up to the first gap on each side that is too wide to bridge.
    """
    good = np.all(np.isfinite(table), axis=1)
    if good.sum() < 3:
        return table, np.zeros(good.size, dtype=np.bool_)
    at = np.flatnonzero(good)
    middle = at[np.argmin(np.abs(table[at, 0]))]
    wide = np.flatnonzero(np.diff(alpha_deg[at]) > _MAX_BRIDGED_GAP_DEG + 1e-9)
    first = at[max((w + 1 for w in wide if at[w + 1] <= middle), default=0)]
    last = at[min((w for w in wide if at[w] >= middle), default=at.size - 1)]
    known = np.zeros(good.size, dtype=np.bool_)
    known[first : last + 1] = True
    filled = table.copy()
    for c in range(3):
        filled[known, c] = np.interp(alpha_deg[known], alpha_deg[at], table[at, c])
    return filled, known


def compute_xfoil_polars(
    airfoil: Airfoil,
    reynolds: ArrayLike,
    *,
    n_crit: float = 0.1,
    xtr: tuple[float, float] = (1.0, 1.0),
    alpha_deg: ArrayLike | None = None,
) -> EnginePolars:
    """Compute polars with XFOIL.

    Parameters
    ----------
    airfoil : Airfoil
        Section; XFOIL distributes its own panels on the contour.
    reynolds : (nr,) array_like
        Chord Reynolds numbers; one process for each, in parallel on all processors.
    n_crit, xtr
        As for :func:`mufly.rotor.compute_polar`.
    alpha_deg : (na,) array_like, optional
        Angles, increasing; the default is -16 to 22 degrees in steps of 0.5.

    Raises
    ------
    MuflyError
        If XFOIL is not installed, cannot be run, or at some Reynolds number converged at fewer than three angles.
    """
    missing = xfoil_unavailable_reason()
    if missing:
        raise MuflyError(f"{missing}; use engine 'neuralfoil'")
    low, high, step, *_ = XFOIL_SETTINGS
    angles = np.arange(low, high + step / 2, step) if alpha_deg is None else np.asarray(alpha_deg, dtype=np.float64)
    re = np.atleast_1d(np.asarray(reynolds, dtype=np.float64))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        tables = list(pool.map(lambda r: _compute_xfoil_polar(airfoil, float(r), n_crit, xtr, angles), re))
    values, known = zip(*(_bridge_gaps(angles, t) for t in tables), strict=True)
    for r, k in zip(re, known, strict=True):
        if not k.any():
            raise MuflyError(
                f"xfoil does not converge on {airfoil.name} at Re {r:.0f} and n_crit {n_crit:g}; "
                "omit that Reynolds number, or use engine 'neuralfoil'"
            )
    coefficients = np.nan_to_num(np.stack(values))
    mask = np.stack(known)
    source = f"XFOIL, n_crit {n_crit:g}, transition at {xtr[0]:g}, {xtr[1]:g}"
    return EnginePolars(
        airfoil.name, np.deg2rad(angles), re.copy(), coefficients[..., 0], coefficients[..., 1], coefficients[..., 2],
        mask, mask.copy(), source, n_crit, airfoil.thickness_ratio, airfoil.camber,
    )  # fmt: skip
