"""Functional Mock-up Interface: a vehicle as a co-simulation unit (FMU) in C for other simulators.

The C functions of the flight model are translations of the Python source of the equations of motion
(:mod:`mufly.fmi.c_translation`), and so are those of the sensors (:mod:`mufly.fmi.unit_sensors`);
:mod:`mufly.fmi.unit_variables` lists inputs, outputs and parameters.
"""

from mufly.fmi.fmu_export import ExportedUnit, export_fmu
from mufly.fmi.unit_flight import (
    UnitComparison,
    UnitInstance,
    UnitLibrary,
    check_fmu_file,
    compare_fmu_with_model,
    compare_sensed_fmu_with_model,
)

__all__ = [
    "ExportedUnit",
    "UnitComparison",
    "UnitInstance",
    "UnitLibrary",
    "check_fmu_file",
    "compare_fmu_with_model",
    "compare_sensed_fmu_with_model",
    "export_fmu",
]
