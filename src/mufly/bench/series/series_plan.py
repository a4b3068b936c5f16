"""Plan of a series: mountings, speeds and their order.

A plan is a list of mountings: blades on an axis (or on both) at a pitch, run at several speeds. The order of mountings,
and of speeds within each, is random, so that drift does not appear as a trend over pitch or speed. A reference rotor,
always with the same blades, is mounted first, last and after every few mountings; the first visit also warms up the
bench. Before, between and after the points of a mounting the rotors stop and the zero is read.

A plan is an editable TOML file; this module declares its contents.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tomli_w
from pydantic import Field, model_validator

from mufly.errors import ArgumentError, InputError
from mufly.files.input_files import make_validation_error, read_toml, validate_model
from mufly.quantities.units import RPM
from mufly.vehicle.quantity import ParameterGroup

RotorAxis = Literal["upper", "lower", "pair"]
RotorSide = Literal["upper", "lower"]
StepKind = Literal["tare", "warm-up", "point"]
SIDES_BY_AXIS: dict[str, tuple[RotorSide, ...]] = {
    "upper": ("upper",),
    "lower": ("lower",),
    "pair": ("upper", "lower"),
}


class BenchLimits(ParameterGroup):
    """Limits beyond which the bench stops at once."""

    speed_rpm: float = Field(default=9000.0, gt=0, description="largest speed of either rotor")
    current_A: float = Field(default=3.0, gt=0, description="largest current of either motor")
    thrust_N: float = Field(default=5.0, gt=0, description="limit of the force cell, plus and minus")
    torque_Nm: float = Field(default=0.05, gt=0, description="limit of the torque cell, plus and minus")
    vibration_m_s2: float = Field(default=60.0, gt=0, description="limit of the vibration (rms), if measured")
    motor_temperature_degC: float = Field(default=90.0, gt=0, description="largest temperature of a motor, if measured")


class StepDurations(ParameterGroup):
    """Durations (s) of warm-up, settling, averaging and zero readings."""

    warm_up_s: float = Field(default=600.0, ge=0, description="warm-up time of the reference rotor at its middle speed")
    settle_s: float = Field(default=30.0, gt=0, description="longest time until speed and loads are steady")
    window_s: float = Field(default=1.0, gt=0, description="length of a window; two successive windows have to agree")
    average_s: float = Field(default=4.0, gt=0, description="averaging time of a point, at least")
    longest_s: float = Field(default=16.0, gt=0, description="averaging time of a point, at most")
    tare_s: float = Field(default=4.0, gt=0, description="averaging time of a zero reading")


class BladeMounting(ParameterGroup):
    """Blades on the bench, and the speeds at which they run."""

    use: Literal["reference", "measure"] = Field(description="'reference' or 'measure'")
    axis: RotorAxis = Field(description="'upper', 'lower' or 'pair'")
    rotor: str = Field(min_length=1, description="name or file of the rotor; of a pair the upper one")
    pitch_deg: float = Field(ge=-45, le=45, description="setting of the blades")
    lower_rotor: str = Field(default="", description="of a pair")
    lower_pitch_deg: float = Field(default=0.0, ge=-45, le=45, description="of a pair")
    repetition: int = Field(default=1, ge=1, description="number of this mounting of the same setting")
    speeds_rpm: tuple[float, ...] = Field(min_length=1, description="in the order of measurement")
    speed_ratio: float = Field(
        default=1.0, gt=0.2, lt=5.0, description="pair: speed of the lower rotor over that of the upper"
    )

    @model_validator(mode="after")
    def _check_consistency(self) -> BladeMounting:
        if (self.axis == "pair") != bool(self.lower_rotor):
            raise make_validation_error(
                "a mounting needs a lower_rotor if its axis is 'pair', and none otherwise",
                "correct lower_rotor or axis",
                "lower_rotor",
            )
        if self.use == "reference" and self.axis == "pair":
            raise make_validation_error(
                "the reference rotor is measured on a single axis", "give axis 'upper' or 'lower'", "axis"
            )
        if min(self.speeds_rpm) <= 0:
            raise make_validation_error(
                "a speed is not above 0", "omit it: zero readings are taken automatically", "speeds_rpm"
            )
        return self

    @property
    def driven_rotors(self) -> tuple[RotorSide, ...]:
        """Axes (upper, lower) that turn in this mounting."""
        return SIDES_BY_AXIS[self.axis]

    def speeds_rad_s(self, speed_rpm: float) -> dict[str, float]:
        """Return the speed of each axis (rad/s) for one of the mounting's speeds (rpm)."""
        return {a: speed_rpm * RPM * (self.speed_ratio if a == "lower" and self.axis == "pair" else 1.0)
                for a in self.driven_rotors}  # fmt: skip

    def describe_mounting(self) -> str:
        """Return a description of the blades to mount."""
        if self.axis == "pair":
            return f"{self.rotor} at {self.pitch_deg:g} deg above {self.lower_rotor} at {self.lower_pitch_deg:g} deg"
        return f"{self.rotor} at {self.pitch_deg:g} deg on the {self.axis} axis, no rotor on the other"


class SeriesPlan(ParameterGroup):
    """Plan of a series: mountings in order, durations and limits."""

    name: str = Field(min_length=1, description="of the series")
    seed: int = Field(default=0, description="seed of the random order")
    tare_every: int = Field(default=4, ge=1, description="number of points between two zero readings")
    spacing_m: float = Field(default=0.04, gt=0, description="distance between the discs of a pair")
    limits: BenchLimits = Field(default_factory=BenchLimits)
    times: StepDurations = Field(default_factory=StepDurations)
    mounting: tuple[BladeMounting, ...] = Field(min_length=1, description="in the order of measurement")

    @model_validator(mode="after")
    def _check_speed_limit(self) -> SeriesPlan:
        for k, m in enumerate(self.mounting, 1):
            fastest = max(max(m.speeds_rad_s(s).values()) for s in m.speeds_rpm) / RPM
            if fastest > self.limits.speed_rpm:
                raise make_validation_error(
                    f"{fastest:g} rpm is beyond the limit of {self.limits.speed_rpm:g}",
                    "lower it, or raise limits.speed_rpm if the blades withstand it", f"mounting[{k}].speeds_rpm",
                )  # fmt: skip
        return self

    @property
    def steps(self) -> tuple[PlanStep, ...]:
        """Steps of the plan, in order."""
        out: list[PlanStep] = []
        for k, m in enumerate(self.mounting):
            kinds: list[tuple[StepKind, float]] = [("tare", 0.0)]
            if k == 0 and self.times.warm_up_s > 0:
                kinds.insert(0, ("warm-up", float(np.median(m.speeds_rpm))))
            for i, speed in enumerate(m.speeds_rpm, 1):
                kinds.append(("point", speed))
                if i % self.tare_every == 0 or i == len(m.speeds_rpm):
                    kinds.append(("tare", 0.0))
            out += [PlanStep(k, j, kind, speed) for j, (kind, speed) in enumerate(kinds)]
        return tuple(out)

    @property
    def point_count(self) -> int:
        """Number of measured points, those of the reference rotor included."""
        return sum(len(m.speeds_rpm) for m in self.mounting)

    def estimate_duration_s(self) -> float:
        """Estimate the duration of the series (s), without the time for changing blades."""
        t = self.times
        rest = sum(s.kind == "tare" for s in self.steps) * (t.tare_s + 6 * t.window_s)
        return t.warm_up_s + rest + self.point_count * (t.average_s + 5 * t.window_s)

    def to_toml(self) -> str:
        """Return the plan as TOML."""
        return tomli_w.dumps(self.model_dump())

    def compute_plan_hash(self) -> str:
        """Return a hash that identifies the plan; it excludes limits and times, which may change during a series."""
        tables = self.model_dump(include={"tare_every", "spacing_m", "mounting"})
        return hashlib.sha256(tomli_w.dumps(tables).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class PlanStep:
    """Step of a plan: index of its mounting, index within the mounting, kind (zero, warm-up or point), and speed."""

    mounting_index: int
    step_in_mounting: int
    kind: StepKind
    speed_rpm: float


def make_series_plan(
    name: str, rotors: Sequence[str], pitches_deg: Sequence[float], speeds_rpm: Sequence[float], *,
    reference: str, reference_pitch_deg: float, repetitions: int = 2, axis: RotorAxis = "upper",
    speed_ratios: Sequence[float] = (1.0,), reference_every: int = 4, seed: int = 0,
    limits: BenchLimits | None = None, times: StepDurations | None = None, spacing_m: float = 0.04, tare_every: int = 4,
) -> SeriesPlan:  # fmt: skip
    """Create a plan: every rotor at every pitch and speed, repeated in random order, with runs of the reference rotor
    in between.

    Parameters
    ----------
    name : str
    rotors : sequence of str
        Rotors to measure; a pair has the same rotor above and below.
    pitches_deg, speeds_rpm : sequences of float
    reference : str
        Reference rotor, run at ``reference_pitch_deg`` and up to five of the speeds.
    repetitions : int
        Number of mountings of each setting; two or more show the repeatability.
    axis : 'upper', 'lower' or 'pair'
        Axis with the rotor. For a pair the reference is mounted alone on each axis, because the torques of the pair
        follow from the motor currents.
    speed_ratios : sequence of float
        Ratios of lower to upper speed of a pair.
    reference_every : int
        Number of mountings between two reference visits.
    seed : int

    Raises
    ------
    InputError
        If a list is empty, or a number is invalid.
    """
    for key, values in (("rotor", rotors), ("pitch", pitches_deg), ("rpm", speeds_rpm)):
        if not values:
            raise ArgumentError(key, "", "names none", "give at least one")
    if repetitions < 1 or reference_every < 1:
        raise ArgumentError("repeat", "", "is below 1", "give 1 or more")
    rng = np.random.default_rng(seed)
    speeds = [float(s) for s in speeds_rpm]
    # Few reference speeds suffice to track drift; the calibration of a motor needs the whole range.
    chosen = sorted({speeds[round(i)] for i in np.linspace(0, len(speeds) - 1, min(5, len(speeds)))})

    def shuffle_values(values: Sequence[float]) -> tuple[float, ...]:
        return tuple(float(v) for v in rng.permutation(values))

    settings = [
        (rotor, float(pitch), float(ratio), k + 1)
        for rotor in rotors
        for pitch in pitches_deg
        for ratio in (speed_ratios if axis == "pair" else (1.0,))
        for k in range(repetitions)
    ]
    mountings: list[BladeMounting] = []
    visits = 0

    def add_reference_visit() -> None:
        nonlocal visits
        visits += 1
        for one in SIDES_BY_AXIS[axis]:
            mountings.append(
                BladeMounting(
                    use="reference",
                    axis=one,
                    rotor=reference,
                    pitch_deg=reference_pitch_deg,
                    repetition=visits,
                    speeds_rpm=shuffle_values(chosen),
                )
            )

    add_reference_visit()
    for n, k in enumerate(rng.permutation(len(settings)), 1):
        rotor, pitch, ratio, repetition = settings[k]
        below = {"lower_rotor": rotor, "lower_pitch_deg": pitch, "speed_ratio": ratio} if axis == "pair" else {}
        mountings.append(
            BladeMounting(
                use="measure",
                axis=axis,
                rotor=rotor,
                pitch_deg=pitch,
                repetition=repetition,
                speeds_rpm=shuffle_values(speeds),
                **below,
            )
        )
        if n % reference_every == 0 or n == len(settings):
            add_reference_visit()
    tables = {
        "name": name, "seed": seed, "tare_every": tare_every, "spacing_m": spacing_m,
        "limits": (limits or BenchLimits()).model_dump(), "times": (times or StepDurations()).model_dump(),
        "mounting": [m.model_dump() for m in mountings],
    }  # fmt: skip
    return validate_model(SeriesPlan, tables, "plan")


def read_series_plan(path: str | Path) -> SeriesPlan:
    """Read a plan from a TOML file.

    Raises
    ------
    InputError
        If the file does not exist or is no valid plan; the message names the key.
    """
    if not Path(path).is_file():
        raise InputError(str(path), "", "no such plan", "make one with `mufly bench plan`")
    tables, where = read_toml(path, Path(path).parent, "plan")
    return validate_model(SeriesPlan, tables, where)
