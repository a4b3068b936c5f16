"""What turns the rotors? Motor, gear and battery."""

from mufly.drive.battery import interpolate, terminal_voltage
from mufly.drive.motor import armature_current, rotor_acceleration

__all__ = ["armature_current", "interpolate", "rotor_acceleration", "terminal_voltage"]
