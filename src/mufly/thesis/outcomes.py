"""Named studies: tables and figures of the dissertation, repeated, with a verdict on each of their claims.

What a study gives is kept in a folder, the user's cache or one of their own, under a digest of the sources that it
rests on (:func:`mufly.compiled.sources_of`): it is computed anew when they change, and only then. So a run of all that
was stopped goes on where it was.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from mufly.answer_store import cache_folder, hash_question, read_answer, write_answer
from mufly.compiled import sources_of
from mufly.drawing import shown
from mufly.errors import InputError, report_write_errors
from mufly.results import result
from mufly.study import TABLE_3_3, write_results
from mufly.thesis import (
    airframe,
    coaxial,
    flows,
    identification,
    loops,
    missions,
    pictures,
    rotors,
    single,
    wakes,
)
from mufly.thesis.catalogue import ITEMS, Item, item
from mufly.thesis.claims import Claim, Found, Progress, Study, Verdict
from mufly.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS_RUN = ("full", "thesis")


@result(eq=False)
class Outcome:
    """What a study found.

    Attributes
    ----------
    name, title : str
    data : mapping
        Model to results; empty where nothing but a picture is drawn.
    verdicts : sequence of Verdict
    figure : Figure
    note, lacking : str
        As in :class:`mufly.thesis.claims.Found`.
    seconds : float
        How long it took.
    """

    name: str
    title: str
    data: Mapping[str, xr.Dataset]
    verdicts: Sequence[Verdict]
    figure: Figure
    note: str = ""
    lacking: str = ""
    seconds: float = math.nan

    def plot(self) -> Figure:
        """Draw it; returns a matplotlib figure."""
        return shown(self.figure)

    def write(self, folder: str | Path) -> list[Path]:
        """Write picture, tables (NetCDF, CSV) and ``NAME.json`` with the verdicts; return the files.

        Raises
        ------
        InputError
            If the folder cannot be written.
        """
        target = Path(folder)
        picture, note = target / f"{self.name}.png", target / f"{self.name}.json"
        files: list[Path] = []
        with report_write_errors(folder):
            target.mkdir(parents=True, exist_ok=True)
            self.figure.savefig(picture, dpi=110)
            for model, data in self.data.items():
                name = f"{self.name}-{model}" if len(self.data) > 1 else self.name
                plain = _storable(data)
                if all(set(v.dims) == set(data.dims) for v in data.data_vars.values()):
                    files += write_results(plain, target, name)
                else:  # no one table has all of it
                    files.append(target / f"{name}.nc")
                    plain.to_netcdf(files[-1], engine="scipy")
        # Last: where it stands, so does the rest.
        write_answer(note, digest(self.name), self.to_dict(), indent=2)
        return [picture, note, *files]

    def to_dict(self) -> dict[str, Any]:
        """Return all but data and picture; a claim without a number has the value null."""
        verdicts = []
        for v in self.verdicts:
            content = asdict(v) | {"agrees": bool(v.agrees)}  # of numpy, it may be
            if content["claim"]["value"] != content["claim"]["value"]:
                content["claim"]["value"] = None
            verdicts.append(content)
        return {
            "name": self.name,
            "title": self.title,
            "verdicts": verdicts,
            "note": self.note,
            "lacking": self.lacking,
            "seconds": None if math.isnan(self.seconds) else round(self.seconds, 2),
            "version": __version__,
        }


def _storable(data: xr.Dataset) -> xr.Dataset:
    """What NetCDF 3 can hold: it has no long integers or instants, and a recording's attributes are of all kinds."""
    long = {
        k: (v.dims, v.values.astype(np.int64).astype(float))
        for k, v in data.variables.items()
        if v.dtype.kind in "mM" or (v.dtype.kind in "iu" and v.dtype.itemsize == 8)
    }
    kept = {k: v for k, v in data.attrs.items() if isinstance(v, str | float)}
    return data.drop_attrs(deep=False).assign(long).assign_attrs(kept)


@result
class Answer:
    """What is known of a figure or table: its item, and what its study found if it has run.

    Attributes
    ----------
    item : Item
    verdicts : tuple of Verdict
    note, lacking : str
    seconds : float
        How long the study took; nan if it has not run.
    picture : Path or None
        Ours.
    known : bool
        Whether there is an answer: a study that has run, or an item that needs none.
    """

    item: Item
    verdicts: tuple[Verdict, ...] = ()
    note: str = ""
    lacking: str = ""
    seconds: float = math.nan
    picture: Path | None = None
    known: bool = False

    @property
    def word(self) -> str:
        """The verdict in a word or two."""
        if self.item.kind != "result":
            return "stands for it"
        if not self.known:
            return "not run"
        if self.lacking:
            return f"needs {self.lacking}"
        agree = sum(v.agrees for v in self.verdicts)
        if not self.verdicts:
            return "drawn"
        return "agrees" if agree == len(self.verdicts) else "in part" if agree else "DIFFERS"

    @property
    def share(self) -> str:
        """How many verdicts agree, as ``3 of 4``; "" without any."""
        return f"{sum(v.agrees for v in self.verdicts)} of {len(self.verdicts)}" if self.verdicts else ""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text."""
        i = self.item
        return {
            "name": i.name, "kind": i.kind, "section": i.section, "title": i.title, "stands": i.stands,
            "word": self.word, "agree": sum(v.agrees for v in self.verdicts),
            "verdicts": [v.line() for v in self.verdicts],
            "note": self.note, "seconds": None if math.isnan(self.seconds) else self.seconds, "command": i.command,
            "picture": None if self.picture is None else str(self.picture),
        }  # fmt: skip


# ----------------------------------------------------------------------------
# Studies of one rotor and of pairs, each with several models: their computation as a Study.


def _steps(progress: Progress | None, k: int, n: int) -> Progress:
    """Progress of the k-th of n parts."""

    def step(done: int, total: int) -> None:
        if progress is not None:
            progress(done + k * total, n * total)

    return step


def _models(
    models: Sequence[str],
    compute: Callable[[str, Progress], tuple[xr.Dataset, list[Verdict]]],
    draw: Callable[[dict[str, xr.Dataset]], Figure],
    progress: Progress | None,
) -> Found:
    data: dict[str, xr.Dataset] = {}
    verdicts: list[Verdict] = []
    for k, model in enumerate(models):
        data[model], found = compute(model, _steps(progress, k, len(models)))
        verdicts += found
    return Found(verdicts, draw(data), data)


def _heading(name: str) -> str:
    return f"{ITEMS[name].where}: {ITEMS[name].title}"


def _sweep(name: str, progress: Progress | None) -> Found:
    def compute(model: str, step: Progress) -> tuple[xr.Dataset, list[Verdict]]:
        found = single.run_sweep(single.SWEEPS[name], model)
        step(1, 1)
        return found

    return _models(MODELS_RUN, compute, lambda d: pictures.pitch_figure(d, _heading(name)), progress)


def _gear(name: str, progress: Progress | None) -> Found:
    data, verdicts = single.muflys_gear()
    return Found(verdicts, pictures.gear_figure(data, _heading(name)), {"constant": data})


def _coefficients(name: str, progress: Progress | None) -> Found:
    return _models(
        MODELS_RUN,
        lambda model, _: single.coefficients_over_speed(model),
        lambda d: pictures.coefficients_figure(d, _heading(name)),
        progress,
    )


def _ranking(name: str, progress: Progress | None) -> Found:
    return _models(
        MODELS_RUN,
        single.airfoil_ranking,
        lambda d: pictures.ranking_figure(d, TABLE_3_3, _heading(name)),
        progress,
    )


def _sections(name: str, progress: Progress | None) -> Found:
    return Found([], pictures.sections_figure(single.SECTIONS[name][1], _heading(name)))


# Name -> computation, verdicts, picture, seconds.
_PAIRS: dict[str, tuple[Callable[..., xr.Dataset], Callable[..., list[Verdict]], Callable[..., Figure], float]] = {
    "fig-3.43": (coaxial.equal_speeds, coaxial.judge_equal_speeds, pictures.equal_speeds_figure, 120),
    "fig-3.44": (coaxial.one_speed_kept, coaxial.judge_kept_speed, pictures.kept_speed_figure, 250),
    "table-3.4": (coaxial.torque_balance, coaxial.judge_balance, pictures.balance_figure, 300),
    "fig-3.45": (coaxial.distances, coaxial.judge_distances, pictures.distances_figure, 400),
}  # fmt: skip


def _pair(name: str, progress: Progress | None) -> Found:
    compute, judge, draw, _ = _PAIRS[name]

    def one(model: str, step: Progress) -> tuple[xr.Dataset, list[Verdict]]:
        data = compute(model, progress=step)
        return data, judge(model, data)

    return _models(coaxial.COAXIAL_MODELS, one, lambda d: draw(d, _heading(name)), progress)


def _equal_speeds(name: str, progress: Progress | None) -> Found:
    found = _pair(name, progress)
    data = coaxial.equal_speeds_by_cfd()
    judged = coaxial.judge_equal_speeds("CFD, laminar, coarse (docs/cfd.md)", data)
    why = (
        "by CFD the lower rotor changes the upper one by 1 % at most; the source computed by a vortex method"
    )
    ours = [replace(v, claim=replace(v.claim, reason=why)) for v in judged]
    return replace(found, verdicts=[*found.verdicts, *ours])


def _of(
    function: Callable[[str, Progress | None], Found], names: Sequence[str], cost_s: float
) -> dict[str, Study]:
    return {name: Study(partial(function, name), cost_s) for name in names}


_OLDER: dict[str, Study] = {
    **_of(_sections, tuple(single.SECTIONS), 0.2),
    **_of(_gear, ("fig-3.7",), 0.5),
    **_of(_coefficients, ("fig-3.25",), 1),
    **_of(_sweep, tuple(single.SWEEPS), 2),
    **_of(_ranking, ("table-3.3",), 20),
    **{name: Study(partial(_pair, name), entry[3]) for name, entry in _PAIRS.items()},
    **_of(_equal_speeds, ("fig-3.43",), _PAIRS["fig-3.43"][3]),
}
_MODULES: tuple[ModuleType, ...] = (airframe, rotors, wakes, flows, identification, loops, missions)
STUDIES: dict[str, Study] = {**_OLDER, **{k: s for m in _MODULES for k, s in m.STUDIES.items()}}
"""Name -> study, for every item that is a result."""


def studies() -> list[Item]:
    """Return all figures and tables that have a study, in the order of the dissertation."""
    return [i for i in ITEMS.values() if i.kind == "result"]


def cheap_first() -> list[str]:
    """Return the names of all studies, the quick ones first."""
    return sorted(STUDIES, key=lambda name: STUDIES[name].cost_s)


def run_study(name: str, progress: Progress | None = None, *, case: Path | None = None) -> Outcome:
    """Run a study by name.

    Parameters
    ----------
    name : str
        One that :func:`studies` lists, as ``"fig-3.26"``.
    progress : callable, optional
        ``progress(done, total)``.
    case : Path, optional
        Folder of a solved CFD case, or of several, for Figs 3.22 to 3.24.

    Raises
    ------
    InputError
        If there is no such figure or table, or it is no result.
    """
    of = item(name)
    if of.name not in STUDIES:
        raise InputError("thesis", of.name, f"is a {of.kind}, not a result", f"mufly thesis show {of.name}")
    began = time.perf_counter()
    found = STUDIES[of.name].compute(progress) if case is None else flows.with_case(of.name, case)
    return Outcome(
        of.name, of.title, found.data, found.verdicts, found.figure, found.note, found.lacking,
        time.perf_counter() - began,
    )  # fmt: skip


# ----------------------------------------------------------------------------
# What was computed is kept.


_LIBRARIES = ("numpy", "scipy", "neuralfoil")


@cache
def _digest_of(file: Path) -> str:
    root = Path(__file__).resolve().parents[1]
    vehicles = sorted(root.glob("*/builtin/*.toml")) + sorted(root.glob("vehicle/maps/*.toml"))
    libraries = [f"{name} {version(name)}" for name in _LIBRARIES]
    return hash_question(libraries, *(path.read_bytes() for path in (*sources_of(file), *vehicles)))[:16]


def digest(name: str) -> str:
    """Return a hash of what a study rests on: sources, built-in vehicles and the like, versions of libraries."""
    module = next((m for m in _MODULES if name in m.STUDIES), coaxial if name in _PAIRS else single)
    own = _digest_of(Path(str(module.__file__)))
    return own if name not in _OLDER else f"{own}-{_digest_of(Path(pictures.__file__))[:8]}"


def recall(name: str, folder: Path | None = None) -> Answer:
    """Return what a folder, by default the user's, keeps of a figure or table; not ``known`` if nothing, or old."""
    of = item(name)
    if of.kind != "result":
        return Answer(of, known=True)
    place = cache_folder("thesis") if folder is None else folder
    content = None if place is None else read_answer(place / f"{of.name}.json", digest(of.name))
    if place is None or content is None:
        return Answer(of)
    verdicts = tuple(
        Verdict(Claim(**{**v["claim"], "value": math.nan if v["claim"]["value"] is None else v["claim"]["value"]}),
                v["model"], v["ours"], bool(v["agrees"]), v["rule"])
        for v in content["verdicts"]
    )  # fmt: skip
    seconds = math.nan if content.get("seconds") is None else float(content["seconds"])
    note, lacking = str(content.get("note", "")), str(content.get("lacking", ""))
    picture = place / f"{of.name}.png"
    return Answer(of, verdicts, note, lacking, seconds, picture if picture.is_file() else None, True)


def answer(
    name: str,
    folder: Path | None = None,
    progress: Progress | None = None,
    *,
    case: Path | None = None,
    again: bool = False,
) -> Answer:
    """Return the answer to a figure or table, computed unless it is kept.

    Parameters
    ----------
    name : str
    folder : Path, optional
        Where answers are kept, instead of the user's cache. What the cache holds is taken over.
    progress, case : optional
        As for :func:`run_study`; with a case it is computed in any event.
    again : bool
        Compute it even if it is kept.

    Raises
    ------
    InputError
        If there is no such figure or table.
    """
    of, cached = item(name), cache_folder("thesis")
    place = folder if folder is not None else cached
    if not again and case is None:
        found = recall(of.name, place)
        if found.known:
            return found
        if folder is not None and cached is not None and recall(of.name, cached).known:
            folder.mkdir(parents=True, exist_ok=True)
            for file in sorted(cached.glob(f"{of.name}*")):
                if file.stem == of.name or file.stem.startswith(f"{of.name}-"):
                    shutil.copyfile(file, folder / file.name)
            return recall(of.name, folder)
    outcome = run_study(of.name, progress, case=case)
    if place is not None:
        outcome.write(place)
        if folder is not None and cached is not None and case is None:
            outcome.write(cached)
        return recall(of.name, place)
    return Answer(of, tuple(outcome.verdicts), outcome.note, outcome.lacking, outcome.seconds, None, True)
