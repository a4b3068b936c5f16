"""Test bench data: measurement files, load cells and their zero, measurement series, uncertainty of estimates."""

from mufly.bench.bench_loads import (
    BenchLoads,
    BenchPrediction,
    CellCalibration,
    ZeroDrift,
    compute_loads,
    fit_cell_calibration,
    fit_zero_drift,
    predict_loads,
    resolve_air_density,
)
from mufly.bench.bench_table import (
    SI_UNITS,
    BenchTable,
    ColumnMeaning,
    parse_column_header,
    read_bench_file,
    read_bench_files,
)
from mufly.bench.residual_covariance import CovarianceEstimate, estimate_parameter_covariance
from mufly.bench.rotor_measurements import read_measurements
from mufly.bench.series import series_pictures as _series_pictures  # noqa: F401  draws results of the room
from mufly.bench.series.series_analysis import SeriesResult
from mufly.bench.series.series_analysis import analyse_series as analyse_series
from mufly.bench.series.series_files import compare_series, compare_with_theory, write_series_results
from mufly.bench.series.series_plan import SeriesPlan, make_series_plan, read_series_plan
from mufly.bench.series.series_record import SeriesRecord, read_record
from mufly.bench.series.series_runner import run_series

__all__ = [
    "SI_UNITS",
    "BenchLoads",
    "BenchPrediction",
    "BenchTable",
    "CellCalibration",
    "ColumnMeaning",
    "CovarianceEstimate",
    "SeriesPlan",
    "SeriesRecord",
    "SeriesResult",
    "ZeroDrift",
    "analyse_series",
    "compare_series",
    "compare_with_theory",
    "compute_loads",
    "estimate_parameter_covariance",
    "fit_cell_calibration",
    "fit_zero_drift",
    "make_series_plan",
    "parse_column_header",
    "predict_loads",
    "read_bench_file",
    "read_bench_files",
    "read_measurements",
    "read_record",
    "read_series_plan",
    "resolve_air_density",
    "run_series",
    "write_series_results",
]
