"""Readings that cannot be right in themselves, whatever the state: no number, frozen, twice, too late, none at all."""

from __future__ import annotations

from mufly.compiled import compiled
from mufly.estimate.layout import (
    SENSORS,
    STARTS,
)

ACTING = STARTS[-1]
CLIPPING = ACTING + 4
VALUES = CLIPPING + 3


@compiled(error_model="numpy")
def inspect(m, s, z, new, age):  # type: ignore[no-untyped-def]
    """Judge what has come; what is unusable is marked in ``new`` as not new and replaced by what came before."""
    for k in range(SENSORS):
        if s.fitted[k] == 0:
            new[k] = 0
            continue
        start, count = STARTS[k], STARTS[k + 1] - STARTS[k]
        m.skip[k] = 0
        if new[k] == 1:
            sane = True
            for j in range(count):
                sane = sane and abs(z[start + j]) < s.bound[k]
            if not sane:
                new[k] = 0
                m.code[k], m.why[k] = 4, 4
        if new[k] == 1:
            m.came[k] = m.tick
            if m.code[k] == 0 or m.code[k] >= 3:
                m.code[k], m.why[k] = 1, 0
            if s.every[k] > 1:
                m.same[k] += 1
                m.skip[k] = 1 if m.same[k] % s.every[k] else 0
            for j in range(count):
                m.last[k, j] = z[start + j]
        else:
            for j in range(count):
                z[start + j] = m.last[k, j]
            if m.came[k] > 0 and (m.tick - m.came[k]) * s.dt > s.patience[k]:
                m.code[k], m.why[k] = 3, 2
    for k in range(3):
        m.clipped[k] += 0.1 * (min(max(z[CLIPPING + k], 0.0), 1.0) - m.clipped[k])
