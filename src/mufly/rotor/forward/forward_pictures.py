"""Pictures of rotors in forward flight: over the disc, and over airspeed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mufly.results import draws
from mufly.results.result_figure import blank_figure, label_axes
from mufly.rotor.forward.forward_results import ForwardResult, ForwardSweep
from mufly.rotor.forward.skewed_pair import ForwardPair, PairSweep

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mufly.rotor.forward.edgewise_map import AirspeedMapLoads
    from mufly.vehicle import FlightMap


@draws(ForwardResult)
def draw_disc_fields(result: ForwardResult) -> Figure:
    """Draw induced velocity, onset angle and load of a blade over the disc, seen from above, the air from the top."""

    disc = result.disc
    figure = blank_figure(12.0, 4.6)
    psi = np.append(disc.azimuth_rad, 2.0 * math.pi)
    hidden = np.abs(disc.onset_angle_rad) > math.radians(45.0)  # reversed flow
    onset = np.where(hidden, np.nan, np.degrees(disc.onset_angle_rad))
    for k, (values, title, colours) in enumerate(
        (
            (disc.axial_induced_m_s, "Induced velocity, down (m/s)", "viridis"),
            (onset, "Onset angle (deg)", "RdBu_r"),
            (disc.thrust_per_length_N_m, "Thrust of a blade per length (N/m)", "magma"),
        ),
        start=1,
    ):
        axes: Any = figure.add_subplot(1, 3, k, projection="polar")
        axes.set_theta_zero_location("S")  # psi = 0 aft
        rings = np.concatenate((values, values[:1]))
        limits = {}
        if k == 2:
            most = float(np.nanmax(np.abs(values)))
            limits = {"vmin": -most, "vmax": most}
        drawn = axes.pcolormesh(psi, 1e3 * disc.r_m, rings.T, shading="gouraud", cmap=colours, **limits)
        axes.grid(False)
        axes.set_xticks(np.radians([0, 90, 180, 270]), ["0° aft", "90°", "180°", "270°"])
        tip = 1e3 * float(disc.r_m[-1])
        axes.set_yticks([])
        axes.set_xlabel(f"Radius {tip:.0f} mm", fontsize="small")
        axes.set_title(title, fontsize="medium")
        figure.colorbar(drawn, ax=axes, shrink=0.8, pad=0.1)
    figure.suptitle(
        f"{result.edgewise_m_s:g} m/s (advance ratio {result.advance_ratio:.3f}), flap frequency "
        f"{result.flap_frequency_ratio:.3g}/rev; the air comes from the top, azimuth increases with the rotation",
        fontsize="medium",
    )
    return figure


@draws(ForwardSweep)
def draw_forward_sweep(sweep: ForwardSweep) -> Figure:
    """Draw loads, moments, flapping and the response to cyclic pitch over airspeed, a line for each flap frequency."""
    figure = blank_figure(12.0, 7.5)
    axes = figure.subplots(2, 4).ravel()
    for line, answers in zip(sweep.points, sweep.responses, strict=True):
        speed = np.array([p.edgewise_m_s for p in line])
        label = f"{line[0].flap_frequency_ratio:.3g}/rev"
        columns = (
            ("Thrust (N)", [p.thrust_N for p in line]),
            ("Shaft power (W)", [p.power_W for p in line]),
            ("H force, aft (mN)", [1e3 * p.h_force_N for p in line]),
            ("Y force, right (mN)", [1e3 * p.y_force_N for p in line]),
            ("Hub moment, nose up (mN m)", [1e3 * p.pitch_moment_Nm for p in line]),
            ("Hub moment, right side down (mN m)", [1e3 * p.roll_moment_Nm for p in line]),
            ("Flapping aft, -b1c (deg)", [-math.degrees(p.flap_cos_rad) for p in line]),
            ("Moment per cyclic (mN m/deg)", [1e3 * r.moment_Nm_deg for r in answers]),
        )
        for one, (name, values) in zip(axes, columns, strict=True):
            one.plot(speed, values, label=label, marker="." if speed.size < 30 else "")
            label_axes(one, "Edgewise airspeed (m/s)", name)
    axes[0].legend(title="Flap frequency", fontsize="small")
    figure.suptitle(f"{sweep.rotor}: {sweep.flap_basis}" if sweep.flap_basis else sweep.rotor, fontsize="medium")
    return figure


@draws(ForwardPair)
def draw_lower_disc_fields(pair: ForwardPair) -> Figure:
    """Draw induced velocity, onset angle and load over the disc of the lower rotor, in the stream of the upper one."""
    return draw_disc_fields(pair.lower)


@draws(PairSweep)
def draw_pair_sweep(sweep: PairSweep) -> Figure:
    """Draw the loads of both rotors and their sums over airspeed, a colour for each flap frequency."""
    figure = blank_figure(12.0, 7.0)
    axes = figure.subplots(2, 3).ravel()
    for k, line in enumerate(sweep.points):
        speed = [p.upper.edgewise_m_s for p in line]
        label = f"{line[0].upper.flap_frequency_ratio:.3g}/rev"
        for values, style, side in (
            ([p.upper.thrust_N for p in line], "-", "upper"),
            ([p.lower.thrust_N for p in line], "--", "lower"),
        ):
            axes[0].plot(speed, values, style, color=f"C{k}", label=f"{label}, {side}")
        for one, values in zip(
            axes[1:],
            (
                [p.power_W for p in line],
                [1e3 * p.h_force_N for p in line],
                [1e3 * p.pitch_moment_Nm for p in line],
                [1e3 * p.roll_moment_Nm for p in line],
                [p.stream_share_on_lower_disc for p in line],
            ),
            strict=True,
        ):
            one.plot(speed, values, color=f"C{k}", label=label)
    labels = (
        "Thrust (N)", "Shaft power of both (W)", "H force of both, aft (mN)", "Hub moments, nose up (mN m)",
        "Hub moments, right side down (mN m)", "Stream on the lower disc (share)",
    )  # fmt: skip
    for one, name in zip(axes, labels, strict=True):
        label_axes(one, "Edgewise airspeed (m/s)", name)
    axes[0].legend(title="Flap frequency", fontsize="small")
    figure.suptitle(f"{' over '.join(sweep.rotors)}: {sweep.flap_basis}", fontsize="medium")
    return figure


def draw_flight_map(flight_map: FlightMap, loads: AirspeedMapLoads) -> Figure:
    """Draw the loads of a flight map over airspeed at its middle speed ratio without climb."""
    figure = blank_figure(12.0, 6.5)
    axes = figure.subplots(2, 3).ravel()
    columns = (
        ("Thrust over that of hover (%)", 100.0 * loads.thrust_excess + 100.0),
        ("Torque over that of hover (%)", 100.0 * loads.torque_excess + 100.0),
        ("H force, aft (mN)", 1e3 * loads.drag_N),
        ("Y force, right (mN)", 1e3 * loads.side_N),
        ("Hub moment, nose up (mN m)", 1e3 * loads.pitch_moment_Nm),
        ("Hub moment, right side down (mN m)", 1e3 * loads.roll_moment_Nm),
    )
    for one, (name, values) in zip(axes, columns, strict=True):
        for k, side in enumerate(("upper", "lower")):
            one.plot(loads.airspeed_m_s, values[:, k], marker=".", label=side)
        if float(abs(values).max()) < 1e-6:  # rounding, as the hub moments of a free hinge
            one.set_ylim(-1.0, 1.0)
        label_axes(one, "Edgewise airspeed (m/s)", name)
    axes[0].legend(title="Rotor", fontsize="small")
    low, high = flight_map.level_speed_m_s
    figure.suptitle(
        f"{flight_map.upper} on {flight_map.vehicle}, flap frequency {flight_map.flap_frequency_ratios[0]:.3g} and "
        f"{flight_map.flap_frequency_ratios[1]:.3g}/rev; greatest level airspeed {low:.1f} to {high:.1f} m/s",
        fontsize="medium",
    )
    return figure
