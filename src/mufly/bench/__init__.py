"""What did the test bench say? Measurement files, load cells and their zero, and how far an estimate may be off."""

from mufly.bench.calibration import Calibration, calibrate_cells
from mufly.bench.columns import SI_UNITS, Column, parse_header
from mufly.bench.covariance import Spread, spread
from mufly.bench.drift import ZeroDrift, fit_drift
from mufly.bench.table import BenchTable, read_bench

__all__ = [
    "SI_UNITS",
    "BenchTable",
    "Calibration",
    "Column",
    "Spread",
    "ZeroDrift",
    "calibrate_cells",
    "fit_drift",
    "parse_header",
    "read_bench",
    "spread",
]
