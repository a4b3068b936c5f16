"""What did the test bench say? Measurement files, load cells and their zero, series, how far an estimate may be off."""

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
from mufly.bench.series.analysis import Series
from mufly.bench.series.analysis import analyse as analyse_series
from mufly.bench.series.files import compare_series, compare_theory, write_results
from mufly.bench.series.plan import Plan, make_plan, read_plan
from mufly.bench.series.record import Record, read_record
from mufly.bench.series.run import run_series
from mufly.bench.table import SI_UNITS, BenchTable, Column, header_of, parse_header, read_bench

__all__ = [
    "SI_UNITS",
    "BenchTable",
    "Calibration",
    "Column",
    "Loads",
    "Plan",
    "Prediction",
    "Record",
    "Series",
    "Spread",
    "ZeroDrift",
    "air_density",
    "analyse_series",
    "calibrate_cells",
    "compare_series",
    "compare_theory",
    "corrected_loads",
    "fit_drift",
    "header_of",
    "make_plan",
    "parse_header",
    "predict",
    "read_bench",
    "read_measurements",
    "read_plan",
    "read_record",
    "run_series",
    "spread",
    "write_results",
]
