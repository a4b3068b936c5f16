"""Pictures of bench fits: the two plots of the dissertation's Fig. 5.1 and their residuals, coefficients over speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.identify.motor import MotorFit
from mufly.identify.rotor_fit import CoefficientFit, RotorFit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["motor_picture", "rotor_picture"]

Array = NDArray[np.float64]

_RPM = math.pi / 30.0
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito (2008)
_MOST_LINES = 6


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _levels(voltage: Array) -> list[NDArray[np.bool_]]:
    """Group points whose voltages lie within 4 % of each other; one group of all if they are not on levels."""
    order = np.argsort(voltage)
    steps = np.diff(voltage[order]) > 0.04 * np.abs(voltage[order][1:])
    label = np.empty(voltage.size, dtype=np.int64)
    label[order] = np.cumsum(np.r_[0, steps])
    count = int(label.max()) + 1
    if count > _MOST_LINES or (count == 1 and np.ptp(voltage) > 0.08 * np.max(np.abs(voltage))):
        return [np.ones(voltage.size, dtype=bool)]
    return [label == k for k in range(count)]


def motor_picture(fit: MotorFit, *, title: str = "") -> Figure:
    """Draw current over torque and torque over speed with the fitted lines, and the residuals of both equations.

    Readings on levels of the voltage get a line each, at the mean voltage; otherwise the adjusted readings are drawn.
    """
    r, a, b, d = fit.effective
    data = fit.data
    figure = _figure(9.0, 6.6)
    axes = figure.subplots(2, 2)
    groups = _levels(data.voltage_V)
    lines = len(groups) > 1 or np.ptp(data.voltage_V) <= 0.08 * np.max(np.abs(data.voltage_V))
    for k, inside in enumerate(groups):
        colour = _COLOURS[k % len(_COLOURS)]
        u = float(data.voltage_V[inside].mean())
        torque = data.torque_Nm[inside]
        name = f"{u:.2f} V" if lines else "all voltages"
        axes[0, 0].plot(
            1e3 * torque, data.current_A[inside], "o", color=colour, markersize=4, label=f"{name}, measured"
        )
        axes[0, 1].plot(
            data.speed_rad_s[inside] / _RPM, 1e3 * torque, "o", color=colour, markersize=4, label=f"{name}"
        )
        if lines:
            q = np.linspace(min(0.0, float(torque.min())), float(torque.max()), 50)
            w = (b * u / r - q) / (b * a / r + d)
            axes[0, 0].plot(1e3 * q, (u - a * w) / r, color=colour, linewidth=1.2, label=f"{name}, fitted")
            axes[0, 1].plot(w / _RPM, 1e3 * q, color=colour, linewidth=1.2)
        else:
            better = fit.adjusted
            axes[0, 0].plot(
                1e3 * better.torque_Nm, better.current_A, "x", color=colour, markersize=5, label="fitted"
            )
            axes[0, 1].plot(
                better.speed_rad_s / _RPM, 1e3 * better.torque_Nm, "x", color=colour, markersize=5
            )
        share = fit.residual[inside] / fit.expected[inside]
        axes[1, 0].plot(1e3 * torque, share[:, 0], "o", color=colour, markersize=4)
        axes[1, 1].plot(1e3 * torque, share[:, 1], "o", color=colour, markersize=4)
    labels = (
        ("Torque (mN m)", "Current (A)"), ("Speed (rpm)", "Torque (mN m)"),
        ("Torque (mN m)", "Residual of the voltage (in std)"),
        ("Torque (mN m)", "Residual of the torque (in std)"),
    )  # fmt: skip
    for ax, (x, y) in zip(axes.ravel(), labels, strict=True):
        ax.set_xlabel(x)
        ax.set_ylabel(y)
        ax.grid(alpha=0.3)
    for ax in axes[1]:
        _band(ax)
    axes[0, 0].legend(fontsize="x-small")
    figure.suptitle(title or "Motor constants by least squares", fontsize="medium")
    return figure


def rotor_picture(
    fits: Sequence[RotorFit], *, predicted: dict[str, tuple[Array, Array]] | None = None, title: str = ""
) -> Figure:
    """Draw loads, coefficients and residuals of every fit over speed.

    Parameters
    ----------
    fits : sequence of RotorFit
    predicted : dict, optional
        ``"<source> <channel>"`` -> speeds (rad/s) and predicted loads.
    title : str
    """
    figure = _figure(10.0, 8.4)
    axes = figure.subplots(3, 2, sharex=True, height_ratios=(1.3, 1.0, 0.8))
    k = 0
    for result in fits:
        for fit in result.fits:
            column = 0 if fit.channel.startswith("thrust") else 1
            colour = _COLOURS[k % len(_COLOURS)]
            name = _label(result, fit)
            extra = (predicted or {}).get(f"{result.source} {fit.channel}")
            _draw(axes[:, column], fit, colour, name, extra)
            k += 1
    for column, (load, coefficient) in enumerate((("Thrust (N)", "c_T"), ("Torque (N m)", "c_Q"))):
        top, middle, bottom = axes[:, column]
        top.set_ylabel(load)
        middle.set_ylabel(coefficient)
        bottom.set_ylabel("Residual (in std)")
        bottom.set_xlabel("Rotor speed (rpm)")
        _band(bottom)
        for ax in (top, middle, bottom):
            ax.grid(alpha=0.3)
        if top.get_legend_handles_labels()[0]:
            top.legend(fontsize="x-small")
        low, high = middle.get_ylim()
        middle.set_ylim(min(low, 0.0), high * 1.05)
    figure.suptitle(title or "Rotor coefficients by least squares", fontsize="medium")
    return figure


def _label(result: RotorFit, fit: CoefficientFit) -> str:
    pitch = "" if math.isnan(result.pitch_rad) else f" at {math.degrees(result.pitch_rad):.3g} deg"
    return f"{', '.join(fit.symbols)} {result.source}{pitch}"


def _draw(
    axes: Sequence[Axes], fit: CoefficientFit, colour: str, name: str, predicted: tuple[Array, Array] | None
) -> None:
    top, middle, bottom = axes
    rpm = np.abs(fit.speed_rad_s[:, 0]) / _RPM
    order = np.argsort(rpm)
    top.plot(rpm, fit.load, "o", color=colour, markersize=4, label=name)
    top.plot(rpm[order], (fit.unit_load @ fit.value)[order], color=colour, linewidth=1.2)
    bottom.plot(rpm, fit.residual / fit.expected, "o", color=colour, markersize=4)
    if predicted is not None:
        p = np.argsort(predicted[0])
        top.plot(predicted[0][p] / _RPM, predicted[1][p], ":", color=colour, label=f"{name}, predicted")
    if len(fit.symbols) > 1:
        return
    middle.plot(rpm, fit.load / fit.unit_load[:, 0], "o", color=colour, markersize=4)
    std = math.sqrt(fit.covariance[0, 0]) * fit.spread.quantile
    middle.plot(rpm[order], np.full(rpm.size, fit.value[0]), color=colour, linewidth=1.2)
    middle.fill_between(
        rpm[order], fit.value[0] - std, fit.value[0] + std, color=colour, alpha=0.15, linewidth=0
    )
    for trend in fit.trends:
        if trend.significant:
            w = np.geomspace(*trend.range_rad_s, 60)
            middle.plot(w / _RPM, trend.value_at(w), "--", color=colour, linewidth=1.2)
    if predicted is not None:
        unit = np.interp(predicted[0], np.abs(fit.speed_rad_s[:, 0])[order], fit.unit_load[order, 0])
        middle.plot(predicted[0][p] / _RPM, (predicted[1] / unit)[p], ":", color=colour)


def _band(ax: Axes) -> None:
    ax.axhspan(-2, 2, color="0.5", alpha=0.12, linewidth=0)
    ax.axhline(0, color="0.4", linewidth=0.8)
