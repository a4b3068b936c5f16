"""Vehicles: vehicle files, built-in vehicles and the mass budget."""

from mufly.vehicle.coefficient_map import (
    CoefficientMap,
    MapTables,
    format_coefficient_map_toml,
    list_builtin_coefficient_maps,
    load_coefficient_map,
)
from mufly.vehicle.flight_map import (
    FlightMap,
    FlightMapTables,
    format_flight_map_toml,
    list_builtin_flight_maps,
    load_flight_map,
)
from mufly.vehicle.plausibility import UnusualParameter, find_unusual_parameters
from mufly.vehicle.vehicle_schema import (
    Parameter,
    Vehicle,
    find_battery_voltage_range,
    format_vehicle_toml,
    list_builtin_vehicles,
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
    "find_battery_voltage_range",
    "find_unusual_parameters",
    "format_coefficient_map_toml",
    "format_flight_map_toml",
    "format_vehicle_toml",
    "list_builtin_coefficient_maps",
    "list_builtin_flight_maps",
    "list_builtin_vehicles",
    "list_parameters",
    "load_coefficient_map",
    "load_flight_map",
    "load_vehicle",
    "replace_parameters",
]
