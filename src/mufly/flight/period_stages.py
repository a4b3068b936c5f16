"""Stages of one period of the controllers; this module alone defines their order.

:func:`make_stepper` makes an executor of eight stages. There are two kinds of executor, of the same function:

- in Python, over a :class:`mufly.flight.simulated_flight.Flight`: any sensors, estimator and flight software;
- compiled by Numba, over arrays (:mod:`mufly.firmware.quick.compiled_loop`): many periods in one call, filter and
  flight software in C.

A stage is a function of the executor's data. It returns :data:`CONTINUE`, or a code with which the executor returns to
its caller. ``clock.stage`` is then the stage that is due next. The executor can therefore be called again in the middle
of a period, and one executor can finish a period that the other began.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

CONTINUE, DONE = 0, 1
"""Results of a stage: continue; or, by the first or the last stage, that no period is left."""
FIRST_FREE_CODE = 2
"""Codes from here on belong to the executor."""

(
    BEGIN_PERIOD,
    ADVANCE_PLANT,
    CHECK_CONTACT,
    MEASURE,
    ESTIMATE,
    CONTROL,
    RECORD,
    END_PERIOD,
) = range(8)

Stage = Callable[[Any], int]


@dataclass(slots=True)
class PeriodClock:
    """The clock of an executor in Python; ``stage`` is the stage that is due next."""

    stage: int = BEGIN_PERIOD


def make_stepper(
    begin_period: Stage,
    advance_plant: Stage,
    check_contact: Stage,
    measure: Stage,
    estimate: Stage,
    control: Stage,
    record: Stage,
    end_period: Stage,
) -> Stage:
    """Return the executor of these stages.

    Parameters
    ----------
    begin_period
        Returns :data:`DONE` if no period is left.
    advance_plant
        Integrates the plant over one period under the actuators that act; then those sent last act.
    check_contact
        Looks for a collision; averages the current of the battery.
    measure
        Samples the sensors.
    estimate
        Estimates from the readings.
    control
        Steps the flight software, which gives the actuators of the period after the next.
    record
        Appends a row to the recording.
    end_period
        Processes the events of this period; returns :data:`DONE` in an executor of single periods.

    Returns
    -------
    callable
        ``step(p)`` runs stages of ``p`` from ``p.clock.stage`` on, period after period, and returns the first code of
        a stage that is not :data:`CONTINUE`.
    """

    def run_stages(p):  # type: ignore[no-untyped-def]
        clock = p.clock
        first = clock.stage
        while True:
            if first <= BEGIN_PERIOD:
                why = begin_period(p)
                if why != CONTINUE:
                    clock.stage = ADVANCE_PLANT
                    return why
            if first <= ADVANCE_PLANT:
                why = advance_plant(p)
                if why != CONTINUE:
                    clock.stage = CHECK_CONTACT
                    return why
            if first <= CHECK_CONTACT:
                why = check_contact(p)
                if why != CONTINUE:
                    clock.stage = MEASURE
                    return why
            if first <= MEASURE:
                why = measure(p)
                if why != CONTINUE:
                    clock.stage = ESTIMATE
                    return why
            if first <= ESTIMATE:
                why = estimate(p)
                if why != CONTINUE:
                    clock.stage = CONTROL
                    return why
            if first <= CONTROL:
                why = control(p)
                if why != CONTINUE:
                    clock.stage = RECORD
                    return why
            if first <= RECORD:
                why = record(p)
                if why != CONTINUE:
                    clock.stage = END_PERIOD
                    return why
            why = end_period(p)
            if why != CONTINUE:
                clock.stage = BEGIN_PERIOD
                return why
            first = BEGIN_PERIOD

    return run_stages
