from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

import mufly
from mufly.control import FlightController, design_flight_controller
from mufly.vehicle import Vehicle


def _sibling(name: str) -> ModuleType:
    """A helper module beside the tests (they are imported by path, so plain imports do not find it)."""
    full = f"mufly_tests_control_{name}"
    if full not in sys.modules:
        spec = importlib.util.spec_from_file_location(full, Path(__file__).with_name(f"{name}.py"))
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[full] = module
        spec.loader.exec_module(module)
    return sys.modules[full]


@pytest.fixture(scope="session")
def appendix_b() -> ModuleType:
    return _sibling("appendix_b")


@pytest.fixture(scope="session")
def closed_loop() -> ModuleType:
    return _sibling("closed_loop")


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return mufly.load_vehicle("mufly-1.1")


@pytest.fixture(scope="session")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)
