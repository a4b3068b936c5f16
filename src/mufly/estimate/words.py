"""What the filter thinks of its sensors, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mufly.estimate.beliefs import Check, Status
from mufly.estimate.layout import CHECKED

_STATUS: tuple[Status, ...] = ("waiting", "fused", "rejected", "missing", "faulty")


def checks(m: Any, s: Any, fitted: Sequence[int]) -> tuple[Check, ...]:
    """Return what is thought of each sensor that is on board."""
    found = []
    for k in fitted:
        spread = float(m["spread"][k])
        nu = float(m["innovation"][k])
        found.append(
            Check(CHECKED[k], _STATUS[int(m["code"][k])], nu, spread, nu / spread if spread > 0 else 0.0,
                  float(m["tick"] - m["used"][k]) * float(s["dt"]), "")
        )  # fmt: skip
    return tuple(found)
