"""Words that an option takes are those of the room's own table or type: a word added there is offered here."""

from collections.abc import Iterable
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import pytest

from mufly.bench.rig.simulated_rig import SIMULATED_FAULTS
from mufly.bench.series.series_plan import SIDES_BY_AXIS
from mufly.bridges.px4.px4_messages import PositionSource
from mufly.camera.live_pictures import PictureClock
from mufly.cfd.meshes.sector_mesh import MESH_LEVELS
from mufly.cfd.openfoam_case import TURBULENCE_MODELS
from mufly.cli import coax, fly, log, monte_carlo, rotor
from mufly.cli.aero import bench_series, cfd, interval_options, measured_rotors, rotor_theory_options
from mufly.cli.identify import flight as identify
from mufly.cli.onboard import link, slam
from mufly.identify.flight.output_error_problem import DynamicsPart
from mufly.identify.flight.staged_search import FitMethod
from mufly.link.real_time.real_time_loop import SensorMode
from mufly.rotor.measured.uncertainty import SECTION_KNOWLEDGE_LEVELS
from mufly.rotor.rotor_system import SolverMethod
from mufly.rotor.sections.polar_engines import PolarEngine
from mufly.rotor.wake import WakeSettings
from mufly.slam import WRITABLE_DATASET_LAYOUTS
from mufly.station.recording_comparison import ALIGNMENT_EVENTS
from mufly.study import BEMT_MODELS

SOLVERS = get_args(SolverMethod)
CASES: list[tuple[Any, str, Iterable[str]]] = [
    (bench_series.plan, "axis", SIDES_BY_AXIS),
    (bench_series.run, "fault", SIMULATED_FAULTS),
    (cfd.BladeOptions, "level", MESH_LEVELS),
    (cfd.CaseOptions, "model", TURBULENCE_MODELS),
    (coax.MapOptions, "method", set(SOLVERS) - {"tubes"}),  # a map has no tubes
    (fly.fly_mission, "sensors", get_args(SensorMode)),
    (link.run_link, "sensors", get_args(SensorMode)),
    (link.run_link, "position", get_args(PositionSource)),
    (monte_carlo.run_monte_carlo, "sensors", get_args(SensorMode)),
    (identify.flight, "part", (*get_args(DynamicsPart), "split")),
    (identify.flight, "method", get_args(FitMethod)),
    (identify.demo, "method", get_args(FitMethod)),
    (log.plot, "align", ALIGNMENT_EVENTS),
    (rotor_theory_options.PolarOptions, "model", BEMT_MODELS),
    (rotor_theory_options.WakeOptions, "wake_geometry", get_args(get_type_hints(WakeSettings)["model"])),
    (rotor_theory_options.PolarOptions, "engine", get_args(PolarEngine)),
    (rotor_theory_options.TheoryOptions, "method", SOLVERS),
    (rotor.HoverOptions, "method", (*SOLVERS, "cfd")),
    (interval_options.IntervalOptions, "section", SECTION_KNOWLEDGE_LEVELS),
    (measured_rotors.fit, "section", set(SECTION_KNOWLEDGE_LEVELS) - {"measured"}),  # what a fit writes
    (slam.render, "layout", WRITABLE_DATASET_LAYOUTS),
    (slam.run, "clock", get_args(PictureClock)),
]


def offered_words(owner: Any, name: str) -> tuple[str, ...]:
    kind = get_type_hints(owner, include_extras=True)[name]
    inner = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    return next(get_args(k) for k in (inner, *get_args(inner)) if get_origin(k) is Literal)


@pytest.mark.parametrize(("owner", "name", "known"), CASES, ids=lambda x: getattr(x, "__qualname__", None))
def test_choices_are_those_of_the_room(owner: Any, name: str, known: Iterable[str]) -> None:
    assert sorted(offered_words(owner, name)) == sorted(known)
