"""Stages of one period of the controllers; this module alone defines their order.

:func:`make_stage_loop` makes an executor of eight stages. There are two executors:

- in Python, for a :class:`mufly.flight.simulated_flight.Flight` with any sensors, estimator and flight software;
- compiled by Numba, for arrays (:mod:`mufly.firmware.quick.compiled_loop`): many periods in one call, with filter and
  flight software in C.

A stage is a function of the executor's data. It returns :data:`CONTINUE_LOOP`, or a code with which the executor
returns to its caller. ``clock.stage`` is then the next stage. Either executor can therefore continue in the middle of a
period.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

CONTINUE_LOOP, LOOP_DONE = 0, 1
"""Return codes of a stage: continue; no period is left (first and last stage only)."""
FIRST_EXECUTOR_CODE = 2
"""First code that an executor may define."""

(
    STAGE_BEGIN_PERIOD,
    STAGE_ADVANCE_PLANT,
    STAGE_CHECK_CONTACT,
    STAGE_MEASURE,
    STAGE_ESTIMATE,
    STAGE_CONTROL,
    STAGE_RECORD,
    STAGE_END_PERIOD,
) = range(8)

Stage = Callable[[Any], int]


@dataclass(slots=True)
class LoopPosition:
    """Position of a Python loop within a period; ``stage`` is the next stage to run."""

    stage: int = STAGE_BEGIN_PERIOD


def make_stage_loop(
    begin_period: Stage,
    advance_plant: Stage,
    check_contact: Stage,
    measure: Stage,
    estimate: Stage,
    control: Stage,
    record: Stage,
    end_period: Stage,
) -> Stage:
    """Return a function that runs these stages in their order, period after period.

    Parameters
    ----------
    begin_period
        Returns :data:`LOOP_DONE` if no period is left.
    advance_plant
        Integrates the plant over one period under the acting inputs; then the last sent inputs act.
    check_contact
        Detects a collision; averages the battery's current.
    measure
        Samples the sensors.
    estimate
        Updates the estimator with the readings.
    control
        Steps the flight software, which computes the inputs of the period after the next.
    record
        Appends a row to the recording.
    end_period
        Processes the events of this period; returns :data:`LOOP_DONE` in an executor of single periods.

    Returns
    -------
    callable
        ``step(p)`` runs stages of ``p`` from ``p.clock.stage`` on, period after period, and returns the first code of
        a stage that is not :data:`CONTINUE_LOOP`.
    """

    def run_stages(p):  # type: ignore[no-untyped-def]
        clock = p.clock
        first = clock.stage
        while True:
            if first <= STAGE_BEGIN_PERIOD:
                why = begin_period(p)
                if why != CONTINUE_LOOP:
                    clock.stage = STAGE_ADVANCE_PLANT
                    return why
            if first <= STAGE_ADVANCE_PLANT:
                why = advance_plant(p)
                if why != CONTINUE_LOOP:
                    clock.stage = STAGE_CHECK_CONTACT
                    return why
            if first <= STAGE_CHECK_CONTACT:
                why = check_contact(p)
                if why != CONTINUE_LOOP:
                    clock.stage = STAGE_MEASURE
                    return why
            if first <= STAGE_MEASURE:
                why = measure(p)
                if why != CONTINUE_LOOP:
                    clock.stage = STAGE_ESTIMATE
                    return why
            if first <= STAGE_ESTIMATE:
                why = estimate(p)
                if why != CONTINUE_LOOP:
                    clock.stage = STAGE_CONTROL
                    return why
            if first <= STAGE_CONTROL:
                why = control(p)
                if why != CONTINUE_LOOP:
                    clock.stage = STAGE_RECORD
                    return why
            if first <= STAGE_RECORD:
                why = record(p)
                if why != CONTINUE_LOOP:
                    clock.stage = STAGE_END_PERIOD
                    return why
            why = end_period(p)
            if why != CONTINUE_LOOP:
                clock.stage = STAGE_BEGIN_PERIOD
                return why
            first = STAGE_BEGIN_PERIOD

    return run_stages
