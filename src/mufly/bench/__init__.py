"""What did the test bench say? Measurement files, load cells and their zero, and how far an estimate may be off."""

from mufly.bench.calibration import Calibration, calibrate_cells
from mufly.bench.columns import SI_UNITS, Column, parse_header
from mufly.bench.covariance import Spread, spread
from mufly.bench.drift import ZeroDrift, fit_drift
from mufly.bench.loads import Loads, air_density, corrected_loads
from mufly.bench.prediction import Prediction, predict
from mufly.bench.table import BenchTable, header_of, read_bench

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
    "spread",
]
