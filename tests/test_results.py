"""Results say what their fields are, in every form."""

import ast
import importlib
import inspect
import itertools
import json
import math
import pkgutil
import subprocess
import sys
import typing
from dataclasses import FrozenInstanceError, is_dataclass

import numpy as np
import pytest

import mufly
from mufly.cli.aero import benchmark
from mufly.results import field_meaning, field_meanings, result, result_rows, to_plain_data
from mufly.results.result_class import _DRAWING_FUNCTIONS
from mufly.study.benchmark.benchmark_scores import RotorScore, ScoreRow
from mufly.study.benchmark.propeller_efficiency import PropellerScore


@result(eq=False)
class Point:
    """A made-up point.

    Attributes
    ----------
    thrust_N, torque_Nm : float
        Of the rotor. More words.
    density : float
        Of the air (kg/m3).
    gain : float
        How much of it; see :func:`abc`.
    loads_N : (n,) array
    part : Part or None
    """

    thrust_N: float
    torque_Nm: float
    density: float
    gain: float
    loads_N: np.ndarray
    part: object = None

    @property
    def thrust_per_power_N_W(self) -> float:
        """Thrust over power."""
        return 0.1


POINT = Point(0.25, math.nan, 1.2, 3.0, np.arange(9.0))


def test_units_come_from_names_and_from_the_docstring() -> None:
    found = field_meanings(Point)
    assert [found[k].unit for k in ("thrust_N", "torque_Nm", "density", "gain")] == ["N", "N m", "kg/m3", ""]
    assert found["thrust_N"].label == "thrust"
    assert found["torque_Nm"].meaning == "Of the rotor. More words."
    assert found["thrust_per_power_N_W"] == (
        "thrust_per_power_N_W",
        "thrust per power",
        "N/W",
        "Thrust over power.",
    )
    assert field_meaning(Point(1, 1, 1, 1, np.ones(1), POINT), "part.thrust_N").unit == "N"


def test_a_result_prints_itself_with_units_and_meaning() -> None:
    lines = str(POINT).splitlines()
    assert lines[0] == "Point: A made-up point."
    assert lines[1].split() == ["thrust", "0.25", "N", "Of", "the", "rotor."]
    assert lines[2].split()[1] == "-"
    assert "9 values, 0 to 8 N" in " ".join(lines[5].split())
    assert "How much of it" in lines[4]
    assert "abc" not in lines[4]
    assert POINT._repr_html_().count("<tr>") == 6
    assert [r.unit for r in result_rows(POINT, ["density"])] == ["kg/m3"]


def test_json() -> None:
    assert json.loads(json.dumps(to_plain_data(POINT)))["torque_Nm"] is None
    assert to_plain_data({"a": [np.float64(1.5), 1 + 2j, POINT]})["a"][1] == {"real": 1.0, "imag": 2.0}


def test_results_are_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        POINT.gain = 1.0  # type: ignore[misc]


def test_a_result_of_the_package_prints_with_units() -> None:
    from mufly.dynamics import find_trim, hover_performance
    from mufly.mission import check_mission_for_vehicle, load_mission
    from mufly.vehicle import load_vehicle

    vehicle = load_vehicle("mufly-1.1")
    lines = str(check_mission_for_vehicle(vehicle, load_mission("box-on-leg"))).splitlines()
    assert lines[0].startswith("MissionEstimate: ")
    assert any(line.split()[:1] == ["duration"] and " s " in f"{line} " for line in lines)
    assert " upper, 0.509 lower N" in str(hover_performance(vehicle))  # columns of its own choice
    assert str(find_trim(vehicle)).startswith("steady at")  # its own words


# Dataclasses that public functions return and that are no answers: what goes in, what runs, what is sent over a wire.
_NO_RESULTS = {
    "camera": "Floor FloorSource PackageFloor RecordedPictures",  # made to be rendered, or looked at
    "cfd": "BladeGeometry SectorMesh OperatingPoint PolyMesh",  # shapes and cases; draw_mesh draws them
    "estimate": "Estimate EstimateCheckState",  # of one instant, a thousand times a second
    "identify": "UniformLogTable FreeParameter",
    "firmware": "FixedPointLaw EvidenceSection",
    "flight": "Estimate RecordingLayout TrajectoryLimits Readings Truth",
    "flight.monte_carlo": "FlightCase ParameterVariation",
    "link": "MissionAck MissionClearAll Command MissionCount Endpoint MissionItem GlobalOrigin MissionWithItems "
    "MissionRequestItem MissionRequestList",
    "logs": "RecordingLayout McapContents RawLog",
    "mission": "RequestAnswer MissionItem PlannedLeg MissionPlan MissionState MissionTiming Reference "
    "CubicSpline Trajectory",
    "rotor": "Blading",
    "bench": "ColumnMeaning",
    "sensors": "Fault Readings Truth",
    "slam": "CameraFrame VehicleMotion VehiclePath MapView FrameSource FrameEstimate",  # what goes in; a map to draw
    "station": "",
    "study": "OperatingCondition DesignLimit RotorSystem",
    "thesis": "ThesisItem",
    "world": "Box",
}


_NO_ROOMS = ("cli", "compiled", "files", "quantities", "results")
"""Folders whose functions answer no question of a design: commands, and what all rooms stand on."""


def _rooms() -> list[str]:
    found = [m.name for m in pkgutil.iter_modules(mufly.__path__) if m.ispkg and m.name not in _NO_ROOMS]
    return [*found, "flight.monte_carlo", "rotor.wake"]


def _classes(annotation: object) -> typing.Iterator[type]:
    if inspect.isclass(annotation):
        yield annotation
    for part in typing.get_args(annotation):
        yield from _classes(part)


@pytest.mark.parametrize("room", _rooms())
def test_every_answer_of_a_public_function_shows_and_draws_itself(room: str) -> None:
    from matplotlib.figure import Figure

    module = importlib.import_module(f"mufly.{room}")
    bare: set[str] = set()
    for name in module.__all__:
        function = getattr(module, name)
        if not inspect.isfunction(function):
            continue
        home = {
            **vars(mufly.vehicle),
            **vars(module),
            **vars(sys.modules[function.__module__]),
            "Figure": Figure,
        }
        for cls in _classes(eval(function.__annotations__["return"], home)):
            shows = callable(getattr(cls, "plot", None)) and hasattr(cls, "_repr_html_")
            if cls.__module__.startswith("mufly.") and is_dataclass(cls) and not shows:
                bare.add(cls.__name__)
    assert bare <= set(_NO_RESULTS.get(room, "").split()), "mark them with @result, or say here what they are"


def test_results_draw_themselves() -> None:
    from mufly.drive import find_operating_point, load_drive, make_blade_load
    from mufly.dynamics import hover_performance
    from mufly.rotor import (
        RotorMeasurements,
        compare_measurements,
        compute_polar,
        load_airfoil,
        load_rotor,
        prepare_blading,
        solve_rotor,
    )

    rotor = load_rotor("naca0012-r60-c20")
    point = solve_rotor(rotor, pitch_rad=0.2, speed_rad_s=500.0)
    one = np.array([0.2]), np.array([500.0]), np.array([0.2]), np.array([0.002])
    met = find_operating_point(
        load_drive("mufly"),
        make_blade_load(prepare_blading(rotor), pitch_rad=0.2),
        duty=np.linspace(0.5, 1, 9),
    )
    vehicle = mufly.load_vehicle("mufly-1.1")
    drawn = {
        "a table": result(type("Words", (), {"__doc__": "Words.", "__annotations__": {"text": str}}))("only words"),
        "bars": hover_performance(vehicle),
        "lines": POINT,
        "over the duty": met,
        "of its own": point,
        "compared": compare_measurements(rotor, RotorMeasurements(*one, source="a bench")),
        "section": load_airfoil("naca4412"),
        "polar": compute_polar("naca0012"),
    }
    for what, thing in drawn.items():
        figure = thing.plot()
        assert figure.axes, what
        figure.draw_without_rendering()
        assert all(a.get_xlabel() or not a.axison for a in figure.axes if a.get_subplotspec().is_last_row()), what
    labels = {a.get_ylabel() for a in met.plot().axes}
    assert any("N m" in s for s in labels), "units stand at the axes"


def _drawing_functions() -> dict[type, typing.Any]:
    for m in pkgutil.walk_packages(mufly.__path__, "mufly."):
        if not m.name.endswith("__main__"):
            try:
                importlib.import_module(m.name)
            except ModuleNotFoundError as missing:  # an extra that is not installed
                if (missing.name or "mufly").startswith("mufly"):
                    raise
    return {cls: f for cls, f in _DRAWING_FUNCTIONS.items() if cls.__module__.startswith("mufly.")}


def _hints(function: typing.Any) -> dict[str, typing.Any]:
    """Types of a drawing function; its module imports matplotlib, and what it only annotates, for type checkers."""
    names = {**vars(sys.modules[function.__module__])}
    while True:
        try:
            return typing.get_type_hints(function, names)
        except NameError as missing:
            names[missing.name] = typing.Any


def test_a_picture_is_drawn_from_the_class_that_it_is_registered_for() -> None:
    found = _drawing_functions()
    assert len(found) > 30
    for cls, function in found.items():
        assert hasattr(cls, "_json"), f"{cls.__qualname__} is no @result"
        first, *others = inspect.signature(function).parameters.values()
        assert cls in _classes(_hints(function)[first.name]), f"{function.__qualname__} takes no {cls.__qualname__}"
        required = [p.name for p in others if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
        assert not required, f"plot() gives {function.__qualname__} a result alone"


def test_a_result_with_a_function_that_draws_it_has_a_picture() -> None:
    """A function draws one result alone, and ``@draws`` is missing: ``plot()`` would draw the plain numbers."""
    found = _drawing_functions()
    modules = [m for name, m in sys.modules.items() if name.startswith("mufly.")]
    bare = {}
    for function in {f for m in modules for f in vars(m).values() if inspect.isfunction(f)}:
        if function.__module__.startswith("mufly.") and function.__name__.startswith(("draw_", "plot_")):
            first, *others = inspect.signature(function).parameters.values() or [None]
            if first is not None and all(p.default is not p.empty for p in others):
                drawn = _hints(function).get(first.name)
                if inspect.isclass(drawn) and hasattr(drawn, "_json") and not set(drawn.__mro__) & set(found):
                    bare[drawn.__qualname__] = function.__qualname__
    assert bare == {}


def _top_imports(package: str) -> set[str]:
    """Modules that a package's ``__init__`` loads in its own lines."""
    module = importlib.import_module(package)
    found = set()
    for n in ast.parse(inspect.getsource(module)).body:
        if isinstance(n, ast.ImportFrom):
            found |= {n.module, *(f"{n.module}.{alias.name}" for alias in n.names)}
    return found


def test_the_picture_of_a_result_is_known_wherever_its_class_is() -> None:
    """Python runs the ``__init__`` of a package before any of its modules, so there the picture module is loaded."""
    for cls, function in _drawing_functions().items():
        packages = list(itertools.accumulate(cls.__module__.split(".")[:-1], "{}.{}".format))[1:]
        loads = {cls.__module__}.union(*map(_top_imports, packages))
        assert function.__module__ in loads, f"let {packages[0]} import {function.__module__} for {cls.__qualname__}"


def test_pictures_load_matplotlib_when_they_are_drawn() -> None:
    """Of the rooms whose libraries do not load it themselves; one more half second at each start."""
    rooms = (
        "import mufly.bench, mufly.cfd, mufly.rotor.forward, mufly.study, sys; assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", rooms], check=True)


def test_what_files_hold_is_shown_as_a_table() -> None:
    vehicle = mufly.load_vehicle("mufly-1.1")
    html = vehicle._repr_html_()
    assert "<caption>Vehicle mufly-1.1</caption>" in html
    assert '<td style="text-align:left">mass</td>' in html
    assert "[rotors.upper]" in html
    assert any(line.split()[:4] == ["mass", "m", "0.095", "kg"] for line in str(vehicle).splitlines())


def test_a_vehicle_a_mission_and_a_controller_have_short_representations() -> None:
    """Before: the repr of a controller took 97 000 characters, that of a vehicle 12 000."""
    from mufly import load_vehicle
    from mufly.drive import load_drive
    from mufly.mission import load_mission
    from mufly.rotor import load_rotor

    for one in (
        load_vehicle("mufly-1.1"),
        load_rotor("walkera-5g6"),
        load_drive("mufly"),
        load_mission("demonstration"),
    ):
        shown = repr(one)
        assert one.name in shown.splitlines()[0]
        assert len(shown.splitlines()) <= 10, shown
        assert max(map(len, shown.splitlines())) <= 110, shown
    vehicle = repr(load_vehicle("mufly-1.1"))
    assert "mass 0.095 kg" in vehicle
    assert "radius 0.0875 m" in vehicle


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (benchmark._GROUP_SCORE_FIELDS, ScoreRow),
        (benchmark._ROTOR_SCORE_FIELDS, RotorScore),
        (benchmark._TUNNEL_SCORE_FIELDS, PropellerScore),
    ],
)
def test_the_tables_of_the_rotor_benchmark_take_fields_that_exist(names: str, kind: type) -> None:
    """They are written after minutes of predictions, and no type checker reads their strings."""
    for column in names.split():
        of = kind
        for part in column.split("=")[-1].split("."):
            if part.isdigit():
                break
            known = typing.get_type_hints(of)
            assert part in known or isinstance(getattr(of, part, None), property), column
            of = known.get(part, object)


@pytest.mark.parametrize("width", [30, 60, 200])
def test_a_table_in_a_narrow_terminal_keeps_every_number_whole(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from mufly.cli.output import print_table

    monkeypatch.setenv("COLUMNS", str(width))
    numbers = ("1234567.25 m", "94, 88", "-12.5 (+1.9)", "1e-12 rad/s")
    print_table(("code", "length", "inside 90 %", "thrust (bias)", "rate"), [("bemt, one point seen", *numbers)])
    printed = capsys.readouterr().out
    assert [n for n in numbers if n not in printed] == []
