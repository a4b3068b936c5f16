"""Verdicts on the claims of Sec. 3.4.7, each from the results of :mod:`mufly.thesis.coaxial`.

Margins were set before these results were seen; the source gives none.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.thesis.claims import CLAIMS, TABLE_3_4_VALUES, Verdict

__all__ = ["judge_balance", "judge_distances", "judge_equal_speeds", "judge_kept_speed"]


def _share(data: xr.Dataset, field: str) -> NDArray[np.float64]:
    return np.asarray(data[f"lower_{field}"].values / data[f"upper_{field}"].values, dtype=np.float64)


def _list(values: NDArray[np.float64], form: str) -> str:
    return ", ".join(form.format(v) for v in values)


def _solved(data: xr.Dataset) -> str:
    """Say how many cases did not converge."""
    missing = int((data.fault != "").sum())
    return f"; {missing} of {data.fault.size} cases not converged" if missing else ""


def judge_equal_speeds(model: str, data: xr.Dataset) -> list[Verdict]:
    """Fig. 3.43."""
    rpm = f"at {_list(data.rpm.values, '{:.0f}')} rpm{_solved(data)}"
    thrust, torque = _share(data, "thrust_N"), _share(data, "torque_Nm")
    more = [
        100 * (data[f"upper_{k}"].values / data[f"single_{k}"].values - 1) for k in ("thrust_N", "torque_Nm")
    ]
    spread = [
        100 * float(np.ptp(data[k].values) / np.mean(data[k].values)) for k in ("lower_c_T", "lower_c_Q")
    ]
    return [
        Verdict(
            CLAIMS["coax-thrust"], model, f"{_list(thrust, '{:.2f}')} {rpm}",
            bool(np.all((thrust >= 0.50) & (thrust <= 0.60))), "0.50 to 0.60 at every speed",
        ),
        Verdict(
            CLAIMS["coax-torque"], model, f"{_list(100 * (1 - torque), '{:.0f}')} % less {rpm}",
            bool(np.all(np.abs(100 * (1 - torque) - 20) <= 5)), "15 to 25 % less at every speed",
        ),
        Verdict(
            CLAIMS["coax-constant"], model, f"c_T by {spread[0]:.0f} %, c_Q by {spread[1]:.0f} % in all",
            max(spread) < 15, "by less than 15 %",
        ),
        Verdict(
            CLAIMS["coax-upper"], model,
            f"thrust {_list(more[0], '{:+.1f}')} %, torque {_list(more[1], '{:+.1f}')} %",
            bool(all(np.all((v > 0) & (v < 10)) for v in more)), "above alone, by less than 10 %",
        ),
    ]  # fmt: skip


def judge_kept_speed(model: str, data: xr.Dataset) -> list[Verdict]:
    """Fig. 3.44."""
    upper, lower = data.sel(varied="upper"), data.sel(varied="lower")
    known = [part.isel(rpm=np.flatnonzero(np.isfinite(part.lower_c_T.values))) for part in (upper, lower)]
    c_T = [1e3 * part.lower_c_T.values for part in known]

    def text(k: int) -> str:
        rpm, part = known[k].rpm.values, (upper, lower)[k]
        return f"1000 c_T {_list(c_T[k], '{:.1f}')} at {_list(rpm, '{:.0f}')} rpm{_solved(part)}"

    enough = [v.size >= 3 for v in c_T]
    return [
        Verdict(
            CLAIMS["coax-upper-speed"], model, text(0),
            bool(enough[0] and np.all(np.diff(c_T[0]) < 0) and c_T[0][-1] < 0.7 * c_T[0][0]),
            "falls all the way, by more than 30 %",
        ),
        Verdict(
            CLAIMS["coax-lower-speed"], model, text(1),
            bool(enough[1] and np.all(np.diff(c_T[1]) > 0) and c_T[1][0] < 0), "rises all the way, from below zero",
        ),
    ]  # fmt: skip


def judge_balance(model: str, data: xr.Dataset) -> list[Verdict]:
    """Sec. 3.4.7's example and Table 3.4."""
    first = data.sel(lower_pitch_deg=14)
    rpm = float(first.lower_rpm)
    deficit = 100 * (1 - float(first.lower_thrust_N / first.upper_thrust_N))
    excess = 100 * (float(first.lower_power_W / first.upper_power_W) - 1)
    theirs = np.array([TABLE_3_4_VALUES[int(p)] for p in data.lower_pitch_deg.values])
    found = []
    for k, (name, field, form, unit, limit) in enumerate((
        ("coax-pitch-speed", "lower_rpm", "{:.0f}", "rpm", 3.0),
        ("coax-pitch-thrust", "lower_thrust_N", "{:.4f}", "N", 10.0),
        ("coax-pitch-power", "lower_power_W", "{:.3f}", "W", 10.0),
    )):  # fmt: skip
        ours = data[field].values
        change = 100 * (ours / theirs[:, k] - 1)
        text = f"{_list(ours, form)} {unit} ({_list(change, '{:+.1f}')} %){_solved(data)}"
        agrees = bool(np.all(np.abs(change) <= limit))
        found.append(Verdict(CLAIMS[name], model, text, agrees, f"within {limit:g} %"))
    return [
        Verdict(CLAIMS["coax-trim"], model, f"{rpm:.0f} rpm", abs(rpm / 6650 - 1) <= 0.03, "within 3 %"),
        Verdict(CLAIMS["coax-deficit"], model, f"{deficit:.1f} %", abs(deficit - 23) <= 5, "within 5 points"),
        Verdict(CLAIMS["coax-excess"], model, f"{excess:.1f} %", abs(excess - 10) <= 5, "within 5 points"),
        *found,
    ]


def judge_distances(model: str, data: xr.Dataset) -> list[Verdict]:
    """Fig. 3.45."""
    thrust = data.lower_thrust_N
    spread = np.asarray(
        100 * ((thrust.max("spacing_mm") - thrust.min("spacing_mm")) / thrust.mean("spacing_mm"))
    )
    speeds = _list(data.rpm.values, "{:.0f}")
    return [
        Verdict(
            CLAIMS["coax-spacing"], model,
            f"lower thrust changes by {_list(spread, '{:.0f}')} % in all at {speeds} rpm{_solved(data)}",
            bool((data.fault == "").all() and np.all(spread < 15)), "by less than 15 %, every case solved",
        )
    ]  # fmt: skip
