"""Named studies: tables and figures of the dissertation, repeated, with a verdict on each of their claims.

Results are cached in a folder, the user's cache or a given one, under a digest of the sources of the study
(:func:`mufly.compiled.numba_cache.imported_sources`). A study is computed again only if its sources change, so an
interrupted run of all studies resumes.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from mufly.compiled.numba_cache import imported_sources
from mufly.errors import InputError, convert_write_errors
from mufly.files.answer_store import cache_folder, hash_inputs, read_stored_result, write_stored_result
from mufly.results import ShownBlock, make_lines_block, result, select_fields, to_plain_data
from mufly.results.result_figure import enable_notebook_display
from mufly.study import TABLE_3_3_AIRFOILS, write_study_results
from mufly.thesis import (
    airframe_studies,
    blade_element_studies,
    cfd_studies,
    coaxial_studies,
    control_studies,
    identification_studies,
    mission_studies,
    rotor_figures,
    single_rotor_studies,
    wake_studies,
)
from mufly.thesis.claims import Claim, ProgressCallback, Study, StudyFindings, Verdict
from mufly.thesis.figure_catalogue import THESIS_ITEMS, ThesisItem, find_item
from mufly.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COMPARED_MODELS = ("full", "thesis")


@result(eq=False)
class StudyOutcome:
    """Outcome of a study.

    Attributes
    ----------
    name, title : str
        Name of the study (``fig-3.26``), and title of its figure or table.
    data : mapping
        Results by model; empty for a study that only draws a picture.
    verdicts : sequence of Verdict
    figure : Figure
    note, missing : str
        As in :class:`mufly.thesis.claims.StudyFindings`.
    computing_time_s : float
        Computing time (s).
    """

    name: str
    title: str
    data: Mapping[str, xr.Dataset]
    verdicts: Sequence[Verdict]
    figure: Figure
    note: str = ""
    missing: str = ""
    computing_time_s: float = math.nan

    def plot(self) -> Figure:
        """Draw the outcome; return a matplotlib figure."""
        return enable_notebook_display(self.figure)

    def write_files(self, folder: str | Path) -> list[Path]:
        """Write picture, tables (NetCDF, CSV) and ``NAME.json`` with the verdicts; return the files.

        Raises
        ------
        InputError
            If the folder cannot be written.
        """
        target = Path(folder)
        picture, note = target / f"{self.name}.png", target / f"{self.name}.json"
        files: list[Path] = []
        with convert_write_errors(folder):
            target.mkdir(parents=True, exist_ok=True)
            self.figure.savefig(picture, dpi=110)
            for model, data in self.data.items():
                name = f"{self.name}-{model}" if len(self.data) > 1 else self.name
                plain = _to_netcdf_types(data)
                if all(set(v.dims) == set(data.dims) for v in data.data_vars.values()):
                    files += write_study_results(plain, target, name)
                else:  # no single table contains all of them
                    files.append(target / f"{name}.nc")
                    plain.to_netcdf(files[-1], engine="scipy")
        # Written last: it marks complete results.
        write_stored_result(note, hash_study_inputs(self.name), self.to_dict(), indent=2)
        return [picture, note, *files]

    def to_dict(self) -> dict[str, Any]:
        """Return all results except data and picture; the value of a claim without a number is null."""
        return {
            **to_plain_data(select_fields(self, "name title verdicts note missing")),
            "seconds": None if math.isnan(self.computing_time_s) else round(self.computing_time_s, 2),
            "version": __version__,
        }


def _to_netcdf_types(data: xr.Dataset) -> xr.Dataset:
    """Return the data in types of NetCDF 3: long integers and instants as floats, attributes only text or floats."""
    long = {
        k: (v.dims, v.values.astype(np.int64).astype(float))
        for k, v in data.variables.items()
        if v.dtype.kind in "mM" or (v.dtype.kind in "iu" and v.dtype.itemsize == 8)
    }
    kept = {k: v for k, v in data.attrs.items() if isinstance(v, str | float)}
    return data.drop_attrs(deep=False).assign(long).assign_attrs(kept)


@result
class StudyAnswer:
    """Figure or table of the dissertation, with the outcome of its study if it has run.

    Attributes
    ----------
    item : ThesisItem
    verdicts : tuple of Verdict
    note, missing : str
    computing_time_s : float
        Computing time (s); nan if the study has not run.
    picture : Path or None
        Computed picture.
    is_answered : bool
        Whether there is an answer: a study that has run, or an item that needs none.
    """

    item: ThesisItem
    verdicts: tuple[Verdict, ...] = ()
    note: str = ""
    missing: str = ""
    computing_time_s: float = math.nan
    picture: Path | None = None
    is_answered: bool = False

    @property
    def verdict_word(self) -> str:
        """Verdict in one or two words."""
        if self.item.kind != "result":
            return "counterpart"
        if not self.is_answered:
            return "not run"
        if self.missing:
            return f"needs {self.missing}"
        agree = sum(v.agrees for v in self.verdicts)
        if not self.verdicts:
            return "drawn"
        return "agrees" if agree == len(self.verdicts) else "in part" if agree else "DIFFERS"

    @property
    def agreement_count_text(self) -> str:
        """Number of verdicts that agree, as ``3 of 4``; "" without any."""
        return f"{sum(v.agrees for v in self.verdicts)} of {len(self.verdicts)}" if self.verdicts else ""

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return as printed text the verdict, each claim with its result, the note and the picture."""
        i = self.item
        count = f" ({self.agreement_count_text})" if self.agreement_count_text else ""
        place = [] if i.kind == "result" else [f"A {i.kind}; counterpart in mufly: {i.counterpart}."]
        picture = "" if self.picture is None else f"Picture: {self.picture}"
        return [
            make_lines_block(f"  {self.verdict_word}{count}", *place, head=f"{i.name}  {i.title}"),
            *(make_lines_block(v.format_line(), style="" if v.agrees else "yellow") for v in self.verdicts),
            make_lines_block(*filter(None, (self.note, picture)), style="dim"),
        ]

    def as_record(self) -> dict[str, Any]:
        """Return the answer as plain numbers and text."""
        i = self.item
        return {
            "name": i.name, "kind": i.kind, "section": i.section, "title": i.title, "stands": i.counterpart,
            "word": self.verdict_word, "agree": sum(v.agrees for v in self.verdicts),
            "verdicts": [v.format_line() for v in self.verdicts],
            "note": self.note,
            "seconds": None if math.isnan(self.computing_time_s) else self.computing_time_s, "command": i.cli_command,
            "picture": None if self.picture is None else str(self.picture),
        }  # fmt: skip


# ----------------------------------------------------------------------------
# Studies of single rotors and pairs, each with several models, as Study records.


def _make_subprogress(progress: ProgressCallback | None, k: int, n: int) -> ProgressCallback:
    """Return a progress function for the k-th of n parts."""

    def report_progress(done: int, total: int) -> None:
        if progress is not None:
            progress(done + k * total, n * total)

    return report_progress


def _run_models(
    models: Sequence[str],
    compute: Callable[[str, ProgressCallback], tuple[xr.Dataset, list[Verdict]]],
    draw: Callable[[dict[str, xr.Dataset]], Figure],
    progress: ProgressCallback | None,
) -> StudyFindings:
    data: dict[str, xr.Dataset] = {}
    verdicts: list[Verdict] = []
    for k, model in enumerate(models):
        data[model], found = compute(model, _make_subprogress(progress, k, len(models)))
        verdicts += found
    return StudyFindings(verdicts, draw(data), data)


def _item_heading(name: str) -> str:
    return f"{THESIS_ITEMS[name].citation}: {THESIS_ITEMS[name].title}"


def _run_sweep_study(name: str, progress: ProgressCallback | None) -> StudyFindings:
    def compute_sweep(model: str, step: ProgressCallback) -> tuple[xr.Dataset, list[Verdict]]:
        found = single_rotor_studies.compute_sweep_and_verdicts(single_rotor_studies.SWEEP_STUDIES[name], model)
        step(1, 1)
        return found

    return _run_models(
        COMPARED_MODELS,
        compute_sweep,
        lambda d: rotor_figures.draw_pitch_sweep(d, _item_heading(name)),
        progress,
    )


def _run_gear_study(name: str, progress: ProgressCallback | None) -> StudyFindings:
    data, verdicts = single_rotor_studies.compute_gear_ratio_study()
    return StudyFindings(verdicts, rotor_figures.draw_gear_ratio(data, _item_heading(name)), {"constant": data})


def _run_coefficients_study(name: str, progress: ProgressCallback | None) -> StudyFindings:
    return _run_models(
        COMPARED_MODELS,
        lambda model, _: single_rotor_studies.compute_coefficients_over_speed(model),
        lambda d: rotor_figures.draw_coefficients_over_speed(d, _item_heading(name)),
        progress,
    )


def _run_ranking_study(name: str, progress: ProgressCallback | None) -> StudyFindings:
    return _run_models(
        COMPARED_MODELS,
        single_rotor_studies.compute_airfoil_ranking,
        lambda d: rotor_figures.draw_airfoil_ranking(d, TABLE_3_3_AIRFOILS, _item_heading(name)),
        progress,
    )


def _run_sections_study(name: str, progress: ProgressCallback | None) -> StudyFindings:
    return StudyFindings(
        [], rotor_figures.draw_airfoil_contours(single_rotor_studies.SECTION_FIGURES[name][1], _item_heading(name))
    )


# Name -> computation, verdicts, picture, seconds.
class _PairStudy(NamedTuple):
    """Functions that compute, judge and draw a study of rotor pairs, and its computing time (s)."""

    compute: Callable[..., xr.Dataset]
    judge: Callable[..., list[Verdict]]
    draw: Callable[..., Figure]
    cost_s: float


_PAIR_STUDIES = {
    "fig-3.43": _PairStudy(
        coaxial_studies.compute_equal_speeds,
        coaxial_studies.judge_equal_speeds,
        rotor_figures.draw_equal_speeds,
        120,
    ),
    "fig-3.44": _PairStudy(
        coaxial_studies.compute_one_speed_fixed,
        coaxial_studies.judge_one_speed_fixed,
        rotor_figures.draw_one_speed_fixed,
        250,
    ),
    "table-3.4": _PairStudy(
        coaxial_studies.compute_equal_torques,
        coaxial_studies.judge_balance,
        rotor_figures.draw_equal_torques,
        300,
    ),
    "fig-3.45": _PairStudy(
        coaxial_studies.compute_rotor_spacing,
        coaxial_studies.judge_rotor_spacing,
        rotor_figures.draw_rotor_spacing,
        400,
    ),
}


def _run_pair_study(name: str, progress: ProgressCallback | None) -> StudyFindings:
    study = _PAIR_STUDIES[name]

    def compute_and_judge(model: str, step: ProgressCallback) -> tuple[xr.Dataset, list[Verdict]]:
        data = study.compute(model, progress=step)
        return data, study.judge(model, data)

    return _run_models(
        coaxial_studies.COAXIAL_MODELS, compute_and_judge, lambda d: study.draw(d, _item_heading(name)), progress
    )


def _run_equal_speeds_study(name: str, progress: ProgressCallback | None) -> StudyFindings:
    found = _run_pair_study(name, progress)
    data = coaxial_studies.tabulate_cfd_equal_speeds()
    ours = coaxial_studies.judge_equal_speeds("CFD, laminar, coarse (docs/explanation/cfd.md)", data)
    return replace(found, verdicts=[*found.verdicts, *ours])


def _make_studies(
    function: Callable[[str, ProgressCallback | None], StudyFindings], names: Sequence[str], cost_s: float
) -> dict[str, Study]:
    return {name: Study(partial(function, name), cost_s) for name in names}


_ROTOR_STUDIES: dict[str, Study] = {
    **_make_studies(_run_sections_study, tuple(single_rotor_studies.SECTION_FIGURES), 0.2),
    **_make_studies(_run_gear_study, ("fig-3.7",), 0.5),
    **_make_studies(_run_coefficients_study, ("fig-3.25",), 1),
    **_make_studies(_run_sweep_study, tuple(single_rotor_studies.SWEEP_STUDIES), 2),
    **_make_studies(_run_ranking_study, ("table-3.3",), 20),
    **{name: Study(partial(_run_pair_study, name), study.cost_s) for name, study in _PAIR_STUDIES.items()},
    **_make_studies(_run_equal_speeds_study, ("fig-3.43",), _PAIR_STUDIES["fig-3.43"].cost_s),
}
_STUDY_MODULES: tuple[ModuleType, ...] = (
    airframe_studies,
    blade_element_studies,
    wake_studies,
    cfd_studies,
    identification_studies,
    control_studies,
    mission_studies,
)
STUDIES: dict[str, Study] = {**_ROTOR_STUDIES, **{k: s for m in _STUDY_MODULES for k, s in m.STUDIES.items()}}
"""Study of every item that is a result, by name."""


def list_studies() -> list[ThesisItem]:
    """Return all figures and tables that have a study, in the order of the dissertation."""
    return [i for i in THESIS_ITEMS.values() if i.kind == "result"]


def list_studies_by_cost() -> list[str]:
    """Return the names of all studies, the fastest first."""
    return sorted(STUDIES, key=lambda name: STUDIES[name].cost_s)


def run_study(name: str, progress: ProgressCallback | None = None, *, case: Path | None = None) -> StudyOutcome:
    """Run a study by name.

    Parameters
    ----------
    name : str
        Name from :func:`list_studies`, such as ``"fig-3.26"``.
    progress : callable, optional
        ``progress(done, total)``.
    case : Path, optional
        Folder of a solved CFD case, or of several, for Figs 3.22 to 3.24.

    Raises
    ------
    InputError
        If there is no such figure or table, or it shows no result (a photograph, a sketch).
    """
    of = find_item(name)
    if of.name not in STUDIES:
        raise InputError("thesis", of.name, f"is a {of.kind}, not a result", f"mufly thesis show {of.name}")
    began = time.perf_counter()
    found = STUDIES[of.name].compute(progress) if case is None else cfd_studies.run_study_on_cfd_case(of.name, case)
    return StudyOutcome(
        of.name, of.title, found.data, found.verdicts, found.figure, found.note, found.missing,
        time.perf_counter() - began,
    )  # fmt: skip


# ----------------------------------------------------------------------------
# Cache of results.


_DIGEST_LIBRARIES = ("numpy", "scipy", "neuralfoil")


@cache
def _file_digest(file: Path) -> str:
    root = Path(__file__).resolve().parents[1]
    vehicles = (
        sorted(root.glob("thesis/*.toml"))
        + sorted(root.glob("*/builtin/*.toml"))
        + sorted(root.glob("vehicle/maps/*.toml"))
    )
    libraries = [f"{name} {version(name)}" for name in _DIGEST_LIBRARIES]
    return hash_inputs(libraries, *(path.read_bytes() for path in (*imported_sources(file), *vehicles)))[:16]


def hash_study_inputs(name: str) -> str:
    """Return a hash of the inputs of a study: sources, built-in files, versions of libraries."""
    module = next(
        (m for m in _STUDY_MODULES if name in m.STUDIES),
        coaxial_studies if name in _PAIR_STUDIES else single_rotor_studies,
    )
    own = _file_digest(Path(str(module.__file__)))
    return own if name not in _ROTOR_STUDIES else f"{own}-{_file_digest(Path(rotor_figures.__file__))[:8]}"


def load_cached_answer(name: str, folder: Path | None = None) -> StudyAnswer:
    """Return the stored outcome of a figure's or table's study; ``is_answered`` is False if missing or outdated."""
    of = find_item(name)
    if of.kind != "result":
        return StudyAnswer(of, is_answered=True)
    place = cache_folder("thesis") if folder is None else folder
    content = None if place is None else read_stored_result(place / f"{of.name}.json", hash_study_inputs(of.name))
    if place is None or content is None:
        return StudyAnswer(of)
    verdicts = tuple(
        Verdict(Claim(**{**v["claim"], "value": math.nan if v["claim"]["value"] is None else v["claim"]["value"]}),
                v["model"], v["ours"], bool(v["agrees"]), v["rule"])
        for v in content["verdicts"]
    )  # fmt: skip
    seconds = math.nan if content.get("seconds") is None else float(content["seconds"])
    note, missing = str(content.get("note", "")), str(content.get("missing", ""))
    picture = place / f"{of.name}.png"
    return StudyAnswer(of, verdicts, note, missing, seconds, picture if picture.is_file() else None, True)


def load_or_run_study(
    name: str,
    folder: Path | None = None,
    progress: ProgressCallback | None = None,
    *,
    case: Path | None = None,
    again: bool = False,
) -> StudyAnswer:
    """Return the outcome of a figure's or table's study, computed if it is not stored.

    Parameters
    ----------
    name : str
    folder : Path, optional
        Cache instead of the user's; answers in the user's cache are copied to it.
    progress, case : optional
        As for :func:`run_study`; with a case the study is always computed.
    again : bool
        Compute the study even if it is cached.

    Raises
    ------
    InputError
        If there is no such figure or table.
    """
    of, cached = find_item(name), cache_folder("thesis")
    place = folder if folder is not None else cached
    if not again and case is None:
        found = load_cached_answer(of.name, place)
        if found.is_answered:
            return found
        if folder is not None and cached is not None and load_cached_answer(of.name, cached).is_answered:
            folder.mkdir(parents=True, exist_ok=True)
            for file in sorted(cached.glob(f"{of.name}*")):
                if file.stem == of.name or file.stem.startswith(f"{of.name}-"):
                    shutil.copyfile(file, folder / file.name)
            return load_cached_answer(of.name, folder)
    outcome = run_study(of.name, progress, case=case)
    if place is not None:
        outcome.write_files(place)
        if folder is not None and cached is not None and case is None:
            outcome.write_files(cached)
        return load_cached_answer(of.name, place)
    return StudyAnswer(of, tuple(outcome.verdicts), outcome.note, outcome.missing, outcome.computing_time_s, None, True)
