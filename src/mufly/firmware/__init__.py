"""What runs on board? The controllers as C99, exported with a vehicle's numbers, built and flown on this machine."""

from mufly.firmware.checks import PilResult, SilResult, deepest_stack, missing_tools, pil, sil
from mufly.firmware.host import Firmware, FirmwareControllers, build, compiler
from mufly.firmware.tables import export, tables_c

__all__ = [
    "Firmware",
    "FirmwareControllers",
    "PilResult",
    "SilResult",
    "build",
    "compiler",
    "deepest_stack",
    "export",
    "missing_tools",
    "pil",
    "sil",
    "tables_c",
]
