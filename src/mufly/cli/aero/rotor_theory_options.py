"""Options of commands that compute rotors by blade elements, vortex tubes or a vortex wake, and the wake's progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from mufly.cli.options import ModelOption, define_option
from mufly.cli.output import make_console, save_figure, write_csv
from mufly.errors import InputError, suggest_name
from mufly.quantities.quantity_grammar import parse_integer, parse_quantity
from mufly.quantities.units import split_unit_suffix

if TYPE_CHECKING:
    from mufly.rotor import Blading, Corrections, Rotor, SystemSolution
    from mufly.rotor.wake import WakeSettings
    from mufly.study import StudySetup
    from mufly.study.study_parameters import ParameterValue

_INTEGER_WAKE_SETTINGS = ("phases", "iterations", "stations")


@dataclass(frozen=True)
class PolarOptions:
    """Options of blade element calculations."""

    n_crit: Annotated[
        float,
        define_option(
            "--n-crit NUMBER",
            "Amplification exponent of transition (e^N): 0.1 for a vibrating rotor, 9 for a quiet wind tunnel.",
        ),
    ] = 0.1
    engine: Annotated[
        Literal["neuralfoil", "xfoil", "table"],
        define_option("--engine NAME", "Polars: 'neuralfoil', 'table' or, where installed, 'xfoil'."),
    ] = "neuralfoil"
    model: ModelOption = "full"

    def select_corrections(self) -> Corrections:
        """Return the corrections that ``--model`` selects."""
        from mufly.study import BEMT_MODELS

        return BEMT_MODELS[self.model]

    def prepare_blading(self, rotor: Rotor, stations: int | None = None) -> Blading:
        """Return a blading of a rotor with its polars."""
        from mufly.rotor import prepare_blading
        from mufly.rotor.blading import STATION_COUNT

        return prepare_blading(
            rotor, n_crit=self.n_crit, engine=self.engine, corrections=self.select_corrections(),
            stations=stations or STATION_COUNT,
        )  # fmt: skip

    def make_study_setup(self, rotor: str, fixed: Mapping[str, ParameterValue], **more: Any) -> StudySetup:
        """Return the setup shared by all cases of a study of a rotor or, with ``lower`` in ``more``, of a pair."""
        from mufly.rotor import load_rotor
        from mufly.study import StudySetup

        return StudySetup(
            load_rotor(rotor), fixed_parameters={"n_crit": self.n_crit, **fixed}, corrections=self.select_corrections(),
            polar_engine=self.engine, **more,
        )  # fmt: skip


@dataclass(frozen=True)
class WakeOptions(PolarOptions):
    """Command-line options of vortex wakes."""

    method: Literal["bemt", "tubes", "wake", "cfd"] = "wake"  # no option here, but one in TheoryOptions
    wake_geometry: Annotated[
        Literal["free", "prescribed"],
        define_option("--wake NAME", "Wake geometry: 'free', or 'prescribed' (Landgrebe's, for slender blades)."),
    ] = "free"
    wake_set: Annotated[
        list[str] | None,
        define_option(
            "--wake-set NAME=VALUE",
            "Setting of the wake, as step_deg=10, turns=6, core=0.05, iterations=300, or stations=30 for "
            "each blade. Repeat it for more.",
        ),
    ] = None

    def wake_settings_and_stations(self, **defaults: float) -> tuple[WakeSettings, int]:
        """Return settings of the wake and the number of stations along a blade; ``--wake-set`` overrides ``defaults``.

        Raises
        ------
        InputError
            If an option is unknown or out of range.
        """
        from mufly.rotor.blading import STATION_COUNT
        from mufly.rotor.wake import WakeSettings

        if self.method != "wake" and self.wake_geometry != "free":
            raise InputError("--wake", "", "blade element theory has no wake", "add --method wake")
        known = [f.name for f in fields(WakeSettings) if f.name not in ("model", "inviscid")]
        given: dict[str, Any] = {**defaults}
        for text in self.wake_set or []:
            name, equals, value = (part.strip() for part in text.partition("="))
            if not equals or name not in (*known, "stations"):
                otherwise = f"use NAME=VALUE with {', '.join(known)}, stations"
                remedy = suggest_name(name, [*known, "stations"], otherwise) if equals else otherwise
                raise InputError("--wake-set", text, "is unknown", remedy)
            where = f"--wake-set: {name}"
            unit = split_unit_suffix(name)[1]
            given[name] = (
                parse_integer(where, value) if name in _INTEGER_WAKE_SETTINGS else parse_quantity(where, value, unit)
            )
        stations = given.pop("stations", STATION_COUNT)
        if not 4 <= stations <= 200:
            raise InputError("--wake-set", "stations", f"is {stations}", "give 4 to 200 stations")
        return WakeSettings(model=self.wake_geometry, **given), stations

    def make_study_setup(self, rotor: str, fixed: Mapping[str, ParameterValue], **more: Any) -> StudySetup:
        """Return the setup shared by all cases of a study of a rotor or, with ``lower`` in ``more``, of a pair."""
        wake, stations = self.wake_settings_and_stations()
        return super().make_study_setup(
            rotor, fixed, method=self.method, wake_settings=wake, station_count=stations, **more
        )


@dataclass(frozen=True)
class TheoryOptions(WakeOptions):
    """Options of commands that compute rotors by blade elements, vortex tubes or a vortex wake."""

    method: Annotated[
        Literal["bemt", "tubes", "wake"],
        define_option(
            "--method NAME", "Method: 'bemt' (blade elements), 'tubes' (vortex tubes) or 'wake' (vortex wake, seconds)."
        ),
    ] = "bemt"


DEFAULT_POLAR_OPTIONS, DEFAULT_WAKE_OPTIONS, DEFAULT_BEMT_OPTIONS, DEFAULT_FREE_WAKE_OPTIONS = (
    PolarOptions(),
    WakeOptions(),
    TheoryOptions(),
    TheoryOptions(method="wake"),
)


class WakeIterationRecorder:
    """Recorder of the iterations of one or several successive wakes; the solver calls it after each iteration."""

    def __init__(self, show: Callable[[str], None] | None = None) -> None:
        self.rows: list[tuple[int, int, float, float]] = []  # wake, iteration, residual, thrust
        self.wake_count = 0
        self._show = show

    def __call__(self, iteration: int, residual: float, thrust: float) -> None:
        """Record one iteration."""
        self.wake_count += iteration == 1
        self.rows.append((self.wake_count, iteration, residual, thrust))
        if self._show is not None:
            # A residual above 9 marks the first revolutions of a free wake, held in the prescribed shape.
            miss = "still prescribed" if residual > 9.0 else f"misses the air by {100 * residual:.2g} %"
            self._show(f"wake {self.wake_count}, iteration {iteration}: {miss}, thrust {thrust:.4g} N")


@contextmanager
def show_wake_progress(label: str, shown: bool, folder: Path | None = None) -> Iterator[WakeIterationRecorder]:
    """Report the iterations of a wake on standard error; after a stop or failure its history is left in the folder."""
    try:
        if not shown:
            progress = WakeIterationRecorder()
            yield progress
        else:
            with make_console(stderr=True).status(label) as status:
                progress = WakeIterationRecorder(lambda text: status.update(f"{label}: {text}"))
                yield progress
    except BaseException:
        if folder is not None and progress.rows:
            heads = ("wake", "iteration", "residual", "thrust_N")
            write_csv(folder / "progress.csv", heads, progress.rows)
        raise


def write_wakes(solution: SystemSolution, folder: Path) -> list[Path]:
    """Write the histories of a solution's wakes and, if converged, their geometry and velocity field."""
    from mufly.rotor import draw_flow_field, draw_wake, draw_wake_convergence

    assert solution.settings is not None
    sides = ("",) if len(solution.rotors) == 1 else ("upper_", "lower_")
    heads = ["residual", *(f"{side}{load}" for side in sides for load in ("thrust_N", "torque_Nm"))]
    history = draw_wake_convergence(solution.history, residual=solution.settings.residual, note=solution.message)
    files = [write_csv(folder / "history.csv", heads, solution.history), save_figure(history, folder, "history")]
    if solution.converged:
        files.append(save_figure(draw_wake(solution), folder, "wake"))
        files.append(save_figure(draw_flow_field(solution), folder, "air"))
        files.append(save_figure(draw_flow_field(solution, mean=False), folder, "air-instant"))
    return files
