"""Studies of parameters: Tables 5.1 to 5.3 and Figs 5.1 and 5.3 to 5.6.

The source's flights are not published. Simulated flights of a vehicle with the numbers of Table 5.3 replace them, under
the source's conditions (:mod:`mufly.identify.flight.identification_demo`). Half of its parameters are assumed to be
unknown and are identified. The truth is known, so the method is tested.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from mufly.bench import BenchTable
from mufly.identify import IdentificationDemo, MotorFit, fit_motor, run_identification_demo
from mufly.identify.fit_pictures import draw_motor_fit, draw_prediction
from mufly.identify.flight.identification_demo import SENSOR_NOISE_STD
from mufly.identify.residual_analysis import assess_record_predictions
from mufly.quantities.units import RPM
from mufly.results.result_figure import blank_figure
from mufly.thesis.claims import CLAIMS, TABLE_5_3_VALUES, ProgressCallback, Study, StudyFindings, judge, make_item_judge
from mufly.vehicle import list_parameters, load_vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Table 5.1: key -> method, in the terms of the vehicle files.
METHOD_BY_GROUND_PARAMETER = {
    "body.mass": "measured",
    "body.inertia_xx": "CAD",
    "body.inertia_yy": "CAD",
    "body.inertia_zz": "CAD",
    "rotors.lower.hub_z": "CAD",
    "rotors.upper.hub_z": "CAD",
    "swash_plate.max_tilt": "measured",
    "rotors.radius": "measured",
    "rotors.lower.drive_inertia": "estimated",
    "rotors.upper.drive_inertia": "estimated",
    "gear.ratio": "measured",
    "gear.efficiency": "estimated",
    "battery.nominal_voltage": "datasheet",
}
# Table 5.2: key -> method here.
METHOD_BY_BENCH_PARAMETER = {
    "rotors.lower.thrust_coefficient": "rotor",
    "rotors.upper.thrust_coefficient": "rotor",
    "rotors.lower.torque_coefficient": "rotor",
    "rotors.upper.torque_coefficient": "rotor",
    "motor.back_emf_constant": "motor",
    "motor.torque_constant": "motor",
    "motor.friction": "motor",
    "motor.resistance": "motor",
}
_GROUND_PARAMETERS_REFITTED_IN_FLIGHT = {"rotors.lower.drive_inertia", "rotors.upper.drive_inertia"}


def _draw_table(
    title: str, heads: tuple[str, ...], rows: Sequence[tuple[str, ...]], widths: tuple[float, ...]
) -> Figure:
    drawn = blank_figure(9.0, 0.9 + 0.24 * len(rows))
    axes = drawn.subplots()
    axes.axis("off")
    table = axes.table(
        [list(r) for r in rows], colLabels=list(heads), colWidths=list(widths), loc="center", cellLoc="left"
    )
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    table.scale(1.0, 1.15)
    axes.set_title(title, fontsize="medium")
    return drawn


def study_ground_parameters(progress: ProgressCallback | None = None) -> StudyFindings:
    """Table 5.1: source of each number in the vehicle file, beside the method that the table states.

    Thesis: Table 5.1.
    """
    rows = {p.key: p for p in list_parameters(load_vehicle("mufly-1.1"))}
    said = {k: rows[k].source for k in METHOD_BY_GROUND_PARAMETER}
    other = [
        k
        for k, method in METHOD_BY_GROUND_PARAMETER.items()
        if said[k] != method and k not in _GROUND_PARAMETERS_REFITTED_IN_FLIGHT
    ]
    later = [k for k in _GROUND_PARAMETERS_REFITTED_IN_FLIGHT if said[k] == "identified"]
    same = len(METHOD_BY_GROUND_PARAMETER) - len(other) - len(later)
    verdicts = [
        judge(
            "table-5.1/thirteen-parameters-are-known-before-any",
            "mufly-1.1",
            f"{same} of {len(METHOD_BY_GROUND_PARAMETER)} with the same method; {len(later)} drive inertias, estimated "
            "first, are as fitted in flight afterwards" + (f"; other: {', '.join(other)}" if other else ""),
            holds=not other,
        ),
    ]
    drawn = _draw_table(
        "Table 5.1: known before any test",
        ("parameter", "value", "unit", "source there", "source here"),
        [(k, f"{rows[k].value:.4g}", rows[k].unit, m, said[k]) for k, m in METHOD_BY_GROUND_PARAMETER.items()],
        (0.36, 0.15, 0.13, 0.18, 0.18),
    )
    return StudyFindings(verdicts, drawn)


def simulate_motor_bench() -> BenchTable:
    """Simulate the readings of a motor bench at 7.2 V with Table 5.3's constants and 1 % of noise."""
    m = load_vehicle("mufly-1.1").motor
    kE, kM, R, dR = (float(v) for v in (m.back_emf_constant, m.torque_constant, m.resistance, m.friction))
    u = np.repeat([4.5, 6.0, 7.2], 16)
    torque = np.tile(np.linspace(0.3e-3, 8e-3, 16), 3)
    speed = (kM * u / R - torque) / (kM * kE / R + dR)
    turning = speed > 400.0
    u, torque, speed = u[turning], torque[turning], speed[turning]
    y = np.column_stack([u, (u - kE * speed) / R, speed, torque])
    y *= 1 + 0.01 * np.random.default_rng(0).standard_normal(y.shape)
    names = ("voltage", "current", "speed", "torque")
    return BenchTable(
        "simulated with Table 5.3", dict(zip(names, y.T, strict=True)), {k: k for k in names}, np.arange(len(y))
    )


@functools.lru_cache(maxsize=1)
def _fit_motor() -> MotorFit:
    return fit_motor(simulate_motor_bench())


def _compare_with_truth(fit: MotorFit) -> tuple[int, str]:
    v = {p.symbol: float(p.value) for p in list_parameters(load_vehicle("mufly-1.1")) if p.key.startswith("motor.")}
    inside = [e.low <= v[e.symbol] <= e.high for e in fit.estimates]
    text = ", ".join(
        f"{e.symbol} {e.value:.4g} ({e.low:.4g} to {e.high:.4g}; true {v[e.symbol]:.5g})" for e in fit.estimates
    )
    return sum(inside), text


def study_bench_parameters(progress: ProgressCallback | None = None) -> StudyFindings:
    """Table 5.2: the eight numbers measured on benches, with the mufly commands that measure them."""
    rows = {p.key: p for p in list_parameters(load_vehicle("mufly-1.1"))}
    words = {k: rows[k].source for k in METHOD_BY_BENCH_PARAMETER}
    held, _ = _compare_with_truth(_fit_motor())
    verdicts = [
        judge(
            "table-5.2/eight-parameters-come-from-rotor-and",
            "mufly identify rotor | motor",
            f"{len(METHOD_BY_BENCH_PARAMETER)} in the vehicle file, {sum(w == 'identified' for w in words.values())} "
            f"of them marked identified; of a simulated motor bench {held} of 4 intervals hold the truth",
            held=held,
            holds=all(w == "identified" for w in words.values()),
        ),
    ]
    drawn = _draw_table(
        "Table 5.2: found on benches",
        ("parameter", "value", "unit", "found here by"),
        [
            (k, f"{rows[k].value:.4g}", rows[k].unit, f"mufly identify {b}")
            for k, b in METHOD_BY_BENCH_PARAMETER.items()
        ],
        (0.42, 0.16, 0.16, 0.26),
    )
    return StudyFindings(verdicts, drawn)


def study_motor_fit(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 5.1: current over torque and torque over speed at constant voltage."""
    fit = _fit_motor()
    held, text = _compare_with_truth(fit)
    m = load_vehicle("mufly-1.1").motor
    kE, kM, R, dR = (float(v) for v in (m.back_emf_constant, m.torque_constant, m.resistance, m.friction))
    idle = 7.2 * kM / R / (kM * kE / R + dR)
    loaded = (7.2 * kM / R - 8e-3) / (kM * kE / R + dR)
    current = (7.2 - kE * loaded) / R
    assess = make_item_judge("fig-5.1", "Table 5.3, 7.2 V")
    verdicts = [
        judge(
            "fig-5.1/the-constants-come-out-of-steady",
            "simulated bench, 1 % noise",
            f"{held} of 4 intervals hold the truth: {text}",
            held=held,
        ),
        assess("8-mn-m-take-less-than", f"{current:.2f} A", current=current),
        assess(
            "speeds-lie-between-6-000-and",
            f"{loaded / RPM:.0f} rpm at 8 mN m, {idle / RPM:.0f} idle",
            loaded=loaded / RPM,
            idle=idle / RPM,
        ),
    ]
    drawn = draw_motor_fit(
        fit, title="Fig. 5.1: motor constants by least squares (simulated bench with Table 5.3's motor)"
    )
    data = xr.Dataset(
        {
            "value": ("symbol", [e.value for e in fit.estimates]),
            "low": ("symbol", [e.low for e in fit.estimates]),
            "high": ("symbol", [e.high for e in fit.estimates]),
        },
        coords={"symbol": [e.symbol for e in fit.estimates]},
    )
    return StudyFindings(verdicts, drawn, {"fit": data})


@functools.lru_cache(maxsize=1)
def _run_identification_demo() -> IdentificationDemo:
    return run_identification_demo(seed=0)


# Record -> outputs in the source's figure, its statement, and the range of the last output's axis.
_FIGURE_OUTPUTS_BY_FLIGHT = {"yaw": ("height", "r"), "heave": ("height", "r"), "roll": ("roll",), "pitch": ("pitch",)}


def _study_flight(name: str) -> StudyFindings:
    shown, key = _FIGURE_OUTPUTS_BY_FLIGHT[name], f"flight/{name}-range"
    demo = _run_identification_demo()
    record = next(r for r in demo.fit.records if name in r.name)
    found = dict(zip(record.output_names, assess_record_predictions(record), strict=True))
    fits = ", ".join(f"{o} {found[o].fit_percent:.0f} %" for o in shown)
    last = record.measured[:, record.output_names.index(shown[-1])]
    last = last - (np.median(last) if name in ("roll", "pitch") else 0.0)
    ratio = [float(found[o].rms / SENSOR_NOISE_STD[o]) for o in shown]
    text = ", ".join(f"{o} {r:.2f}" for o, r in zip(shown, ratio, strict=True))
    verdicts = [
        judge(
            "flight/model-and-experiment-are-well-correlated",
            "flown vehicle, fitted model",
            f"prediction from the inputs alone fits to {fits}; error over the sensors' noise: {text}",
            ratio=max(ratio),
        ),
        judge(key, "flown vehicle", f"{np.nanmin(last):.2f} to {np.nanmax(last):.2f}", span=np.ptp(last)),
    ]
    drawn = draw_prediction(record)
    drawn.suptitle(f"{CLAIMS[key].where}: actuation in {name}; half the parameters forgotten, found again")
    data = xr.Dataset(
        {
            "measured": (("time_s", "output"), record.measured),
            "predicted": (("time_s", "output"), record.predicted),
        },
        coords={"time_s": record.time_s, "output": list(record.output_names)},
    )
    return StudyFindings(verdicts, drawn, {"record": data})


def study_yaw_flight(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 5.3: yaw flight for identification, simulated and fitted."""
    return _study_flight("yaw")


def study_heave_flight(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 5.4: heave flight for identification, simulated and fitted."""
    return _study_flight("heave")


def study_roll_flight(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 5.5: roll flight for identification, simulated and fitted."""
    return _study_flight("roll")


def study_pitch_flight(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 5.6: pitch flight for identification, simulated and fitted."""
    return _study_flight("pitch")


def study_all_parameters(progress: ProgressCallback | None = None) -> StudyFindings:
    """Table 5.3: compare the printed parameters with the vehicle file, and both with a fit of simulated flights."""
    rows = {p.key: p for p in list_parameters(load_vehicle("mufly-1.1"))}
    printed = {k: math.radians(v) if k == "swash_plate.max_tilt" else v for k, v in TABLE_5_3_VALUES.items()}
    other = [k for k, v in printed.items() if abs(float(np.ravel(rows[k].value)[0]) / v - 1) > 1e-6]
    demo = _run_identification_demo()
    inside = demo.truth_inside_interval()
    off = {e.symbol: 100 * (e.value / demo.truth[e.symbol] - 1) for e in demo.fit.estimates}
    worst = max(off, key=lambda s: abs(off[s]))
    held = sum(inside.values())
    verdicts = [
        judge(
            "table-5.3/26-numbers",
            "mufly-1.1",
            f"{len(printed) - len(other)} of {len(printed)} equal" + (f"; other: {', '.join(other)}" if other else ""),
            holds=not other,
        ),
        judge(
            "table-5.3/the-numbers-can-be-found-from",
            "flown vehicle, twelve numbers 50 % off",
            f"{held} of {len(inside)} 95 % intervals hold the truth; the farthest off is {worst}, {off[worst]:+.1f} %; "
            f"held-out error over noise {demo.held_out_over_noise:.3f}",
            held=held,
            held_out_over_noise=demo.held_out_over_noise,
        ),
    ]
    by_key = {e.key: e for e in demo.fit.estimates if e.key}
    table = []
    for key, value in printed.items():
        e = by_key.get(key)
        table.append(
            (
                key,
                f"{value:.5g}",
                rows[key].unit,
                "" if e is None else f"{e.value:.4g} ({e.low:.4g} to {e.high:.4g})",
            )
        )
    drawn = _draw_table(
        "Table 5.3, and what flights of that vehicle give back",
        ("parameter", "printed (SI)", "unit", "identified from flights, 95 %"),
        table,
        (0.36, 0.14, 0.14, 0.36),
    )
    data = xr.Dataset(
        {
            "value": ("symbol", [e.value for e in demo.fit.estimates]),
            "low": ("symbol", [e.low for e in demo.fit.estimates]),
            "high": ("symbol", [e.high for e in demo.fit.estimates]),
            "truth": ("symbol", [demo.truth[e.symbol] for e in demo.fit.estimates]),
        },
        coords={"symbol": [e.symbol for e in demo.fit.estimates]},
    )
    return StudyFindings(verdicts, drawn, {"fit": data})


STUDIES: dict[str, Study] = {
    "table-5.1": Study(study_ground_parameters, 0.2),
    "table-5.2": Study(study_bench_parameters, 0.3),
    "fig-5.1": Study(study_motor_fit, 0.5),
    "fig-5.3": Study(study_yaw_flight, 30),
    "fig-5.4": Study(study_heave_flight, 30),
    "fig-5.5": Study(study_roll_flight, 30),
    "fig-5.6": Study(study_pitch_flight, 30),
    "table-5.3": Study(study_all_parameters, 30),
}
