"""What did the test bench say? Measurement files, load cells and their zero, and how far an estimate may be off."""

from mufly.bench.covariance import Spread, spread
from mufly.bench.loads import (
    Calibration,
    Loads,
    Prediction,
    ZeroDrift,
    air_density,
    calibrate_cells,
    corrected_loads,
    fit_drift,
    predict,
)
from mufly.bench.points import read_measurements
from mufly.bench.table import SI_UNITS, BenchTable, Column, header_of, parse_header, read_bench

__all__ = [
    "SI_UNITS",
    "BenchTable",
    "Calibration",
    "Column",
    "Loads",
    "Prediction",
    "Spread",
    "ZeroDrift",
    "air_density",
    "calibrate_cells",
    "corrected_loads",
    "fit_drift",
    "header_of",
    "parse_header",
    "predict",
    "read_bench",
    "read_measurements",
    "spread",
]
