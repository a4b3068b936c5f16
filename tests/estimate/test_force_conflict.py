"""Accelerometers and rotor model that differ: which of the two is accused, and on which evidence."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mufly.estimate.filter.filter_records import (
    ERROR_POSITION,
    READING_ACCELERATION,
    READING_POSITION_FIX,
    READING_ROTOR_SPEED,
    SENSOR_COUNT,
)
from mufly.estimate.filter.measurements import sensor_checks as checks

check = checks.check_accel_model.py_func
LEVEL, TURNED = np.eye(3).ravel(), np.array([0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""Rotation matrices: heading north, heading east."""
PERIOD_S, BLOCK_TICKS = 0.005, 4


@pytest.fixture(autouse=True)
def uncompiled(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_mean_fix_ratio_along", "_update_force_conflict", "set_fault"):
        monkeypatch.setattr(checks, name, getattr(checks, name).py_func)


class Flight:
    """Residuals of the accelerometers over blocks of 20 ms, in a flight with a fix."""

    def __init__(self) -> None:
        self.s = SimpleNamespace(dt=PERIOD_S, is_fitted=np.ones(SENSOR_COUNT, int))
        self.m = SimpleNamespace(
            tick=1000, is_accel_distrusted=0, accel_model_difference_tick=0,
            accel_model_diagnosis=checks.DIAGNOSIS_AGREE,
            accel_model_conflict_start_tick=0, accel_residual_lp=np.zeros(3), accel_residual_sigma=np.zeros(3),
            fix_ratio_mean=np.zeros(4), last_fused_tick=np.full(SENSOR_COUNT, 1000),
            status=np.full(SENSOR_COUNT, checks.STATUS_FUSED), reason=np.zeros(SENSOR_COUNT, int),
            reason_number=np.zeros(SENSOR_COUNT), fault_until_tick=np.zeros(SENSOR_COUNT, int),
            sigma_output=np.full(ERROR_POSITION + 3, 0.02),
        )  # fmt: skip

    def pass_time(self, residual: tuple[float, float, float], time_s: float, height: float = 1.0, r=LEVEL) -> int:
        """Return the code of the conflict after so long."""
        for _ in range(round(time_s / (PERIOD_S * BLOCK_TICKS))):
            self.m.tick += BLOCK_TICKS
            self.m.last_fused_tick[READING_POSITION_FIX] = self.m.tick
            for i in range(3):
                check(self.m, self.s, r, height, residual[i], 0.01, 0.0, i)
        return int(self.m.accel_model_diagnosis)

    @property
    def accused(self) -> tuple[int, int]:
        return int(self.m.status[READING_ACCELERATION]), int(self.m.reason[READING_ACCELERATION])


def test_a_residual_within_six_deviations_is_no_conflict() -> None:
    flight = Flight()
    assert flight.pass_time((0.5, 0.0, -0.5), 3.0) == checks.DIAGNOSIS_AGREE
    assert flight.accused == (checks.STATUS_FUSED, checks.REASON_NONE)


def test_both_are_reported_until_a_fix_without_a_lasting_ratio_clears_the_model() -> None:
    flight = Flight()
    assert flight.pass_time((2.5, 0.0, 0.0), 1.0) == checks.DIAGNOSIS_UNDECIDED
    assert flight.accused == (checks.STATUS_FAULTY, checks.REASON_FORCE_CONFLICT)
    assert flight.m.reason_number[READING_ACCELERATION] == flight.m.accel_residual_lp[0] > 1.0  # the axis that differs
    assert flight.pass_time((2.5, 0.0, 0.0), 1.5) == checks.DIAGNOSIS_ACCEL_WRONG
    assert flight.accused == (checks.STATUS_FAULTY, checks.REASON_INNOVATION)
    assert flight.pass_time((0.0, 0.0, 0.0), 2.0) == checks.DIAGNOSIS_AGREE


def test_without_a_fix_nothing_is_decided() -> None:
    flight = Flight()
    flight.m.status[READING_POSITION_FIX] = checks.STATUS_MISSING
    assert flight.pass_time((2.5, 0.0, 0.0), 5.0) == checks.DIAGNOSIS_UNDECIDED


@pytest.mark.parametrize(("r", "axis"), [(LEVEL, 0), (TURNED, 1)])
@pytest.mark.parametrize(
    ("sign", "code"), [(1.0, checks.DIAGNOSIS_MODEL_WRONG), (-1.0, checks.DIAGNOSIS_ACCEL_WRONG)]
)  # fmt: skip
def test_a_lasting_ratio_of_the_fix_along_the_difference_decides(r, axis: int, sign: float, code: int) -> None:
    """The forward axis points north or, turned by 90 degrees, east; the fix shows motion along it or against it."""
    flight = Flight()
    flight.m.fix_ratio_mean[axis] = sign * 1.5
    assert flight.pass_time((2.5, 0.0, 0.0), 1.0, r=r) == code
    assert (flight.m.status[READING_ACCELERATION] == checks.STATUS_FUSED) == (code == checks.DIAGNOSIS_MODEL_WRONG)


def test_rotor_speeds_that_are_not_fused_explain_a_wrong_model() -> None:
    flight = Flight()
    flight.m.status[READING_ROTOR_SPEED] = checks.STATUS_REJECTED
    assert flight.pass_time((0.0, 0.0, 2.5), 1.0) == checks.DIAGNOSIS_MODEL_WRONG
    flight.s.is_fitted[READING_ROTOR_SPEED] = 0
    assert flight.pass_time((0.0, 0.0, 0.0), 2.0) == checks.DIAGNOSIS_AGREE
    assert flight.pass_time((0.0, 0.0, 2.5), 0.6) == checks.DIAGNOSIS_UNDECIDED


def test_a_floor_that_may_carry_the_vehicle_accuses_nobody() -> None:
    """The floor pushes up. A difference that points down, or a height well above the floor, is no contact."""
    assert Flight().pass_time((0.0, 0.0, -2.5), 1.0, height=0.05) == checks.DIAGNOSIS_FLOOR_CONTACT
    assert Flight().pass_time((0.0, 0.0, 2.5), 1.0, height=0.05) == checks.DIAGNOSIS_UNDECIDED
    assert Flight().pass_time((0.0, 0.0, -2.5), 1.0, height=0.5) == checks.DIAGNOSIS_UNDECIDED
    flight = Flight()
    flight.pass_time((0.0, 0.0, -2.5), 0.6, height=0.5)
    assert flight.accused[0] == checks.STATUS_FAULTY
    flight.pass_time((0.0, 0.0, -2.5), 0.2, height=0.05)
    assert flight.accused == (checks.STATUS_FUSED, checks.REASON_NONE)
