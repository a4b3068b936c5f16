"""Vehicles: vehicle files, built-in vehicles and the mass budget."""

from mufly.vehicle.coefficient_map import (
    CoefficientMap,
    MapTables,
    builtin_coefficient_maps,
    format_map_toml,
    load_coefficient_map,
)
from mufly.vehicle.flight_map import (
    FlightMap,
    FlightMapTables,
    builtin_flight_maps,
    format_flight_map_toml,
    load_flight_map,
)
from mufly.vehicle.plausibility import UnusualParameter, find_unusual_parameters
from mufly.vehicle.vehicle_schema import (
    Parameter,
    Vehicle,
    builtin_vehicles,
    find_battery_voltage_range,
    format_vehicle_toml,
    list_parameters,
    load_vehicle,
    replace_parameters,
)

__all__ = [
    "CoefficientMap",
    "FlightMap",
    "FlightMapTables",
    "MapTables",
    "Parameter",
    "UnusualParameter",
    "Vehicle",
    "builtin_coefficient_maps",
    "builtin_flight_maps",
    "builtin_vehicles",
    "find_battery_voltage_range",
    "find_unusual_parameters",
    "format_flight_map_toml",
    "format_map_toml",
    "format_vehicle_toml",
    "list_parameters",
    "load_coefficient_map",
    "load_flight_map",
    "load_vehicle",
    "replace_parameters",
]
