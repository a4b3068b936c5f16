"""Named studies: tables and figures of the dissertation, repeated, with a verdict on each of their claims."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from mufly.errors import InputError
from mufly.study import TABLE_3_3, write_results
from mufly.study.sweeps import Progress
from mufly.thesis import coaxial, pictures
from mufly.thesis import coaxial as coaxial_verdicts
from mufly.thesis import pictures as coaxial_pictures
from mufly.thesis.claims import Verdict
from mufly.thesis.single import (
    SECTIONS,
    SWEEPS,
    airfoil_ranking,
    coefficients_over_speed,
    muflys_gear,
    run_sweep,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS_RUN = ("full", "thesis")


@dataclass(frozen=True)
class StudyName:
    """One line of the list of studies."""

    name: str
    title: str
    section: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a study found.

    Attributes
    ----------
    name, title : str
    data : mapping
        Model to results; empty where only contours are drawn.
    verdicts : sequence of Verdict
    figure : Figure
    """

    name: str
    title: str
    data: Mapping[str, xr.Dataset]
    verdicts: Sequence[Verdict]
    figure: Figure

    def write(self, folder: str | Path) -> list[Path]:
        """Write picture, tables (NetCDF, CSV) and ``NAME.json`` with the verdicts; return the files.

        Raises
        ------
        InputError
            If the folder cannot be written.
        """
        target = Path(folder)
        files: list[Path] = []
        try:
            target.mkdir(parents=True, exist_ok=True)
            picture, note = target / f"{self.name}.png", target / f"{self.name}.json"
            self.figure.savefig(picture, dpi=150)
            note.write_text(json.dumps(self.to_dict(), indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(
                str(folder), "", f"cannot be written ({error})", "give another folder"
            ) from error
        for model, data in self.data.items():
            files += write_results(data, target, f"{self.name}-{model}" if len(self.data) > 1 else self.name)
        return [picture, note, *files]

    def to_dict(self) -> dict[str, object]:
        """Return name, title and verdicts; a claim without a number has the value null."""
        verdicts = []
        for v in self.verdicts:
            content = asdict(v)
            if content["claim"]["value"] != content["claim"]["value"]:
                content["claim"]["value"] = None
            verdicts.append(content)
        return {"name": self.name, "title": self.title, "verdicts": verdicts}


def _sweep(name: str, progress: Progress | None) -> Outcome:
    study = SWEEPS[name]
    data, verdicts = {}, []
    for k, model in enumerate(MODELS_RUN):
        data[model], found = run_sweep(study, model)
        verdicts += found
        if progress is not None:
            progress(k + 1, len(MODELS_RUN))
    return Outcome(
        name, study.title, data, verdicts, pictures.pitch_figure(data, f"{_where(name)}: {study.title}")
    )


def _gear(name: str, progress: Progress | None) -> Outcome:
    data, verdicts = muflys_gear()
    title = "Gear ratio of muFly's drive"
    return Outcome(
        name, title, {"constant": data}, verdicts, pictures.gear_figure(data, f"{_where(name)}: {title}")
    )


def _coefficients(name: str, progress: Progress | None) -> Outcome:
    data, verdicts = {}, []
    for model in MODELS_RUN:
        data[model], found = coefficients_over_speed(model)
        verdicts += found
    title = "Coefficients over the speed"
    return Outcome(
        name, title, data, verdicts, pictures.coefficients_figure(data, f"{_where(name)}: {title}")
    )


def _ranking(name: str, progress: Progress | None) -> Outcome:
    data, verdicts = {}, []
    for k, model in enumerate(MODELS_RUN):
        offset = k

        def step(done: int, total: int, offset: int = offset) -> None:
            if progress is not None:
                progress(done + offset * total, len(MODELS_RUN) * total)

        data[model], found = airfoil_ranking(model, step)
        verdicts += found
    title = "247 airfoils on the standard blade"
    return Outcome(
        name, title, data, verdicts, pictures.ranking_figure(data, TABLE_3_3, f"{_where(name)}: {title}")
    )


# Name -> title, computation, verdicts, picture.
_PAIRS: dict[str, tuple[str, Callable[..., xr.Dataset], Callable[..., list[Verdict]], Callable[..., Figure]]] = {
    "fig-3.43": (
        "Coaxial pair at equal speeds", coaxial.equal_speeds, coaxial_verdicts.judge_equal_speeds,
        coaxial_pictures.equal_speeds_figure,
    ),
    "fig-3.44": (
        "Coaxial pair, one speed kept", coaxial.one_speed_kept, coaxial_verdicts.judge_kept_speed,
        coaxial_pictures.kept_speed_figure,
    ),
    "table-3.4": (
        "Coaxial pair with equal torques", coaxial.torque_balance, coaxial_verdicts.judge_balance,
        coaxial_pictures.balance_figure,
    ),
    "fig-3.45": (
        "Distance of the rotors of a pair", coaxial.distances, coaxial_verdicts.judge_distances,
        coaxial_pictures.distances_figure,
    ),
}  # fmt: skip


def _pair(name: str, progress: Progress | None) -> Outcome:
    title, compute, judge, draw = _PAIRS[name]
    data, verdicts = {}, []
    for k, model in enumerate(coaxial.COAXIAL_MODELS):
        offset = k

        def step(done: int, total: int, offset: int = offset) -> None:
            if progress is not None:
                progress(done + offset * total, len(coaxial.COAXIAL_MODELS) * total)

        data[model] = compute(model, progress=step)
        verdicts += judge(model, data[model])
    return Outcome(name, title, data, verdicts, draw(data, f"{_where(name)}: {title}"))


def _sections(name: str, progress: Progress | None) -> Outcome:
    title, names = SECTIONS[name]
    return Outcome(name, title, {}, [], pictures.sections_figure(names, f"{_where(name)}: {title}"))


def _where(name: str) -> str:
    kind, _, number = name.partition("-")
    return f"{'Fig.' if kind == 'fig' else 'Table'} {number}"


_Runner = Callable[[str, Progress | None], Outcome]
_STUDIES: dict[str, tuple[str, str, _Runner]] = {
    "fig-3.7": ("Gear ratio of muFly's drive", "3.1.4", _gear),
    "fig-3.25": ("Coefficients over the speed", "3.3.4", _coefficients),
    **{
        name: (study.title, section, _sweep)
        for (name, study), section in zip(
            SWEEPS.items(),
            ("3.4.1", "3.4.2", "3.4.2", "3.4.3", "3.4.3", "3.4.3", "3.4.4", "3.4.4"),
            strict=True,
        )
    },
    **{name: (title, "3.4.3", _sections) for name, (title, _) in SECTIONS.items()},
    "table-3.3": ("247 airfoils on the standard blade", "3.4.3", _ranking),
    **{name: (entry[0], "3.4.7", _pair) for name, entry in _PAIRS.items()},
}


def studies() -> list[StudyName]:
    """Return the names of all studies, in the order of the dissertation."""
    rows = [StudyName(name, title, section) for name, (title, section, _) in _STUDIES.items()]
    return sorted(
        rows,
        key=lambda s: ([int(n) for n in s.section.split(".")], s.name.partition("-")[0], _number(s.name)),
    )


def _number(name: str) -> tuple[int, int]:
    chapter, _, figure = name.partition("-")[2].partition(".")
    return int(chapter), int(figure)


def run_study(name: str, progress: Progress | None = None) -> Outcome:
    """Run a study by name.

    Parameters
    ----------
    name : str
        One that :func:`studies` lists, as ``"fig-3.26"``.
    progress : callable, optional
        ``progress(done, total)``.

    Raises
    ------
    InputError
        If there is no such study.
    """
    if name not in _STUDIES:
        raise InputError("thesis", name, "is no study", f"use one of: {', '.join(s.name for s in studies())}")
    return _STUDIES[name][2](name, progress)
