"""Result files of a series, and comparison with another series or with theory.

In the results folder, a file of settings and one of points for each rotor and axis (``mufly rotor fit``, ``mufly
rotor compare`` and ``mufly identify rotor`` read them), one of each motor (``mufly identify motor``), and
``summary.json``.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.bench.series.series_analysis import LoadInterval, SeriesResult, SettingResult
from mufly.errors import InputError, convert_write_errors
from mufly.quantities.units import RPM
from mufly.results import result, to_plain_data
from mufly.rotor import (
    Air,
    OperatingCondition,
    RotorSystem,
    load_rotor,
    prepare_blading,
    solve_system,
)

Array = NDArray[np.float64]

_SINGLE_COLUMNS = (
    "pitch_deg",
    "speed_rpm",
    "thrust_N",
    "torque_mNm",
    "thrust_u95_N",
    "torque_u95_mNm",
    "density_kg_m3",
)
_PAIR_COLUMNS = (
    "pitch_deg", "speed_upper_rpm", "speed_lower_rpm", "thrust_N", "torque_upper_mNm", "torque_lower_mNm",
    "thrust_u95_N", "torque_upper_u95_mNm", "torque_lower_u95_mNm", "density_kg_m3",
)  # fmt: skip


def write_series_results(series: SeriesResult, folder: Path) -> list[Path]:
    """Write the result files of a series; return their paths.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    with convert_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        files: list[Path] = []
        for many, kind in ((series.settings, ""), (series.points, "-points")):
            groups: dict[str, list[SettingResult]] = {}
            for s in many:
                if s.use == "measure" or not kind:
                    groups.setdefault(_file_stem(s), []).append(s)
            for name, some in groups.items():
                files.append(_write_loads(folder / f"{name}{kind}.csv", some, points=bool(kind)))
        for axis in ("upper", "lower"):
            alone = [
                s
                for s in series.points
                if s.axis == axis and s.voltage_V.get(axis) and s.single_rotor_torque is not None
            ]
            if alone:
                rows = [
                    (s.voltage_V[axis], s.current_A[axis], _setting_speed_rpm(s), 1e3 * s.single_rotor_torque.value,
                     f"{s.rotor} {s.pitch_deg:g}")
                    for s in alone if s.single_rotor_torque is not None
                ]  # fmt: skip
                heads = ("voltage_V", "current_A", "speed_rpm", "torque_mNm", "run")
                files.append(_write_csv_table(folder / f"motor-{axis}.csv", heads, rows))
        summary = folder / "summary.json"
        summary.write_text(json.dumps(to_plain_data(series), indent=1), encoding="utf-8")
    return [*files, summary]


def _file_stem(s: SettingResult) -> str:
    names = [s.rotor] if s.lower_rotor in ("", s.rotor) else [s.rotor, s.lower_rotor]
    return re.sub(r"[^\w.-]+", "_", "-".join([*(Path(n).stem for n in names), s.axis]))


def _setting_speed_rpm(s: SettingResult) -> float:
    return s.speed_lower_rpm if s.axis == "lower" else s.speed_upper_rpm


def _write_csv_table(path: Path, heads: Sequence[str], rows: Iterable[Sequence[float | str]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(heads)
        for row in rows:
            writer.writerow([x if isinstance(x, str) else "" if math.isnan(x) else f"{x:.7g}" for x in row])
    return path


def _write_loads(path: Path, some: Sequence[SettingResult], *, points: bool) -> Path:
    def scale_value_and_interval(load: LoadInterval | None, scale: float = 1.0) -> tuple[float, float]:
        return (math.nan, math.nan) if load is None else (scale * load.value, scale * load.expanded)

    some = sorted(some, key=(lambda s: s.time_s) if points else (lambda s: (s.pitch_deg, _setting_speed_rpm(s))))
    rows: list[tuple[float | str, ...]] = []
    for s in some:
        thrust, thrust_u = scale_value_and_interval(s.thrust)
        more = (s.time_s,) if points else (float(s.mountings),)
        if s.axis == "pair":
            up, up_u = scale_value_and_interval(s.torque_upper, 1e3)
            low, low_u = scale_value_and_interval(s.torque_lower, 1e3)
            rows.append((s.pitch_deg, s.speed_upper_rpm, s.speed_lower_rpm, thrust, up, low, thrust_u, up_u, low_u,
                         s.density_kg_m3, *more))  # fmt: skip
        else:
            torque, torque_u = scale_value_and_interval(s.single_rotor_torque, 1e3)
            rows.append(
                (s.pitch_deg, _setting_speed_rpm(s), thrust, torque, thrust_u, torque_u, s.density_kg_m3, *more)
            )
    heads = (
        *(_PAIR_COLUMNS if some[0].axis == "pair" else _SINGLE_COLUMNS),
        "time_s" if points else "mountings",
    )
    known = [
        k for k, h in enumerate(heads) if not all(isinstance(r[k], float) and math.isnan(float(r[k])) for r in rows)
    ]
    return _write_csv_table(path, [heads[k] for k in known], [[r[k] for k in known] for r in rows])


@result(eq=False)
class LoadDifference:
    """Difference of one load between two series, or a series and theory.

    Attributes
    ----------
    point_description : str
        Blades, speed and load.
    first, second : float
        Values of the load (N or N m).
    relative : float
        second / first - 1.
    En_score : float
        E_n: difference over the expanded uncertainty of the difference (ISO 13528); beyond 1 the two disagree.
    """

    point_description: str
    first: float
    second: float
    relative: float
    En_score: float


def _describe_setting(s: SettingResult, load: str) -> str:
    side = "" if s.axis != "pair" or load == "thrust" else f" {load.removeprefix('torque_')}"
    unit = "T (N)" if load == "thrust" else f"Q{side} (N m)"
    return f"{s.rotor} {s.axis} {s.pitch_deg:g}°, {_setting_speed_rpm(s):.0f} rpm: {unit}"


def compare_series(first: SeriesResult, second: SeriesResult) -> list[LoadDifference]:
    """Compare two series at their common settings.

    Loads of the second series are scaled by rho W^2 to the speed and air density of the first.

    Raises
    ------
    InputError
        If they have no setting in common.
    """

    def setting_key(s: SettingResult) -> tuple[object, ...]:
        return (
            s.axis,
            Path(s.rotor).stem,
            Path(s.lower_rotor).stem,
            s.pitch_deg,
            s.lower_pitch_deg,
            round(s.nominal_rpm),
        )

    there = {setting_key(s): s for s in second.settings}
    out: list[LoadDifference] = []
    for s in first.settings:
        other = there.get(setting_key(s))
        if other is None:
            continue
        scale = s.density_kg_m3 / other.density_kg_m3 * (_setting_speed_rpm(s) / _setting_speed_rpm(other)) ** 2
        air = math.hypot(first.density_relative_std, second.density_relative_std)
        for name in ("thrust", "torque_upper", "torque_lower"):
            a, b = getattr(s, name), getattr(other, name)
            if a is not None and b is not None:
                value = b.value * scale
                doubt = math.hypot(a.expanded, b.expanded * scale, 2.0 * air * a.value)
                out.append(
                    LoadDifference(
                        _describe_setting(s, name),
                        a.value,
                        value,
                        value / a.value - 1,
                        (value - a.value) / doubt,
                    )
                )
    if not out:
        raise InputError(
            second.name,
            "",
            f"has no setting in common with {first.name}",
            "compare series of the same blades",
        )
    return out


def compare_with_theory(series: SeriesResult, *, spacing_m: float = 0.04) -> list[LoadDifference]:
    """Compare a series with untuned blade element momentum theory at its speeds, pitches and densities.

    E_n includes only the uncertainty of the series; above 1 the error of the theory exceeds it.
    """
    blades = {n: prepare_blading(load_rotor(n)) for s in series.settings for n in (s.rotor, s.lower_rotor) if n}
    out: list[LoadDifference] = []
    for s in series.settings:
        air = Air(density_kg_m3=s.density_kg_m3)
        if s.axis == "pair":
            system = RotorSystem.from_coaxial_pair(blades[s.rotor], blades[s.lower_rotor], spacing_m=spacing_m)
            at = OperatingCondition(
                (math.radians(s.pitch_deg), math.radians(s.lower_pitch_deg)),
                (s.speed_upper_rpm * RPM, s.speed_lower_rpm * RPM), air=air,
            )  # fmt: skip
            up, low = solve_system(system, at).rotors
            found = {
                "thrust": up.thrust_N + low.thrust_N,
                "torque_upper": up.torque_Nm,
                "torque_lower": low.torque_Nm,
            }
        else:
            at = OperatingCondition(math.radians(s.pitch_deg), _setting_speed_rpm(s) * RPM, air=air)
            (one,) = solve_system(RotorSystem.from_single_rotor(blades[s.rotor]), at).rotors
            found = {"thrust": one.thrust_N, f"torque_{s.axis}": one.torque_Nm}
        for name, value in found.items():
            load = getattr(s, name)
            if load is not None:
                doubt = math.hypot(load.expanded, 2.0 * series.density_relative_std * load.value)
                out.append(
                    LoadDifference(
                        _describe_setting(s, name),
                        load.value,
                        value,
                        value / load.value - 1,
                        (value - load.value) / doubt,
                    )
                )
    if not out:
        raise InputError(
            series.name, "", "contains only mountings of the reference rotor", "measure another rotor, too"
        )
    return out
