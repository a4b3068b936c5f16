"""Benchmark of rotor predictions: measured rotors, prediction codes and scores (`mufly rotor benchmark`)."""

from mufly.study.benchmark.benchmark_scores import (
    SCORE_COLUMNS,
    RotorScore,
    ScoreRow,
    draw_scores,
    score_codes,
    score_held_out_points,
    score_prediction_intervals,
    tabulate_by_family,
    tabulate_by_group,
)
from mufly.study.benchmark.prediction_codes import (
    PredictionCode,
    RotorDescription,
    RotorPrediction,
    make_rotor_description,
    parse_code,
)
from mufly.study.benchmark.propeller_efficiency import (
    PROPELLER_SCORE_COLUMNS,
    PropellerScore,
    PropellerScoreRow,
    score_propellers,
    tabulate_propeller_scores,
)
from mufly.study.benchmark.rotor_cases import DATA_SOURCES, SECTION_BY_PREFIX, RotorCase, load_cases

__all__ = [
    "DATA_SOURCES",
    "PROPELLER_SCORE_COLUMNS",
    "SCORE_COLUMNS",
    "SECTION_BY_PREFIX",
    "PredictionCode",
    "PropellerScore",
    "PropellerScoreRow",
    "RotorCase",
    "RotorDescription",
    "RotorPrediction",
    "RotorScore",
    "ScoreRow",
    "draw_scores",
    "load_cases",
    "make_rotor_description",
    "parse_code",
    "score_codes",
    "score_held_out_points",
    "score_prediction_intervals",
    "score_propellers",
    "tabulate_by_family",
    "tabulate_by_group",
    "tabulate_propeller_scores",
]
