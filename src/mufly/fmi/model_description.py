"""``modelDescription.xml``, ``buildDescription.xml`` and ``documentation/index.html`` of a unit (FMU).

Source: Functional Mock-up Interface Specification 3.0.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

from mufly.compiled.toolchain import COMPILER_FLAGS
from mufly.errors import MuflyError
from mufly.fmi.unit_sensors import SENSOR_RATE_HZ
from mufly.fmi.unit_sources import FILTER_SOURCES, UNIT_SOURCE
from mufly.fmi.unit_variables import UnitInterface, UnitVariable
from mufly.quantities.units import unit_conversion
from mufly.results.report_page import render_report_template
from mufly.vehicle import Vehicle
from mufly.version import __version__

_FMI_VERSION = "3.0"
_COMMON_OBSERVATION_UNITS: dict[str, dict[str, int]] = {
    "kg": {"kg": 1}, "m": {"m": 1}, "s": {"s": 1}, "A": {"A": 1}, "rad": {"rad": 1}, "m2": {"m": 2}, "s^2": {"s": 2},
    "N": {"kg": 1, "m": 1, "s": -2}, "V": {"kg": 1, "m": 2, "s": -3, "A": -1}, "m3": {"m": 3},
    "ohm": {"kg": 1, "m": 2, "s": -3, "A": -2}, "Pa": {"kg": 1, "m": -1, "s": -2}, "T": {"kg": 1, "s": -2, "A": -1},
}  # fmt: skip
"""Exponents of FMI's base units in the units of vehicle files."""
_STOP_TIME_S, _STEP_SIZE_S = 10.0, 0.01  # of the default experiment


def model_identifier(vehicle: Vehicle) -> str:
    """Return the name of a vehicle's unit: a C identifier, which is also the name of its library."""
    name = re.sub(r"\W", "_", vehicle.name, flags=re.ASCII)
    return name if name[:1].isalpha() else f"vehicle_{name}"


def unit_exponents(unit: str) -> dict[str, int]:
    """Return the exponents of FMI's base units in a unit of a vehicle file.

    Raises
    ------
    MuflyError
        If a part of the unit is unknown.
    """
    out: dict[str, int] = {}
    over, _, under = unit.partition("/")
    for text, sign in ((over, 1), (under, -1)):
        for part in text.split():
            if part == "1":
                continue
            if part not in _COMMON_OBSERVATION_UNITS:
                raise MuflyError(f"the unit {unit!r} has no form in FMI's base units")
            for base, power in _COMMON_OBSERVATION_UNITS[part].items():
                out[base] = out.get(base, 0) + sign * power
    return {base: power for base, power in out.items() if power}


def render_model_description(vehicle: Vehicle, interface: UnitInterface, token: str) -> str:
    """Return the text of ``modelDescription.xml``."""
    root = ElementTree.Element("fmiModelDescription", {
        "fmiVersion": _FMI_VERSION, "modelName": vehicle.name, "instantiationToken": token,
        "description": vehicle.description or f"coaxial micro helicopter {vehicle.name}", "version": __version__,
        "author": "The mufly developers", "license": "BSD-3-Clause", "generationTool": f"mufly {__version__}",
        "variableNamingConvention": "structured",
    })  # fmt: skip
    ElementTree.SubElement(root, "CoSimulation", {
        "modelIdentifier": model_identifier(vehicle), "canGetAndSetFMUState": "true", "canSerializeFMUState": "true",
        "canHandleVariableCommunicationStepSize": "true",
    })  # fmt: skip
    _add_units(ElementTree.SubElement(root, "UnitDefinitions"), interface)
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", {"name": "logStatusError", "description": "errors"})
    experiment = {"startTime": 0.0, "stopTime": _STOP_TIME_S, "stepSize": _STEP_SIZE_S}
    ElementTree.SubElement(root, "DefaultExperiment", {name: f"{value:g}" for name, value in experiment.items()})
    variables = ElementTree.SubElement(root, "ModelVariables")
    time = {"name": "time", "valueReference": "0", "causality": "independent", "variability": "continuous", "unit": "s"}
    ElementTree.SubElement(variables, "Float64", {**time, "description": "simulation time"})
    for reference, variable in enumerate(interface.variables, 1):
        ElementTree.SubElement(variables, "Float64", _variable_attributes(reference, variable))
    structure = ElementTree.SubElement(root, "ModelStructure")
    references = {v.name: str(k) for k, v in enumerate(interface.variables, 1)}
    outputs = [v for v in interface.variables if v.role == "output"]
    for v in outputs:
        dependencies = " ".join(references[name] for name in v.inputs)
        ElementTree.SubElement(
            structure, "Output", {"valueReference": references[v.name], "dependencies": dependencies}
        )
    for v in outputs:
        ElementTree.SubElement(structure, "InitialUnknown", {"valueReference": references[v.name]})
    return _xml_to_text(root)


def _add_units(parent: ElementTree.Element, interface: UnitInterface) -> None:
    shown: dict[str, set[str]] = {"s": set()}
    for v in interface.variables:
        if v.unit:
            shown.setdefault(v.unit, set()).update({v.display_unit} - {""})
    for unit, display_units in sorted(shown.items()):
        element = ElementTree.SubElement(parent, "Unit", {"name": unit})
        exponents = {base: str(power) for base, power in unit_exponents(unit).items()}
        ElementTree.SubElement(element, "BaseUnit", exponents)
        for name in sorted(display_units):
            factor = repr(unit_conversion(unit, name)[1])
            ElementTree.SubElement(element, "DisplayUnit", {"name": name, "factor": factor})


def _variable_attributes(reference: int, v: UnitVariable) -> dict[str, str]:
    causality = v.role if v.role in ("input", "output") else "parameter"
    variability = {"parameter": "tunable", "start": "fixed", "step": "fixed", "seed": "fixed"}.get(v.role, "continuous")
    out = {
        "name": v.name, "valueReference": str(reference), "causality": causality, "variability": variability,
        "description": v.description,
    }  # fmt: skip
    if v.unit:
        out["unit"] = v.unit
    if v.display_unit:
        out["displayUnit"] = v.display_unit
    if v.role == "output":
        return {**out, "initial": "calculated"}
    if v.role != "input":
        limits = {"min": v.lowest, "max": v.highest}
        out |= {name: repr(value) for name, value in limits.items() if abs(value) < 1e300}
    return {**out, "start": repr(v.start)}


def render_build_description(vehicle: Vehicle, has_sensors: bool = False) -> str:
    """Return the text of ``sources/buildDescription.xml``."""
    root = ElementTree.Element("fmiBuildDescription", {"fmiVersion": _FMI_VERSION})
    configuration = ElementTree.SubElement(root, "BuildConfiguration", {
        "modelIdentifier": model_identifier(vehicle),
        "description": "Compile without contraction of multiplications and additions (-ffp-contract=off; the source "
        "has pragmas for Clang and MSVC) and without -ffast-math: results then equal mufly's, to the last bit.",
    })  # fmt: skip
    files = ElementTree.SubElement(configuration, "SourceFileSet", {
        "language": "C99", "compiler": "gcc", "compilerOptions": " ".join(COMPILER_FLAGS),
    })  # fmt: skip
    for name in (UNIT_SOURCE, *(FILTER_SOURCES if has_sensors else ())):
        ElementTree.SubElement(files, "SourceFile", {"name": name})
    if has_sensors:
        ElementTree.SubElement(files, "IncludeDirectory", {"name": "."})
    about = "mathematics of the C library, where that is a library of its own"
    ElementTree.SubElement(configuration, "Library", {"name": "m", "external": "true", "description": about})
    return _xml_to_text(root)


def _xml_to_text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


_DOCUMENTATION_BODY = """
<p>{{ vehicle.description }}</p>
<p>FMI 3.0 co-simulation unit of the flight model of mufly {{ version }}: rigid body, two rotors, motors, battery,
swash plate, stabiliser bar, wind, and contact with the floor at position_down = 0. Axes: north, east, down; body x
forward, y right, z down. Between two communication points the inputs are constant. The state is integrated by
Runge-Kutta's method of fourth order with steps of at most <code>solver.step</code>.</p>
<p>{{ start }} The unit has no autopilot: with constant inputs the helicopter drifts away.</p>
<p>Results equal those of <code>mufly.dynamics.integrate_state</code>, to the last bit, if the unit is compiled without
contraction of multiplications and additions, and sine and cosine come from the same C library.
<code>resources/vehicle.toml</code> is the vehicle file. <code>sources/buildDescription.xml</code> describes the
compilation for other platforms.</p>
{% for title, rows in sections if rows %}
<h2>{{ title }}</h2>
{{ table(["name", "start", "unit", "meaning"], rows, numbers=[1]) }}
{% endfor %}
<h2>Fixed in this unit</h2>
<p>A change of these keys of the vehicle file needs a new export: {% for key in fixed_keys %}
<code>{{ key }}</code>{{ "." if loop.last else ", " }}
{% endfor %}</p>
"""
_START_NOTE_WITH_SENSORS = (
    f"At the start the helicopter stands on the floor. Sensors and filter run at {SENSOR_RATE_HZ:g} Hz. Parameters "
    f"act on the "
    "flight model, while sensors and filter keep the vehicle file's. The filter's C sources are those that fly on "
    "board. The sonar reads NaN without an echo."
)
_SECTION_TITLES = {
    "input": "Inputs", "output": "Outputs", "start": "Start values, until the end of initialisation",
    "step": "Integration, until the end of initialisation", "seed": "Sensors, until the end of initialisation",
    "parameter": "Parameters, at any time",
}  # fmt: skip


def render_documentation_page(vehicle: Vehicle, interface: UnitInterface) -> str:
    """Return the text of ``documentation/index.html``."""
    sections = [
        (
            title,
            [
                (v.name, "" if role == "output" else f"{v.start:.6g}", v.unit, v.description)
                for v in interface.variables
                if v.role == role
            ],
        )
        for role, title in _SECTION_TITLES.items()
    ]
    return render_report_template(
        vehicle.name,
        _DOCUMENTATION_BODY,
        vehicle=vehicle,
        version=__version__,
        start=_START_NOTE_WITH_SENSORS if interface.count_variables("seed") else "The start values are those of hover.",
        sections=sections,
        fixed_keys=interface.fixed_keys,
    )
