"""Twins: the flight software in C stands in the folders of the Python packages that it translates."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

import pytest

import mufly
from mufly.control import design_flight_controller
from mufly.firmware import export_firmware
from mufly.firmware.export.source_export import SOFTWARE_SOURCES, copy_fixed_point_sources, find_sources
from mufly.firmware.proof.evidence_report import parse_deviations
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

PACKAGE = Path(mufly.__file__).parent
MAX_FILES = 15
PARTS = {
    "control/cascade": "control/law",
    "control/linear": "control/law",
    "control/mixer": "control/law",
    "dynamics/flight_model": "dynamics/equations_of_motion",
    "flight/failsafe": "flight/flight_software",
}
"""C files whose Python stands in a file of another name."""


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    folder = tmp_path_factory.mktemp("twins") / "fw"
    vehicle, mission = load_vehicle("mufly-1.1"), load_mission("demonstration")
    controller = design_flight_controller(vehicle)
    export_firmware(controller, folder, vehicle, mission.world, mission)
    copy_fixed_point_sources(folder)
    return folder


def test_every_folder_can_be_read_at_a_glance(tree) -> None:
    counts = Counter(str(p.parent.relative_to(tree)) for p in tree.rglob("*") if p.is_file())
    assert counts["estimate/filter"] > 10
    assert {folder: n for folder, n in counts.items() if n > MAX_FILES} == {}


def test_c_stands_where_its_python_stands(tree) -> None:
    names = [str(p.relative_to(tree).with_suffix("")) for p in find_sources(tree) if p.parent != tree]
    assert len(names) > 25
    assert [n for n in names if not (PACKAGE / f"{PARTS.get(n, n)}.py").exists()] == []
    assert sorted(PARTS) == [n for n in names if not (PACKAGE / f"{n}.py").exists()]


def test_functions_of_twins_stand_in_the_same_order(tree) -> None:
    shared = 0
    for path in find_sources(tree):
        name = str(path.relative_to(tree).with_suffix(""))
        twin = PACKAGE / f"{PARTS.get(name, name)}.py"
        if not twin.exists():
            continue
        in_c = re.findall(r"^(?!typedef|#|\s|return)[A-Za-z_][\w *]*?\b(\w+)\([^;{]*\)\s*\{", path.read_text(), re.M)
        nodes = ast.parse(twin.read_text()).body
        in_python = [node.name.lstrip("_") for node in nodes if isinstance(node, ast.FunctionDef)]
        common = [f for f in in_c if f in in_python]
        shared += len(common)
        assert [f for f in in_python if f in common] == common, name
    assert shared > 150


def test_files_include_each_other_by_their_path_and_objects_do_not_collide(tree) -> None:
    for path in tree.rglob("*.[ch]"):
        for name in re.findall(r'#include "([^"]+)"', path.read_text()):
            assert (tree / name).exists(), (path, name)
    objects = Counter(p.stem for p in tree.rglob("*.c"))
    assert [name for name, n in objects.items() if n > 1] == []


def test_makefile_and_cmake_file_build_the_same_sources(tree) -> None:
    right = {str(p.relative_to(tree)) for p in find_sources(tree)}
    makefile = re.search(r"^SOURCES = \$\(wildcard ([^)]+)\)", (tree / "Makefile").read_text(), re.M)
    assert makefile
    assert {str(p.relative_to(tree)) for p in find_sources(tree, makefile[1].split())} == right
    cmake = (tree / "CMakeLists.txt").read_text()
    flat = re.search(r"file\(GLOB \w+ CONFIGURE_DEPENDS ([^)]+)\)", cmake)
    deep = re.search(r"file\(GLOB_RECURSE \w+ CONFIGURE_DEPENDS ([^)]+)\)", cmake)
    assert flat
    assert deep
    patterns = [*flat[1].split(), *(pattern.replace("/", "/**/") for pattern in deep[1].split())]
    assert {str(p.relative_to(tree)) for p in find_sources(tree, patterns)} == right
    assert len(right) > len(SOFTWARE_SOURCES)


def test_every_reason_for_a_branch_names_a_line_that_is_there(tree) -> None:
    for name, parts, reason in parse_deviations((tree / "check" / "branches.txt").read_text()):
        assert " ".join(parts) in (tree / name).read_text(), (name, parts)
        assert len(reason) > 10
