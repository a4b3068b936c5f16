"""What turns the rotors? Motor, gear and battery; where rotor and drive meet, and how long the battery lasts."""

from mufly.drive.battery import (
    Endurance,
    battery_voltage,
    hover_endurance,
    interpolate,
    open_circuit_voltage,
    terminal_voltage,
)
from mufly.drive.gear import GearOptima, adapted_gear, best_gear, gear_curve, gear_optima
from mufly.drive.operating import (
    OperatingPoint,
    RotorLoad,
    blade_load,
    coefficient_load,
    operating_point,
    scaled_load,
    speed_at_voltage,
    speed_for_thrust,
    steady,
)
from mufly.drive.train import (
    Constants,
    Drive,
    armature_current,
    builtin_drives,
    drive_of,
    drive_toml,
    load_drive,
    rotor_acceleration,
)

__all__ = [
    "Constants",
    "Drive",
    "Endurance",
    "GearOptima",
    "OperatingPoint",
    "RotorLoad",
    "adapted_gear",
    "armature_current",
    "battery_voltage",
    "best_gear",
    "blade_load",
    "builtin_drives",
    "coefficient_load",
    "drive_of",
    "drive_toml",
    "gear_curve",
    "gear_optima",
    "hover_endurance",
    "interpolate",
    "load_drive",
    "open_circuit_voltage",
    "operating_point",
    "rotor_acceleration",
    "scaled_load",
    "speed_at_voltage",
    "speed_for_thrust",
    "steady",
    "terminal_voltage",
]
