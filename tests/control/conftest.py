from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import mufly
from mufly.control import DesignSettings, FlightController, design_flight_controller
from mufly.control.controller_design import ControllerDesign
from mufly.control.designs import design_roll_pitch
from mufly.control.robust.parameter_spreads import differentiate_plants_by_parameters
from mufly.control.synthesis.synthesis_methods import DkIterationSettings
from mufly.dynamics import linearise_vehicle
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


@pytest.fixture(scope="session")
def mu_roll_pitch(vehicle: Vehicle, controller: FlightController) -> ControllerDesign:
    """Roll-pitch by one round of D-K iteration over three parameters, at few frequencies."""
    spreads = {"swash_plate.linkage": 0.23, "stabiliser_bar.linkage": 0.14, "body.inertia_xx": 2.2e-5}
    linear = linearise_vehicle(vehicle)
    E = differentiate_plants_by_parameters(
        vehicle, controller.voltage_V, list(spreads), np.diag(list(spreads.values()))
    )
    goals = DkIterationSettings(rounds=1, frequencies=(1.0, 100.0, 12))
    return design_roll_pitch(
        linear.roll_pitch, DesignSettings(method="mu", robust_goals=goals), 1 / 200, E["roll-pitch"]
    )
