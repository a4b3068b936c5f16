"""Pictures of frequency responses, transfer functions and reconstructed flights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.identify import fit_pictures
from mufly.identify.linear.bandwidth import Bandwidth
from mufly.identify.linear.frequency_response import MIN_PARTIAL_COHERENCE, FrequencyResponse
from mufly.identify.linear.sweep_response import TransferFunctionFit
from mufly.results import draws
from mufly.results.result_figure import blank_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mufly.identify.linear.flight_path_reconstruction import ReconstructedPath

Array = NDArray[np.float64]


@draws(FrequencyResponse)
def draw_frequency_response(
    data: FrequencyResponse,
    output: int = 0,
    *,
    fits: Sequence[TransferFunctionFit] = (),
    read: Bandwidth | None = None,
) -> Figure:
    """Draw the responses of one output to all inputs: magnitude, phase and partial coherence, 95 % error bars.

    Parameters
    ----------
    data : FrequencyResponse
    output : int
        Index of the output.
    fits : sequence of TransferFunctionFit
        Transfer functions drawn over their pairs.
    read : Bandwidth, optional
        Bandwidth marked in the first column.
    """
    k, f = len(data.inputs), data.frequency_hz
    figure = blank_figure(min(12.0, 1.6 + 3.6 * k), 6.6)
    panels = figure.subplots(3, k, squeeze=False, sharex=True, height_ratios=(1.3, 1.3, 1.0))
    for i in range(k):
        top, middle, bottom = panels[:, i]
        h, gamma = data.response[:, output, i], data.partial[:, output, i]
        seen = np.isfinite(h)
        good = seen & (gamma >= MIN_PARTIAL_COHERENCE)
        level = 20.0 * np.log10(np.maximum(np.abs(np.where(seen, h, 1.0)), 1e-12))
        phase = _unwrap_phase(np.where(seen, h, 1.0), good)
        spread = np.minimum(data.relative_half_interval[:, output, i], 1.0)
        bar = {"fmt": "o", "markersize": 2.5, "linewidth": 0.7}
        for points, colour, label in (
            (good, fit_pictures.BLUE, "coherent, 95 %"),
            (seen & ~good, "0.65", f"coherence < {MIN_PARTIAL_COHERENCE:g}"),
        ):  # fmt: skip
            if not points.any():
                continue
            size = 1.0 if points is good else 0.0
            top.errorbar(f[points], level[points], yerr=8.686 * size * spread[points], color=colour, label=label, **bar)
            middle.errorbar(
                f[points],
                phase[points],
                yerr=np.degrees(size * np.arcsin(spread[points])),
                color=colour,
                **bar,
            )
        for fit in fits:
            if (fit.input, fit.output) == (data.inputs[i], data.outputs[output]):
                inside = (f >= fit.band_hz[0]) & (f <= fit.band_hz[1])
                model = fit.response_at(f)
                turned = np.degrees(np.unwrap(np.angle(model)))
                if good.any():
                    turned += 360.0 * np.round(np.median((phase - turned)[good]) / 360.0)
                orders = f"{len(fit.numerator) - 1} zeros, {len(fit.denominator) - 1} poles, J = {fit.cost:.0f}"
                top.plot(
                    f[inside],
                    20.0 * np.log10(np.abs(model))[inside],
                    color=fit_pictures.VERMILION,
                    label=orders,
                )
                middle.plot(f[inside], turned[inside], color=fit_pictures.VERMILION)
        if read is not None and i == 0:
            for value, colour, label in (
                (read.phase_rad_s, fit_pictures.GREEN, "phase bandwidth"),
                (read.gain_rad_s, fit_pictures.PURPLE, "gain bandwidth"),
                (read.phase_crossover_rad_s, fit_pictures.ORANGE, "phase -180 deg"),
            ):  # fmt: skip
                if np.isfinite(value):
                    for axes in (top, middle):
                        axes.axvline(value / 2.0 / np.pi, color=colour, linestyle="--", linewidth=1.0)
                    middle.plot([], [], color=colour, linestyle="--", label=f"{label}, {value:.3g} rad/s")
            if middle.get_legend_handles_labels()[0]:
                middle.legend(fontsize=7.0)
        bottom.plot(f, gamma, color=fit_pictures.BLUE, label="partial")
        bottom.plot(f, data.coherence[:, output], color=fit_pictures.text_colour(), linewidth=0.8, label="all inputs")
        bottom.axhline(MIN_PARTIAL_COHERENCE, color="0.5", linestyle=":", linewidth=1.0)
        bottom.set(ylim=(0.0, 1.03), xlabel="frequency (Hz)", xscale="log")
        fit_pictures.set_decade_ticks(bottom)
        top.set_title(f"{data.inputs[i]} to {data.outputs[output]}")
        top.legend(fontsize=7.0)
        bottom.legend(fontsize=7.0, ncols=2)
    for axes, label in zip(panels[:, 0], ("magnitude (dB)", "phase (deg)", "coherence (1)"), strict=True):
        axes.set_ylabel(label)
    return figure


def draw_reconstructed_outputs(c: ReconstructedPath) -> Figure:
    """Draw measured and reconstructed outputs, with their residuals beside them."""
    from mufly.identify.linear.flight_path_reconstruction import FLIGHT_PATH_STATES, STATE_UNITS

    m = len(c.outputs)
    figure = blank_figure(11.0, 0.8 + 1.2 * m)
    panels = figure.subplots(m, 2, squeeze=False, sharex=True, width_ratios=(1.4, 1.0))
    for k, (name, (left, right)) in enumerate(zip(c.outputs, panels, strict=True)):
        j = FLIGHT_PATH_STATES.index(name)
        left.plot(
            c.time_s,
            c.measured[:, k],
            color=fit_pictures.text_colour(),
            alpha=0.5,
            linewidth=0.8,
            label="measured",
        )
        left.plot(c.time_s, c.states[:, j], color=fit_pictures.VERMILION, linewidth=1.0, label="reconstructed")
        left.set_ylabel(f"{name} ({STATE_UNITS[name]})")
        right.plot(c.time_s, c.residual[:, k], color=fit_pictures.BLUE, linewidth=0.6)
        band = 1.96 * float(c.output_noise[k])
        right.axhspan(-band, band, color=fit_pictures.GREEN, alpha=0.18, linewidth=0)
    panels[0][0].legend(ncols=2)
    panels[0][1].set_title("measured less reconstructed; green: 95 % of the noise")
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    return figure


def _unwrap_phase(h: NDArray[np.complex128], good: NDArray[np.bool_]) -> Array:
    """Return the phase (deg) of responses ``h``, unwrapped over the coherent points, where ``good`` is True.

    The phase of each other point is shifted by a multiple of 360 deg to the value nearest to that curve.
    """
    phase = np.degrees(np.angle(h))
    places = np.flatnonzero(good)
    if places.size < 2:
        return phase
    smooth = np.degrees(np.unwrap(np.angle(h[places])))
    near = np.interp(np.arange(len(h)), places, smooth)
    return np.asarray(phase + 360.0 * np.round((near - phase) / 360.0))
