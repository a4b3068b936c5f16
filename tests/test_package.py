"""The package as its users see it: every room by its name, and no name that means two things."""

import ast
import glob
import importlib
import pkgutil
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import mufly

_FILE = Path(__file__).parents[1] / "pyproject.toml"
_LAYERS = tomllib.loads(_FILE.read_text())["tool"]["importlinter"]["contracts"][0]["layers"]
# One level of the list may hold several rooms.
NAMES = [name.strip() for layer in _LAYERS for name in layer.replace(":", "|").split("|")]
_PACKAGE = Path(mufly.__file__).parent
ROOMS = [name for name in NAMES if (_PACKAGE / name / "__init__.py").is_file()]


def test_the_list_of_layers_holds_every_room():
    assert sorted(p.parent.name for p in _PACKAGE.glob("*/__init__.py")) == sorted(ROOMS)


def test_the_wheel_holds_every_data_file():
    """Setuptools packs only what the patterns of pyproject.toml name, such as C sources and vehicle files."""
    patterns = tomllib.loads(_FILE.read_text())["tool"]["setuptools"]["package-data"]["mufly"]
    packed = {path for pattern in patterns for path in glob.glob(pattern, root_dir=_PACKAGE, recursive=True)}
    files = [p for p in _PACKAGE.rglob("*") if p.is_file() and p.suffix not in (".py", ".pyc")]
    data = {str(p.relative_to(_PACKAGE)) for p in files}
    assert len(data) > 50
    assert sorted(data - packed) == []


_FRESH = """
import importlib, sys
for room in sys.argv[1:]:
    for name in [n for n in sys.modules if n.partition(".")[0] == "mufly"]:
        del sys.modules[name]
    mufly = importlib.import_module("mufly")
    assert f"mufly.{room}" not in sys.modules, room
    assert getattr(mufly, room).__name__ == f"mufly.{room}", room
    assert room in dir(mufly), room
"""
"""Reach each room first in a package without loaded rooms; libraries stay loaded, which takes most of the time."""


def test_a_room_is_reached_by_its_name():
    # In a process of its own: here other tests may have imported it.
    subprocess.run([sys.executable, "-c", _FRESH, *ROOMS], check=True)
    assert set(ROOMS) <= set(mufly.__all__)


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'mufly' has no attribute 'rooms'"):
        _ = mufly.rooms


def _sub_rooms(room: str) -> list[str]:
    module = importlib.import_module(room)
    inner = [f"{room}.{m.name}" for m in pkgutil.iter_modules(module.__path__) if m.ispkg]
    return [room, *(name for child in inner for name in _sub_rooms(child))]


@pytest.mark.parametrize("room", ROOMS)
def test_no_name_that_a_room_exports_is_that_of_a_module(room):
    for place in _sub_rooms(f"mufly.{room}"):
        module = importlib.import_module(place)
        modules = {m.name for m in pkgutil.iter_modules(module.__path__)}
        exported = {n for n in getattr(module, "__all__", ()) if not hasattr(getattr(module, n), "__path__")}
        assert not modules & exported, f"{place}: {sorted(modules & exported)} is a function and a module"


def test_gravity_is_written_once():
    """Both accelerations, that of flights and that in the definition of units, stand in ``mufly.quantities.units``
    alone."""
    found = [
        path.relative_to(_PACKAGE)
        for path in sorted(_PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and f"{node.value!r}".replace(".", "").startswith(("981", "980665"))
    ]
    assert set(map(str, found)) == {"quantities/units.py"}


def test_hover_is_solved_once():
    """Eq. 5.1: trim, the level of a coefficient map and the start of an identified record take one solution of it."""
    vehicle = mufly.load_vehicle("mufly-1.1")
    p = mufly.dynamics.model_parameters(vehicle)
    speeds = mufly.dynamics.compute_hover_rotor_speeds(p)
    thrust = p["thrust_up"] * speeds[0] ** 2 + p["thrust_dw"] * speeds[1] ** 2
    assert thrust == pytest.approx(p["mass"] * mufly.dynamics.GRAVITY + p["downwash_drag"], rel=1e-14)
    assert p["torque_up"] * speeds[0] ** 2 == pytest.approx(p["torque_dw"] * speeds[1] ** 2, rel=1e-14)
    assert mufly.dynamics.find_trim(vehicle).rotor_speed == pytest.approx(speeds, rel=1e-9)
    batch = np.array([p, p])
    batch["mass"][1] *= 4.0
    batch["downwash_drag"][1] *= 4.0
    assert mufly.dynamics.compute_hover_rotor_speeds(batch) == pytest.approx(
        np.array([speeds, 2.0 * speeds]), rel=1e-14
    )


def test_each_file_name_stands_once() -> None:
    names = Counter(p.name for p in Path(mufly.__file__).parent.rglob("*.py") if p.name != "__init__.py")
    assert [name for name, count in names.items() if count > 1] == []
