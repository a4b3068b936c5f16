"""Sweeps over all combinations of parameter values, on all cores or on a cluster, with resumption.

The combinations are divided into chunks. Each chunk is evaluated at once (``evaluate_cases``) and stored as a file if a
folder is given; a repeated sweep in the same folder computes only missing chunks. The folder belongs to one sweep: its
``sweep.json`` contains a hash of rotor, drive, parameters and program version, and another sweep is an error. Results
depend on the cases of a chunk only. Local threads or the workers of a dask.distributed cluster compute the chunks, both
by ``concurrent.futures``.
"""

from __future__ import annotations

import csv
import importlib
import itertools
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mufly.errors import InputError, MuflyError, convert_write_errors
from mufly.files.answer_store import claim_folder, hash_inputs, read_stored_result, write_stored_result
from mufly.rotor import RotorResult, list_database_airfoils, load_airfoil
from mufly.study.case_evaluation import StudyCase, StudyResults, evaluate_cases
from mufly.study.study_parameters import PAIR_PARAMETERS, ROTOR_PARAMETERS, ParameterValue, find_parameter
from mufly.study.study_setup import StudySetup, check_study_parameters
from mufly.version import __version__

ProgressCallback = Callable[[int, int], None]

CASES_PER_CHUNK = 512  # chunk size for single rotors by blade elements
_PAIRS_PER_CHUNK = 16
_MAX_SWEEP_CASES = 50_000_000
_SCHEDULER_TIMEOUT = "10s"  # wait for a response of the scheduler


def sweep_parameters(
    setup: StudySetup,
    vary: Mapping[str, Sequence[ParameterValue]],
    *,
    folder: str | Path | None = None,
    progress: ProgressCallback | None = None,
    cluster: str | None = None,
    workers: int | None = None,
    chunk: int | None = None,
) -> xr.Dataset:
    """Evaluate every combination of parameter values.

    Parameters
    ----------
    setup : StudySetup
        Rotor or pair, drive and fixed parameters; varied parameters need no fixed value.
    vary : mapping
        Values (SI) of each varied parameter; their order is that of the dimensions.
    folder : str or Path, optional
        Folder of stored chunks, from which an interrupted sweep resumes.
    progress : callable, optional
        ``progress(done, total)`` is called with numbers of cases, from the thread that called ``sweep_parameters``.
    cluster : str, optional
        Address of a dask.distributed scheduler such as ``tcp://host:8786``; its workers need mufly.
    workers : int, optional
        Number of chunks computed locally at a time; default: one per core.
    chunk : int, optional
        Cases in a chunk; default: 512, for pairs 16. Each wake is a separate chunk, because it uses all cores and is
        stored immediately.

    Returns
    -------
    xarray.Dataset
        Dimensions are the varied parameters. Variables are those of ``setup.output_meanings()`` with units in their
        attributes, nan for failed cases, and ``fault``, the reason of failure or an empty text.

    Raises
    ------
    InputError
        If parameters are inconsistent, a value is listed twice, or the folder belongs to another sweep.
    MuflyError
        If the cluster cannot be reached or dask.distributed is not installed.
    """
    names = list(vary)
    values = [list(vary[name]) for name in names]
    subject = "sweep" if setup.lower_rotor is None else setup.study_name_in_errors
    check_study_parameters(setup, names)
    for name, listed in zip(names, values, strict=True):
        if not listed:
            raise InputError(subject, name, "has no value", "give at least one value")
        if len(set(listed)) != len(listed):
            raise InputError(subject, name, "lists a value twice", "give each value once")
    if setup.lower_rotor is not None:
        setup = replace(setup, fixed_parameters={k: v for k, v in setup.fixed_parameters.items() if k not in names})
    chunk = chunk if chunk is not None else CASES_PER_CHUNK if setup.lower_rotor is None else _PAIRS_PER_CHUNK
    if chunk < 1:
        raise InputError(subject, "chunk", f"{chunk} cases", "give 1 or more")
    total = int(np.prod([len(v) for v in values], dtype=np.int64))
    if total > _MAX_SWEEP_CASES:
        raise InputError(subject, "", f"{total} cases", f"vary less ({_MAX_SWEEP_CASES} cases at most)")
    if setup.method == "wake":
        workers, chunk = 1, 1
    question = _sweep_digest(setup, names, values, chunk)
    parts = _evaluate_grid(setup, names, values, chunk, question, folder, progress, cluster, workers)
    pair = {} if setup.lower_rotor is None else {"balanced_by": setup.balance_by}
    drive = {} if setup.lower_rotor is not None else {"drive": setup.drive.name if setup.drive is not None else ""}
    attributes = {
        "rotor": " over ".join(r.name for r in setup.rotors),
        **drive,
        "fixed": json.dumps(dict(setup.fixed_parameters), sort_keys=True),
        "polars": f"{setup.polar_engine} {setup.polar_model}",
        "corrections": json.dumps(vars(setup.corrections)),
        "method": f"wake, {setup.wake_settings.model}" if setup.method == "wake" else setup.method,
        **pair,
        "mufly": __version__,
    }
    return _build_dataset(setup.output_meanings(), names, values, parts, attributes)


def _evaluate_grid(
    setup: StudySetup, names: Sequence[str], values: Sequence[Sequence[ParameterValue]], chunk: int, question: str,
    folder: str | Path | None, progress: ProgressCallback | None, cluster: str | None, workers: int | None,
) -> list[StudyResults]:  # fmt: skip
    """Evaluate every combination in chunks, stored in and read from a folder."""
    total = int(np.prod([len(v) for v in values], dtype=np.int64))
    starts = list(range(0, total, chunk))
    place = None if folder is None else Path(folder)
    if place is not None:
        claim_folder(place, "sweep.json", question, {"version": __version__}, _OTHER_SWEEP_MESSAGE)
    answers: dict[int, StudyResults] = {}
    done = 0

    def chunk_cases(start: int) -> list[StudyCase]:
        every = itertools.islice(itertools.product(*values), start, start + chunk)
        return [dict(zip(names, combination, strict=True)) for combination in every]

    for start in starts:
        known = None if place is None else _read_stored_chunk(place, start, question)
        if known is not None:
            answers[start] = known
            done += len(known.fault)
    if progress is not None:
        progress(done, total)
    with open_executor(cluster, workers) as executor:
        waiting = {}
        todo = iter([s for s in starts if s not in answers])
        # A few chunks more than workers keep them busy, limit memory and allow a fast stop.
        for start in itertools.islice(todo, 4 * (os.cpu_count() or 1) if cluster is None else 256):
            waiting[executor.submit(evaluate_cases, setup, chunk_cases(start))] = start
        try:
            while waiting:
                future = next(as_completed(waiting))
                start = waiting.pop(future)
                answers[start] = future.result()
                if place is not None:
                    content = {
                        "fault": np.array(answers[start].fault, dtype=np.str_),
                        **answers[start].values,
                    }
                    write_stored_result(_chunk_file(place, start), question, content)
                done += len(answers[start].fault)
                if progress is not None:
                    progress(done, total)
                following = next(todo, None)
                if following is not None:
                    waiting[executor.submit(evaluate_cases, setup, chunk_cases(following))] = following
        except BaseException:
            for future in waiting:
                future.cancel()
            raise
    return [answers[s] for s in starts]


@contextmanager
def open_executor(cluster: str | None, workers: int | None = None) -> Iterator[Executor]:
    """Open an executor: local threads, or the workers of the dask cluster with this scheduler address.

    Raises
    ------
    MuflyError
        If the cluster cannot be reached or dask.distributed is not installed.
    """
    if cluster is None:
        with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
            yield pool
        return
    try:
        distributed = importlib.import_module("distributed")  # optional dependency without types
    except ImportError as error:
        raise MuflyError(
            "a cluster needs dask.distributed, which is not installed; pip install 'mufly[cluster]'"
        ) from error
    try:
        client = distributed.Client(cluster, timeout=_SCHEDULER_TIMEOUT)
    except (OSError, ValueError) as error:
        raise MuflyError(f"no scheduler answers at {cluster} ({error}); start one with `dask scheduler`") from error
    try:
        yield client.get_executor(pure=False)
    finally:
        client.close()


def _sweep_digest(
    setup: StudySetup, names: Sequence[str], values: Sequence[Sequence[ParameterValue]], chunk: int
) -> str:
    """Return a hash of all inputs of a sweep; airfoil files enter by their contours."""
    listed = (v for vs in values for v in vs if isinstance(v, str))
    content = {
        "version": __version__,
        "rotors": [r.model_dump(mode="json") for r in setup.rotors],
        "drive": setup.drive.model_dump(mode="json") if setup.drive is not None else None,
        "fixed": dict(sorted(setup.fixed_parameters.items())),
        "corrections": vars(setup.corrections),
        "polars": [setup.polar_engine, setup.polar_model, setup.with_outside_share],
        "method": [
            setup.method,
            setup.balance_by,
            setup.station_count,
            vars(setup.wake_settings) if setup.method == "wake" else None,
        ],
        "vary": [names, values],
        "chunk": chunk,
        "contours": _airfoil_digests([*(n for r in setup.rotors for n in r.airfoil_names()), *listed]),
    }
    return hash_inputs(content)


def _airfoil_digests(names: Iterable[str]) -> dict[str, str]:
    """Return the digests of airfoils that are files."""
    found: dict[str, str] = {}
    for name in sorted(set(names)):
        path = Path(name)
        if path.is_file() and path.suffix.lower() == ".csv":
            found[name] = hash_inputs(path.read_bytes())
        elif path.is_file():
            try:
                found[name] = load_airfoil(name).contour_hash()
            except InputError:
                found[name] = "faulty"
    return found


_OTHER_SWEEP_MESSAGE = ("holds the results of another sweep", "give another folder, or delete this one")


def _chunk_file(folder: Path, start: int) -> Path:
    return folder / "chunks" / f"{start:09d}.npz"


def _read_stored_chunk(folder: Path, start: int, question: str) -> StudyResults | None:
    content = read_stored_result(_chunk_file(folder, start), question)
    return None if content is None else StudyResults(content, [str(reason) for reason in content.pop("fault")])


def _build_dataset(
    outputs: Mapping[str, tuple[str, str]],
    names: Sequence[str],
    values: Sequence[Sequence[ParameterValue]],
    parts: Sequence[StudyResults],
    attributes: Mapping[str, str],
) -> xr.Dataset:
    """Build a dataset of the results on a grid; ``outputs`` gives unit and meaning by name."""
    shape = tuple(len(v) for v in values)
    variables: dict[str, Any] = {}
    for name, (unit, meaning) in outputs.items():
        whole = np.concatenate([part.values[name] for part in parts]).reshape(shape)
        variables[name] = (names, whole, {"units": unit, "long_name": meaning})
    fault = np.array([reason for part in parts for reason in part.fault], dtype=np.str_).reshape(shape)
    variables["fault"] = (names, fault, {"long_name": "reason of a failed case; empty if there is none"})
    coordinates = {
        name: (
            name,
            np.asarray(listed),
            {"units": find_parameter(name).unit, "long_name": find_parameter(name).meaning},
        )
        for name, listed in zip(names, values, strict=True)
    }
    return xr.Dataset(variables, coordinates, dict(attributes))


# ----------------------------------------------------------------------------
# Results on disk: NetCDF for programs, CSV for spreadsheets.


def write_study_results(data: xr.Dataset, folder: str | Path, name: str = "sweep") -> list[Path]:
    """Write ``name.nc`` and ``name.csv`` into a folder, which is created if necessary.

    The CSV has a line for each case. Its columns are the coordinates, with the SI unit in the name, and the variables.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    target = Path(folder)
    with convert_write_errors(folder):
        target.mkdir(parents=True, exist_ok=True)
        nc, table = target / f"{name}.nc", target / f"{name}.csv"
        data.to_netcdf(nc, engine="scipy")
        names = [str(d) for d in data.dims]
        heads = [_column_header(d, str(data[d].attrs.get("units", ""))) for d in names]
        columns = [np.asarray(data[v].transpose(*names)).ravel() for v in data.data_vars]
        grid = np.meshgrid(*(data[d].values for d in names), indexing="ij")
        with table.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([*heads, *(str(v) for v in data.data_vars)])
            for row in zip(*(g.ravel() for g in grid), *columns, strict=True):
                writer.writerow([f"{x:.9g}" if isinstance(x, float) else x for x in row])
    return [nc, table]


def _column_header(name: str, unit: str) -> str:
    known = (name in ROTOR_PARAMETERS or name in PAIR_PARAMETERS) and unit not in ("", "1", "text")
    return f"{name}_{unit.replace(' ', '').replace('/', '_')}" if known else name


def read_study_results(file: str | Path) -> xr.Dataset:
    """Read a NetCDF file written by :func:`write_study_results`.

    Raises
    ------
    InputError
        If the file does not exist or is no such file.
    """
    try:
        with xr.open_dataset(file, engine="scipy") as data:
            return data.load()
    except (OSError, ValueError, TypeError) as error:
        raise InputError(str(file), "", f"is not a result file ({error})", "give a .nc file of a sweep") from error


def write_spanwise_loads(result: RotorResult, folder: str | Path, name: str = "stations") -> Path:
    """Write the spanwise loads as ``name.csv``, a line for each station, SI units.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    values = {f.name: getattr(result, f.name) for f in fields(result)}
    columns = {k: v for k, v in values.items() if np.ndim(v) == 1}
    path = Path(folder) / f"{name}.csv"
    with convert_write_errors(folder):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            for row in zip(*columns.values(), strict=True):
                writer.writerow([f"{v:.9g}" for v in row])
    return path


# ----------------------------------------------------------------------------
# Ranking of airfoils on a rotor, each at its best pitch.
#
# As in the dissertation's Table 3.3, the whole blade has the airfoil, the rotor is evaluated at each pitch with the
# gear adapted to the thrust, and the greatest value over the pitch counts. A section that fails at every pitch comes
# last, with the reason.


_RANKING_OUTPUTS = (
    "electrical_power_W",
    "power_W",
    "speed_rad_s",
    "gear_ratio",
    "figure_of_merit",
    "reynolds_75",
)


def rank_airfoils(
    setup: StudySetup,
    airfoils: Sequence[str],
    pitch_rad: Sequence[float],
    *,
    by: str | None = None,
    folder: str | Path | None = None,
    progress: ProgressCallback | None = None,
    cluster: str | None = None,
) -> xr.Dataset:
    """Rank airfoils on one rotor.

    Parameters
    ----------
    setup : StudySetup
        Rotor, drive and thrust (or speed).
    airfoils : sequence of str
        Distinct names or files.
    pitch_rad : sequence of float
        Pitch settings to try.
    by : str, optional
        Variable of the ranking, the greatest value first. Default: ``thrust_per_power_N_W`` with a drive, else
        ``figure_of_merit``.
    folder, progress, cluster
        As for :func:`mufly.study.sweep_parameters`.

    Returns
    -------
    xarray.Dataset
        Over ``airfoil``, best first: ``rank``, the ranked value, its ``pitch``, the other results at that pitch,
        ``thickness_ratio``, ``camber`` and ``fault``.

    Raises
    ------
    InputError
        If there is no such variable, or as for :func:`mufly.study.sweep_parameters`.
    """
    key = by or ("thrust_per_power_N_W" if setup.drive is not None else "figure_of_merit")
    if key not in setup.output_meanings():
        raise InputError("rank", key, "is not a result", f"use one of: {', '.join(setup.output_meanings())}")
    data = sweep_parameters(
        setup,
        {"airfoil": list(airfoils), "pitch": list(pitch_rad)},
        folder=folder,
        progress=progress,
        cluster=cluster,
    )
    value = data[key].values
    solved = np.isfinite(value)
    best = np.argmax(np.where(solved, value, -np.inf), axis=1)
    rows = np.arange(value.shape[0])
    order = np.argsort(-np.where(solved.any(axis=1), value[rows, best], -np.inf), kind="stable")
    at = (rows[order], best[order])
    kept = [key, *(name for name in _RANKING_OUTPUTS if name in data and name != key)]
    variables = {name: ("airfoil", data[name].values[at], data[name].attrs) for name in kept}
    ok = solved.any(axis=1)[order]
    names = [str(airfoils[k]) for k in order]
    shapes = np.array([_airfoil_thickness_and_camber(name) for name in names])
    pitch = np.where(ok, np.asarray(pitch_rad)[best[order]], np.nan)
    return xr.Dataset(
        {
            "rank": ("airfoil", np.arange(1, len(names) + 1)),
            **variables,
            "pitch": ("airfoil", pitch, data["pitch"].attrs),
            "thickness_ratio": ("airfoil", shapes[:, 0], {"units": "1", "long_name": "thickness over chord"}),
            "camber": ("airfoil", shapes[:, 1], {"units": "1", "long_name": "camber over chord"}),
            "fault": ("airfoil", np.where(ok, "", data["fault"].values[at])),
        },
        {"airfoil": np.array(names)},
        {**data.attrs, "by": key},
    )


def _airfoil_thickness_and_camber(name: str) -> tuple[float, float]:
    try:
        section = load_airfoil(name)
    except MuflyError:
        return np.nan, np.nan
    return section.thickness_ratio, section.camber


# ----------------------------------------------------------------------------
# Sets of airfoils for rankings: the dissertation's 247, the whole database, a folder of files, or names.
#
# The dissertation ranks 247 airfoils "from a data base" and names only eight of them (Table 3.3). The set here is the
# eight, then 239 of AeroSandbox's database (the UIUC collection, 2 174 contours in version 4.2.10). The database is in
# alphabetical order without the eight; the positions are floor(k n / 239), k = 0 to 238, or the next valid contour.
# The selection does not depend on shape or merit, so the sample is representative of the database.


# Name in Table 3.3 -> name here. n642-015 is "n64015" in the database, its only 64-015. NACA "25516" is no
# five-digit section: its third digit must be 0 (normal) or 1 (reflexed); 25016 is the nearest valid name.
TABLE_3_3_AIRFOILS: dict[str, str] = {
    "goe394": "goe394",
    "goe342": "goe342",
    "gm15sm": "gm15sm",
    "goe142": "goe142",
    "lnv109a": "lnv109a",
    "NACA25516": "naca25016",
    "n642-015": "n64015",
    "NACA6415": "naca6415",
}
_THESIS_AIRFOIL_COUNT = 247
_AIRFOIL_SUFFIXES = (".dat", ".txt")


def list_thesis_airfoils() -> list[str]:
    """Return 247 airfoils, as many as in the dissertation: the eight of Table 3.3, then an even choice of the database.

    Raises
    ------
    MuflyError
        If the database is not installed.
    """
    eight = list(TABLE_3_3_AIRFOILS.values())
    rest = [name for name in list_database_airfoils() if name not in eight]
    if len(rest) < _THESIS_AIRFOIL_COUNT - len(eight):
        raise MuflyError("AeroSandbox's airfoil database is not installed; pip install aerosandbox")
    n = _THESIS_AIRFOIL_COUNT - len(eight)
    chosen = list(eight)
    for k in range(n):
        place, end = k * len(rest) // n, (k + 1) * len(rest) // n
        chosen.append(next((name for name in rest[place:end] if _is_readable_airfoil(name)), rest[place]))
    return chosen


def _is_readable_airfoil(name: str) -> bool:
    try:
        load_airfoil(name)
    except InputError:
        return False
    return True


def expand_airfoil_names(wanted: str | Sequence[str]) -> list[str]:
    """Return the names of the airfoils in sets, folders and lists of names.

    Parameters
    ----------
    wanted : str or sequence of str
        ``"thesis"`` (the 247), ``"database"`` (all), a folder with .dat or .txt files, or names as
        :func:`mufly.rotor.load_airfoil` takes them; several may be given, in a sequence or separated by commas.

    Raises
    ------
    InputError
        If a folder contains no airfoil file or no name is given.
    """
    items = wanted.split(",") if isinstance(wanted, str) else [p for w in wanted for p in w.split(",")]
    names: list[str] = []
    for item in (i.strip() for i in items):
        if item == "thesis":
            names += list_thesis_airfoils()
        elif item == "database":
            names += list_database_airfoils()
        elif item and Path(item).is_dir():
            files = sorted(str(f) for f in Path(item).iterdir() if f.suffix.lower() in _AIRFOIL_SUFFIXES)
            if not files:
                raise InputError(item, "", "contains no airfoil file", "give a folder with .dat files")
            names += files
        elif item:
            names.append(item)
    if not names:
        raise InputError("airfoils", "", "none is named", "give names, a folder, 'thesis' or 'database'")
    return list(dict.fromkeys(names))
