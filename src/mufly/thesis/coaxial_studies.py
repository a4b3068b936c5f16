"""The coaxial pair of Sec. 3.4.7: Figs 3.43, 3.44 and 3.45 and Table 3.4, by the wake method and by blade elements.

Two rotors of NACA 0012, R 60 mm, chord 20 mm, at 14 degrees. The source computed them with its own vortex method, so
these are comparisons of methods, not with measurements. Assumptions where the source states nothing: hub cut-out 0.15
R; spacing 20 mm, except in Fig. 3.45; equal speeds of both rotors in Fig. 3.45.

The results are computed with ``wake`` (:mod:`mufly.rotor.wake`, default settings, each case from the wake of the one
before) and with ``full`` (coaxial blade element momentum theory). There are fewer speeds than in the source's figures,
because a wake takes seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import MuflyError
from mufly.quantities.units import RPM
from mufly.rotor import (
    Air,
    Blading,
    OperatingCondition,
    RotorSystem,
    SolverMethod,
    SystemSolution,
    load_rotor,
    prepare_blading,
    solve_system,
)
from mufly.rotor.wake import WakeSettings
from mufly.study.sweeps import ProgressCallback
from mufly.thesis.claims import TABLE_3_4_VALUES, Verdict, judge

COAXIAL_MODELS = ("wake", "full")
_METHOD_BY_MODEL: dict[str, SolverMethod] = {"wake": "wake", "full": "bemt"}
PAIR_PITCH_DEG = 14.0
SPACING_M = 0.02
UPPER_RPM = 6000.0
_FIELD_UNITS = {"thrust_N": "N", "torque_Nm": "N m", "power_W": "W", "c_T": "1", "c_Q": "1"}


@dataclass(frozen=True)
class _PairPoint:
    upper_rpm: float = UPPER_RPM
    lower_rpm: float = UPPER_RPM
    lower_pitch_deg: float = PAIR_PITCH_DEG
    spacing_m: float = SPACING_M
    balances_torque: bool = False
    """Whether to find the lower speed that balances the torques."""


def _load_blade() -> Blading:
    return prepare_blading(load_rotor("naca0012-r60-c20"))


_SOLVED_PAIRS: dict[tuple[str, _PairPoint], SystemSolution] = {}
"""Pairs solved with the default settings: Figs 3.6 and 3.43 to 3.45 share cases, and a wake takes long."""


def _solve_pair(
    model: str, blade: Blading, point: _PairPoint, settings: WakeSettings | None, known: SystemSolution | None
) -> tuple[SystemSolution | None, str]:
    """Return the solution of both rotors, and the reason of a failure."""
    kept = _SOLVED_PAIRS.get((model, point)) if settings is None else None
    if kept is not None:
        return kept, ""
    pitch = (math.radians(PAIR_PITCH_DEG), math.radians(point.lower_pitch_deg))
    speed = (point.upper_rpm * RPM, None if point.balances_torque else point.lower_rpm * RPM)
    try:
        pair = RotorSystem.from_coaxial_pair(blade, blade, spacing_m=point.spacing_m)
        found = solve_system(
            pair, OperatingCondition(pitch, speed), _METHOD_BY_MODEL[model], settings=settings, start=known
        )
    except MuflyError as error:
        return None, str(error)
    if not found.converged:
        return None, found.message
    if settings is None:
        _SOLVED_PAIRS[model, point] = found
    return found, ""


def solve_equal_speed_pair() -> SystemSolution:
    """Return the pair at 14 degrees, both rotors at 6 000 rpm, 20 mm apart, by the wake method.

    Raises
    ------
    MuflyError
        If it does not converge.
    """
    found, fault = _solve_pair("wake", _load_blade(), _PairPoint(), None, None)
    if found is None:
        raise MuflyError(fault)
    return found


def _solve_grid(
    model: str,
    axes: Mapping[str, Sequence[float | str]],
    at: Callable[..., _PairPoint],
    settings: WakeSettings | None,
    progress: ProgressCallback | None,
) -> xr.Dataset:
    """Solve every combination of the axes; a case that does not converge is nan, with the reason in ``fault``."""
    blade = _load_blade()
    shape = tuple(len(v) for v in axes.values())
    data = {f"{who}_{field}": np.full(shape, np.nan) for who in ("upper", "lower") for field in (*_FIELD_UNITS, "rpm")}
    fault = np.full(shape, "", dtype=object)
    known: SystemSolution | None = None
    for done, index in enumerate(np.ndindex(shape)):
        point = at(**{name: values[i] for (name, values), i in zip(axes.items(), index, strict=True)})
        found, fault[index] = _solve_pair(model, blade, point, settings, known)
        if found is not None and model == "wake":
            known = found
        for who, rotor in zip(("upper", "lower"), found.rotors if found is not None else (), strict=False):
            for field in _FIELD_UNITS:
                data[f"{who}_{field}"][index] = getattr(rotor, field)
            data[f"{who}_rpm"][index] = rotor.speed_rad_s / RPM
        if progress is not None:
            progress(done + 1, math.prod(shape))
    names = tuple(axes)
    out = xr.Dataset(
        {k: (names, v, {"units": _FIELD_UNITS.get(k.partition("_")[2], "rev/min")}) for k, v in data.items()},
        coords=dict(axes),
        attrs={"model": model},
    )
    out["fault"] = (names, fault.astype(str))
    return out


def compute_equal_speeds(
    model: str,
    rpm: Sequence[float] = (3000, 5000, 7000),
    settings: WakeSettings | None = None,
    progress: ProgressCallback | None = None,
) -> xr.Dataset:
    """Fig. 3.43: compute a pair with both rotors at the same speed, and an isolated rotor (``single_...``).

    Thesis: Fig. 3.43.
    """
    both = _solve_grid(
        model, {"rpm": list(rpm)}, lambda rpm: _PairPoint(upper_rpm=rpm, lower_rpm=rpm), settings, progress
    )
    blade, pitch = _load_blade(), math.radians(PAIR_PITCH_DEG)
    known: SystemSolution | None = None
    single: dict[str, list[float]] = {field: [] for field in _FIELD_UNITS}
    for speed in rpm:
        at = OperatingCondition(pitch, speed * RPM)
        alone = solve_system(
            RotorSystem.from_single_rotor(blade), at, _METHOD_BY_MODEL[model], settings=settings, start=known
        )
        if alone.converged and model == "wake":
            known = alone
        for field, values in single.items():
            values.append(float(getattr(alone.rotors[0], field)) if alone.converged else math.nan)
    return both.assign({f"single_{k}": ("rpm", v, {"units": _FIELD_UNITS[k]}) for k, v in single.items()})


OUR_CFD_PAIR_LOADS: dict[int, dict[str, tuple[float, float]]] = {
    5000: {"upper": (0.1834, 2.100e-3), "lower": (0.0974, 1.665e-3), "single": (0.1814, 2.107e-3)},
    7000: {"upper": (0.3601, 3.984e-3), "lower": (0.1906, 3.096e-3), "single": (0.3575, 4.005e-3)},
}
"""Thrust (N) and torque (N m) by rpm, with the other rotor's mean; laminar, coarse, hub of 6 mm, settled.

docs/log/2026-11-28-cfd-pair.md has the cases.
"""


def tabulate_cfd_equal_speeds() -> xr.Dataset:
    """Return the CFD results of docs/log/2026-11-28-cfd-pair.md in the form of :func:`compute_equal_speeds`."""
    rpm, air, R = sorted(OUR_CFD_PAIR_LOADS), Air(), _load_blade().radius_m
    out: dict[str, NDArray[np.float64]] = {}
    for who in ("upper", "lower", "single"):
        loads = np.array([OUR_CFD_PAIR_LOADS[n][who] for n in rpm])
        whole = air.density_kg_m3 * math.pi * R**2 * (np.array(rpm) * RPM * R) ** 2
        out |= {f"{who}_thrust_N": loads[:, 0], f"{who}_torque_Nm": loads[:, 1]}
        out |= {f"{who}_c_T": loads[:, 0] / whole, f"{who}_c_Q": loads[:, 1] / (whole * R)}
    data = xr.Dataset({k: ("rpm", v) for k, v in out.items()}, coords={"rpm": rpm}, attrs={"model": "cfd"})
    data["fault"] = ("rpm", np.full(len(rpm), "", dtype=str))
    return data


def compute_one_speed_fixed(
    model: str,
    rpm: Sequence[float] = (3000, 4500, 6000, 7000),
    settings: WakeSettings | None = None,
    progress: ProgressCallback | None = None,
) -> xr.Dataset:
    """Fig. 3.44: one rotor is kept at 6000 rpm; the speed of the other, ``varied``, is varied.

    Thesis: Fig. 3.44.
    """

    def make_pair_point(varied: str, rpm: float) -> _PairPoint:
        return _PairPoint(upper_rpm=rpm) if varied == "upper" else _PairPoint(lower_rpm=rpm)

    return _solve_grid(model, {"varied": ["upper", "lower"], "rpm": list(rpm)}, make_pair_point, settings, progress)


def compute_equal_torques(
    model: str,
    lower_pitch_deg: Sequence[float] = (14, 16, 18),
    settings: WakeSettings | None = None,
    progress: ProgressCallback | None = None,
) -> xr.Dataset:
    """Table 3.4: the lower speed at which the torques cancel, the upper rotor at 6000 rpm.

    Thesis: Table 3.4; Sec. 3.4.7.
    """

    make_pair_point = partial(_PairPoint, balances_torque=True)
    return _solve_grid(model, {"lower_pitch_deg": list(lower_pitch_deg)}, make_pair_point, settings, progress)


def compute_rotor_spacing(
    model: str,
    spacing_mm: Sequence[float] = (10, 20, 30, 40),
    rpm: Sequence[float] = (4000, 6000, 8000),
    settings: WakeSettings | None = None,
    progress: ProgressCallback | None = None,
) -> xr.Dataset:
    """Fig. 3.45: the lower rotor at four distances below the upper one, both at the same speed.

    Thesis: Fig. 3.45.
    """

    def make_pair_point(spacing_mm: float, rpm: float) -> _PairPoint:
        return _PairPoint(upper_rpm=rpm, lower_rpm=rpm, spacing_m=1e-3 * spacing_mm)

    return _solve_grid(model, {"spacing_mm": list(spacing_mm), "rpm": list(rpm)}, make_pair_point, settings, progress)


# ----------------------------------------------------------------------------
# Verdicts on the claims of Sec. 3.4.7, each from the results of :mod:`mufly.thesis.coaxial_studies`.
#
# Margins were set before these results were known; the source gives none.


def _lower_over_upper(data: xr.Dataset, field: str) -> NDArray[np.float64]:
    return np.asarray(data[f"lower_{field}"].values / data[f"upper_{field}"].values, dtype=np.float64)


def _format_list(values: NDArray[np.float64], form: str) -> str:
    return ", ".join(form.format(v) for v in values)


def _describe_unconverged(data: xr.Dataset) -> str:
    """Return a sentence on the number of cases that did not converge."""
    missing = int((data.fault != "").sum())
    return f"; {missing} of {data.fault.size} cases not converged" if missing else ""


def judge_equal_speeds(model: str, data: xr.Dataset) -> list[Verdict]:
    """Return the verdicts on the claims about Fig. 3.43, a pair at equal rotor speeds."""
    rpm = f"at {_format_list(data.rpm.values, '{:.0f}')} rpm{_describe_unconverged(data)}"
    thrust, torque = _lower_over_upper(data, "thrust_N"), _lower_over_upper(data, "torque_Nm")
    more = [100 * (data[f"upper_{k}"].values / data[f"single_{k}"].values - 1) for k in ("thrust_N", "torque_Nm")]
    spread = [100 * float(np.ptp(data[k].values) / np.mean(data[k].values)) for k in ("lower_c_T", "lower_c_Q")]
    return [
        judge("coax-thrust", model, f"{_format_list(thrust, '{:.2f}')} {rpm}", thrust=thrust),
        judge(
            "coax-torque",
            model,
            f"{_format_list(100 * (1 - torque), '{:.0f}')} % less {rpm}",
            torque=100 * (1 - torque),
        ),
        judge("coax-constant", model, f"c_T by {spread[0]:.0f} %, c_Q by {spread[1]:.0f} % in all", spread=max(spread)),
        judge(
            "coax-upper",
            model,
            f"thrust {_format_list(more[0], '{:+.1f}')} %, torque {_format_list(more[1], '{:+.1f}')} %",
            holds=all(np.all((v > 0) & (v < 10)) for v in more),
        ),
    ]


def judge_one_speed_fixed(model: str, data: xr.Dataset) -> list[Verdict]:
    """Return the verdicts on the claims about Fig. 3.44, a pair with one constant rotor speed."""
    upper, lower = data.sel(varied="upper"), data.sel(varied="lower")
    known = [part.isel(rpm=np.flatnonzero(np.isfinite(part.lower_c_T.values))) for part in (upper, lower)]
    c_T = [1e3 * part.lower_c_T.values for part in known]

    def describe_coefficients(k: int) -> str:
        rpm, part = known[k].rpm.values, (upper, lower)[k]
        return (
            f"1000 c_T {_format_list(c_T[k], '{:.1f}')} at {_format_list(rpm, '{:.0f}')} "
            f"rpm{_describe_unconverged(part)}"
        )

    enough = [v.size >= 3 for v in c_T]
    return [
        judge(
            "coax-upper-speed",
            model,
            describe_coefficients(0),
            step=np.diff(c_T[0]),
            holds=(enough[0]) and (c_T[0][-1] < 0.7 * c_T[0][0]),
        ),
        judge(
            "coax-lower-speed", model, describe_coefficients(1), step=np.diff(c_T[1]), first=c_T[1][:1], holds=enough[1]
        ),
    ]


def judge_balance(model: str, data: xr.Dataset) -> list[Verdict]:
    """Return the verdicts on the example of Sec. 3.4.7 and on Table 3.4, pairs with balanced torques."""
    first = data.sel(lower_pitch_deg=14)
    rpm = float(first.lower_rpm)
    deficit = 100 * (1 - float(first.lower_thrust_N / first.upper_thrust_N))
    excess = 100 * (float(first.lower_power_W / first.upper_power_W) - 1)
    theirs = np.array([TABLE_3_4_VALUES[int(p)] for p in data.lower_pitch_deg.values])
    found = []
    for k, (name, field, form, unit) in enumerate((
        ("coax-pitch-speed", "lower_rpm", "{:.0f}", "rpm"),
        ("coax-pitch-thrust", "lower_thrust_N", "{:.4f}", "N"),
        ("coax-pitch-power", "lower_power_W", "{:.3f}", "W"),
    )):  # fmt: skip
        ours = data[field].values
        change = 100 * (ours / theirs[:, k] - 1)
        text = f"{_format_list(ours, form)} {unit} ({_format_list(change, '{:+.1f}')} %){_describe_unconverged(data)}"
        found.append(judge(name, model, text, change=change))
    return [
        judge("coax-trim", model, f"{rpm:.0f} rpm", rpm=rpm),
        judge("coax-deficit", model, f"{deficit:.1f} %", deficit=deficit),
        judge("coax-excess", model, f"{excess:.1f} %", excess=excess),
        *found,
    ]


def judge_rotor_spacing(model: str, data: xr.Dataset) -> list[Verdict]:
    """Return the verdicts on the claims about Fig. 3.45, a pair at four spacings."""
    thrust = data.lower_thrust_N
    spread = np.asarray(100 * ((thrust.max("spacing_mm") - thrust.min("spacing_mm")) / thrust.mean("spacing_mm")))
    speeds = _format_list(data.rpm.values, "{:.0f}")
    return [
        judge(
            "coax-spacing",
            model,
            f"lower thrust changes by {_format_list(spread, '{:.0f}')} % in all at {speeds} "
            f"rpm{_describe_unconverged(data)}",
            spread=spread,
            holds=(data.fault == "").all(),
        )
    ]
