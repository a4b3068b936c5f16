"""What is it made of? Vehicle files, the built-in vehicles and the mass budget."""

from mufly.vehicle.coefficient_map import CoefficientMap, MapTables, builtin_maps, load_map, map_toml
from mufly.vehicle.schema import (
    Parameter,
    Vehicle,
    builtin_vehicles,
    load_vehicle,
    parameters,
    replace,
    vehicle_toml,
    voltage_range,
)

__all__ = [
    "CoefficientMap",
    "MapTables",
    "Parameter",
    "Vehicle",
    "builtin_maps",
    "builtin_vehicles",
    "load_map",
    "load_vehicle",
    "map_toml",
    "parameters",
    "replace",
    "vehicle_toml",
    "voltage_range",
]
