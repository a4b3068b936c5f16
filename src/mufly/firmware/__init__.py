"""What runs on board? The controllers as C99, exported with a vehicle's numbers, built and flown on this machine."""

from mufly.firmware.checks import PilResult, SilResult, deepest_stack, missing_tools, pil, sil
from mufly.firmware.fixed import FixedLaw, FixedLoss, Proof, cascade_loss, fixed_law
from mufly.firmware.fixed_checks import FixedFlight, fly_fixed
from mufly.firmware.fuzzing import FuzzResult, fuzz, missing_fuzzer, run_fuzzer
from mufly.firmware.host import Firmware, FirmwareControllers, build
from mufly.firmware.integer_law import FixedControllers, FixedFirmwareControllers, export_fixed
from mufly.firmware.onboard import FirmwareSoftware, QuickSoftware
from mufly.firmware.report import write_report
from mufly.firmware.tables import export, tables_c
from mufly.toolchain import compiler

__all__ = [
    "Firmware",
    "FirmwareControllers",
    "FirmwareSoftware",
    "FixedControllers",
    "FixedFirmwareControllers",
    "FixedFlight",
    "FixedLaw",
    "FixedLoss",
    "FuzzResult",
    "PilResult",
    "Proof",
    "QuickSoftware",
    "SilResult",
    "build",
    "cascade_loss",
    "compiler",
    "deepest_stack",
    "export",
    "export_fixed",
    "fixed_law",
    "fly_fixed",
    "fuzz",
    "missing_fuzzer",
    "missing_tools",
    "pil",
    "run_fuzzer",
    "sil",
    "tables_c",
    "write_report",
]
