"""An optimisation as a cost over numbers: what is free, what is limited, what is wanted (see ``optimise``)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.drive import hover_endurance
from mufly.errors import InputError, MuflyError
from mufly.rotor import Rotor, load_airfoil
from mufly.study.evaluate import evaluate
from mufly.study.limits import Limit, bounds_of
from mufly.study.parameters import GEOMETRY
from mufly.study.rank import rank_airfoils
from mufly.study.setup import Setup
from mufly.study.shape import reshape

__all__ = ["FREE", "Goal", "Problem", "least_thickness_m"]

Array = NDArray[np.float64]
Goal = Literal["thrust-per-power", "endurance"]

FREE = ("chord", "twist", "taper", "radius", "hub_cutout", "blades", "airfoil", "gear")
_CANDIDATES = 30  # airfoils that the search looks at, the best of the ranking that the limits allow
_RANK_PITCH = tuple(float(p) for p in np.radians(np.arange(8.0, 21.0, 2.0)))
STEP_PITCH = np.radians(np.arange(2.0, 26.1, 0.25))


@lru_cache(maxsize=4096)
def _thickness_ratio(name: str) -> float:
    return math.nan if name.lower().endswith(".csv") else load_airfoil(name).thickness_ratio


def least_thickness_m(rotor: Rotor) -> float:
    """Return the least of the blade's thicknesses along its span (m): chord times thickness ratio of the section."""
    s = rotor.sections(np.linspace(float(rotor.hub_cutout), 1.0, 41))
    ratio = np.array([_thickness_ratio(name) for name in s.names])
    return float(np.min(s.chord_m * ((1 - s.weight) * ratio[s.first] + s.weight * ratio[s.second])))


class Problem:
    """Goal and limits as a cost over unknowns: what :func:`mufly.study.optimise` searches."""

    BROKEN = 1e3  # costs of cases that fail or break a limit begin here

    def __init__(
        self, setup: Setup, goal: Goal, free: tuple[str, ...], limits: tuple[Limit, ...], airfoils: list[str]
    ) -> None:
        if setup.drive is None or "thrust" not in setup.fixed:
            raise InputError(
                "optimise", "", "drive or thrust is missing", "give a drive and thrust=0.4N or the like"
            )
        if goal not in ("thrust-per-power", "endurance"):
            raise InputError("optimise", str(goal), "is no goal", "use thrust-per-power or endurance")
        for name in free:
            if name not in FREE:
                raise InputError("optimise", name, "cannot be free", f"free some of: {', '.join(FREE)}")
            if name in setup.fixed:
                raise InputError("optimise", name, "is fixed and free", "leave one of the two out")
        if len(set(free)) != len(free):
            raise InputError("optimise", "", "frees something twice", "name each once")
        fixed = dict(setup.fixed)
        if goal == "endurance":
            fixed.setdefault("voltage", float(setup.drive.battery.low_voltage))
        self.setup = replace(setup, fixed=fixed, flags=False)
        self.drive, self.goal, self.free, self.limits = setup.drive, goal, free, limits
        self.candidates = self._ranked(airfoils) if "airfoil" in free else []

    def _ranked(self, airfoils: list[str]) -> list[str]:
        if not airfoils:
            raise InputError(
                "optimise", "airfoil", "is free without candidates", "name airfoils to choose from"
            )
        start = replace(
            self.setup, fixed={k: v for k, v in self.setup.fixed.items() if k != "pitch"} | self._gear()
        )
        ranking = rank_airfoils(start, airfoils, _RANK_PITCH, by="thrust_per_power_N_W")
        order = [str(n) for n, f in zip(ranking.airfoil.values, ranking.fault.values, strict=True) if not f]
        least = max(
            (lim.value for lim in self.limits if lim.name == "thickness_mm" and lim.at_least), default=0.0
        )
        widest = (
            bounds_of("chord", self.limits)[1]
            if "chord" in self.free
            else float(np.max(self.setup.rotor.blade.chord.value))
        )
        order = [n for n in order if not _thickness_ratio(n) * widest * 1e3 < least]
        if not order:
            raise MuflyError("no airfoil of those named works on this rotor within the limits")
        return order[:_CANDIDATES]

    def _gear(self) -> dict[str, float | str]:
        return {"gear": "best"} if "gear" in self.free else {}

    def space(self) -> tuple[list[str], list[float], list[float], list[bool]]:
        """Names, bounds and wholeness of the unknowns."""
        names = [n for n in self.free if n != "gear"]
        if "pitch" not in self.setup.fixed:
            names.append("pitch")
        if not names:
            raise InputError("optimise", "", "leaves nothing to search", "free something, or the pitch")
        low, high = [], []
        for name in names:
            bounds = (0.0, len(self.candidates) - 1.0) if name == "airfoil" else bounds_of(name, self.limits)
            low.append(bounds[0])
            # SciPy wants an interval; a single candidate is one all the same.
            high.append(bounds[1] if bounds[1] > bounds[0] else bounds[0] + 1e-9)
        return names, low, high, [n in ("airfoil", "blades") for n in names]

    def case(self, names: Sequence[str], x: Array) -> dict[str, float | str]:
        """Parameters of one point of the search."""
        values: dict[str, float | str] = dict(zip(names, (float(v) for v in x), strict=True))
        if "airfoil" in values:
            values["airfoil"] = self.candidates[
                min(round(float(values["airfoil"])), len(self.candidates) - 1)
            ]
        if "blades" in values:
            values["blades"] = float(round(float(values["blades"])))
        return values

    def goals(
        self, cases: Sequence[Mapping[str, float | str]], *, own_gear: bool = False
    ) -> tuple[Array, dict[str, Array], list[str]]:
        """Goal (nan where it fails), results and faults of cases."""
        extra = {} if own_gear else self._gear()
        results = evaluate(replace(self.setup, fixed={**self.setup.fixed, **extra}), cases)
        per_power = results.values["thrust_per_power_N_W"]
        voltage = float(self.setup.fixed.get("voltage", float(self.drive.battery.nominal_voltage)))
        times = np.full(per_power.size, np.nan)
        for k in np.flatnonzero(np.isfinite(per_power)):
            try:
                times[k] = hover_endurance(
                    self.drive.battery,
                    power_W=self.drive.rotors * float(results.values["electrical_power_W"][k]),
                    motor_voltage_V=float(results.values["duty"][k]) * voltage,
                ).time_s
            except MuflyError:
                continue
        values = {**results.values, "endurance_s": times}
        return (times if self.goal == "endurance" else per_power), values, results.fault

    def rotor(self, case: Mapping[str, float | str]) -> Rotor:
        """Return the rotor of a case."""
        every = {**self.setup.fixed, **case}
        return reshape(self.setup.rotor, {name: every[name] for name in GEOMETRY if name in every})

    def _breaks(self, case: Mapping[str, float | str], values: Mapping[str, float]) -> float:
        return sum(limit.breach(v) for limit, v in self._limited(case, values))

    def _limited(
        self, case: Mapping[str, float | str], values: Mapping[str, float]
    ) -> list[tuple[Limit, float]]:
        if not self.limits:
            return []
        rotor = self.rotor(case)
        derived = {
            "thickness_mm": lambda: 1e3 * least_thickness_m(rotor),
            "tip_chord_mm": lambda: 1e3 * float(rotor.chord_m(1.0)),
            "solidity": lambda: rotor.solidity,
            "speed_rpm": lambda: values["speed_rad_s"] * 30 / math.pi,
            "motor_current_A": lambda: values["motor_current_A"],
            "gear": lambda: values["gear_ratio"],
        }
        return [(limit, derived[limit.name]()) for limit in self.limits if limit.name in derived]

    def cost(self, names: Sequence[str], points: Array) -> Array:
        """Cost of points (n, unknowns): less the goal, or above ``BROKEN``."""
        cases = [self.case(names, x) for x in points]
        goal, values, _ = self.goals(cases)
        cost = np.where(np.isfinite(goal), -goal, 2.0 * self.BROKEN)
        if self.goal == "endurance":
            cost = np.where(np.isfinite(goal), cost / 3600.0, cost)
        for k in np.flatnonzero(np.isfinite(goal)):
            breach = self._breaks(cases[k], {n: float(v[k]) for n, v in values.items()})
            if breach > 0.0:
                cost[k] = self.BROKEN + min(breach, 0.9 * self.BROKEN)
        return cost

    def why(self, case: Mapping[str, float | str]) -> str:
        """What a case breaks, in words."""
        _, values, fault = self.goals([case])
        if fault[0]:
            return fault[0]
        broken = [
            f"{limit} (is {v:.4g})"
            for limit, v in self._limited(case, {n: float(x[0]) for n, x in values.items()}) if limit.breach(v) > 0
        ]  # fmt: skip
        return "; ".join(broken) or "the battery cannot hold the hover"

    def at_best_pitch(self, case: Mapping[str, float | str], own_gear: bool) -> tuple[float, float]:
        """Greatest goal over the pitch, and that pitch."""
        if "pitch" in self.setup.fixed:
            goal, _, _ = self.goals([case], own_gear=own_gear)
            return float(goal[0]), float(self.setup.fixed["pitch"])
        low, high = bounds_of("pitch", self.limits)
        pitches = [float(p) for p in STEP_PITCH if low <= p <= high] or [0.5 * (low + high)]
        goal, _, _ = self.goals([{**case, "pitch": p} for p in pitches], own_gear=own_gear)
        best = int(np.argmax(np.where(np.isfinite(goal), goal, -np.inf)))
        return float(goal[best]), pitches[best]
