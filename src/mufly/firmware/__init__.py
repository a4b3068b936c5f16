"""What runs on board? The controllers as C99, exported with a vehicle's numbers, built and flown on this machine."""

from mufly.firmware.export import export, tables_c
from mufly.firmware.host import Firmware, FirmwareControllers, build, compiler

__all__ = ["Firmware", "FirmwareControllers", "build", "compiler", "export", "tables_c"]
