"""The measured rotors beside the project, for the scripts here; what they are:
``mufly.study.benchmark.rotor_cases``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mufly.rotor import Blading, Corrections, compare_measurements, compute_polars, prepare_blading
from mufly.study.benchmark import RotorCase, rotor_cases

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "aero"


def table_3_2() -> RotorCase:
    """The dissertation's rotor."""
    return rotor_cases.load_table_3_2(DATA)


def propellers() -> list[RotorCase]:
    """The 17 propellers of UIUC."""
    return rotor_cases.load_uiuc_propellers(DATA)


def others() -> list[RotorCase]:
    """DJI 9443, Caradonna and Tung, T-motor 28 inch."""
    return [
        rotor_cases.load_dji_9443(DATA),
        rotor_cases.load_caradonna_tung(DATA),
        rotor_cases.load_t_motor_28(DATA),
    ]


def blading_of(
    case: RotorCase, corrections: Corrections | None = None, n_crit: float = 0.1, section: str = ""
) -> Blading:
    """Lay a case out, with another section if one is named."""
    names = case.rotor.airfoil_names()
    tables = compute_polars(list(names), n_crit=n_crit)
    if section:
        tables = dict.fromkeys(names, compute_polars([section], n_crit=n_crit)[section])
    return prepare_blading(case.rotor, tables, corrections=corrections)


def errors(
    case: RotorCase, corrections: Corrections | None = None, n_crit: float = 0.1, section: str = ""
) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of thrust and torque at every point."""
    out = compare_measurements(blading_of(case, corrections, n_crit, section), case.measured, air=case.air)
    return out.thrust_error, out.torque_error
