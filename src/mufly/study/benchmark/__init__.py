"""How near do predictions come? Measured rotors, codes of anybody, scores: `mufly rotor benchmark`."""

from mufly.study.benchmark.advancing import AdvancingRow, AdvancingScore, advancing_table, run_advancing
from mufly.study.benchmark.cases import SECTIONS, SOURCES, RotorCase, load_cases
from mufly.study.benchmark.codes import Code, Prediction, Question, code_of, question_of
from mufly.study.benchmark.scores import Row, Score, cross_validated, families, held_out, picture, run, table

__all__ = [
    "SECTIONS",
    "SOURCES",
    "AdvancingRow",
    "AdvancingScore",
    "Code",
    "Prediction",
    "Question",
    "RotorCase",
    "Row",
    "Score",
    "advancing_table",
    "code_of",
    "cross_validated",
    "families",
    "held_out",
    "load_cases",
    "picture",
    "question_of",
    "run",
    "run_advancing",
    "table",
]
