"""What is it made of? Vehicle files, the built-in vehicles and the mass budget."""

from mufly.vehicle.load import Parameter, builtin_vehicles, load_vehicle, parameters, replace, vehicle_toml
from mufly.vehicle.schema import Vehicle

__all__ = [
    "Parameter",
    "Vehicle",
    "builtin_vehicles",
    "load_vehicle",
    "parameters",
    "replace",
    "vehicle_toml",
]
