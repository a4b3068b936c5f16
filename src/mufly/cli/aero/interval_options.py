"""Options of commands that add a prediction interval to computed loads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from mufly.cli.aero.rotor_theory_options import PolarOptions
from mufly.cli.options import define_option
from mufly.errors import InputError

if TYPE_CHECKING:
    from mufly.rotor import PredictionInterval, SystemSolution

FamilyOption = Annotated[
    str,
    define_option(
        "--family NAME",
        "Family of the blade: apc, slow-flyer, gws, hobby, printed or machined. Default: that of the rotor file.",
    ),
]


@dataclass(frozen=True)
class IntervalOptions:
    """Options of a prediction interval; without ``band`` there is none."""

    band: Annotated[
        float | None,
        define_option(
            "--band",
            "Probability of an interval to add: 0.5, 0.8, 0.9 or 0.95 (nominal; docs/accuracy.md has the "
            "measured coverage).",
            unit="1",
        ),
    ] = None
    section: Annotated[
        Literal["known", "guessed", "measured"],
        define_option(
            "--section NAME",
            "Knowledge of the sections, for --band: 'known' airfoils, 'guessed' ones (the mean over "
            "likely sections is printed), or 'measured' (a rotor that `mufly rotor fit` wrote).",
        ),
    ] = "known"
    family: FamilyOption = ""

    def __post_init__(self) -> None:
        if self.band is None:
            for option, value in (("--section", self.section), ("--family", self.family)):
                if value not in ("known", ""):
                    raise InputError(option, value, "applies to an interval only", "add --band 0.9")

    def predict_interval(self, solution: SystemSolution, theory: PolarOptions) -> PredictionInterval | None:
        """Return the interval of the loads of each rotor at a solved point; None without ``--band``."""
        from mufly.rotor import predict_system_interval

        if self.band is None:
            return None
        return predict_system_interval(
            solution, level=self.band, corrections=theory.select_corrections(), n_crit=theory.n_crit,
            engine=theory.engine, section=self.section, family=self.family,
        )  # fmt: skip


DEFAULT_INTERVAL_OPTIONS = IntervalOptions()
