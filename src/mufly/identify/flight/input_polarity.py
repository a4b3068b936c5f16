"""Check of a record against its vehicle: thrust, polarity of the inputs, axis conventions.

A record may be consistent in itself and still be wrong: inverted or exchanged inputs, forward-left-up axes, a height
in centimetres without measured climb. The response to the inputs reveals such faults. The vehicle model, driven by
the recorded inputs, predicts the acceleration by each input (eqs 4.5 to 4.16; :mod:`mufly.dynamics`)::

    height'' = (T_up + T_dw - W) / m  cos(roll) cos(pitch) - g                 rotors by motors and voltage
    r'       = [Q_up + J Omega_up' - Q_dw - J Omega_dw'] / Izz                   upper rotor: nose to the right
    p'       = -z_dw T_dw sin(theta_max l_dw servo_2) / Ixx                    positive servo_2: to the right
    q'       =  z_dw T_dw sin(theta_max l_dw servo_1) / Iyy                    positive servo_1: nose down
    north'', east'' = -(T_up + T_dw) / m times the mast's direction            acceleration towards the tilt

Measured rates and positions are regressed on these predictions at the best lag. A noise model keeps the gain unbiased
under feedback (:mod:`mufly.identify.flight.causal_gain`). In a plain regression an input that rejects a disturbance in
part has the wrong sign. The stabiliser bar, whose tilt follows from the measured attitude, is a further
regressor. The gain should be 1; before identification it is of the order of 1. A sign is accepted if the gain is
significant and its evidence against the other sign, at any lag, suffices: an oscillation equals its own negative half
a period later. An axis without motion, or whose input feedback explains, gets no sign.

Axis conventions: with body axes forward, left, up (FLU; ROS REP 103) q, r, pitch and yaw have inverted signs. The
kinematics cannot detect this; the responses to servo_1 and motor torque can. A world frame with z up inverts the
height, which the response to thrust reveals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from dataclasses import replace as dataclasses_replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.edgewise_loads import tip_path_tilt_target
from mufly.dynamics.model_state import (
    MODEL_ATTITUDE,
    MODEL_BAR_NORMAL,
    MOTOR_INPUT_SLICE,
    ROTOR_SPEED_SLICE,
    SERVO_INPUT_SLICE,
    STATE_SIZE,
    SWAPPED_MOTOR_INPUT_INDICES,
)
from mufly.identify.flight.batch_simulation import simulate_batch, steady_rotor_speeds
from mufly.identify.flight.causal_gain import CausalGain, estimate_causal_gain
from mufly.identify.flight.free_parameters import parameters_at_theta
from mufly.identify.flight.output_error_problem import PreparedRecord, make_problem
from mufly.identify.flight_record import (
    FLIGHT_OUTPUTS,
    MOTION_EULER,
    MOTION_RATES,
    FlightRecord,
    estimate_noise_from_differences,
)
from mufly.identify.record_consistency import (
    SignalFault,
    find_signal_faults,
    refuse_fatal_faults,
    require_consistent_record,
)
from mufly.quantities.units import GRAVITY
from mufly.rotations import body_to_ned_matrices
from mufly.vehicle import Vehicle

Array = NDArray[np.float64]

_START_TRANSIENT_S = 1.0  # settling time of the rotors after a guessed initial speed
_MAX_MOTION_LAG_S = 0.16  # largest lag of the motion behind the inputs
_MIN_GAIN_SIGMAS = 5.0  # least gain over its standard deviation
_MIN_ABSOLUTE_INPUT_GAIN = 0.25  # least absolute gain
_MIN_SIGN_LOG_LIKELIHOOD_RATIO = 10.0  # least logarithm of the likelihood ratio against the other sign
_MAX_HEAVE_GAIN_IN_METRES = 10.0  # largest heave gain of a height in metres; a smaller unit gives a larger gain
_MAX_HEIGHT_NOISE_M = 0.2  # m; noise or resolution that no height sensor exceeds
_THRUST_TO_WEIGHT_RANGE = (0.2, 5.0)  # accepted mean thrust over weight before identification
_VOLTAGE_RATIO_RANGE = (0.4, 1.8)  # accepted ratio to the nominal battery voltage


@dataclass(frozen=True)
class InputGain:
    """Ratio of a measured acceleration to the model's prediction from an input: 1 if correct, -1 if inverted.

    Attributes
    ----------
    value, std : float
        Gain and standard deviation.
    cross_gain, cross_std : float
        Gain and standard deviation of the other servo or horizontal axis; 0 if there is none.
    sign : int
        1 or -1 if the record determines the sign, else 0; the sign of ``cross_gain`` if ``is_exchanged``.
    is_exchanged : bool
        Whether only ``cross_gain`` is significant.
    """

    value: float
    std: float
    cross_gain: float = 0.0
    cross_std: float = 0.0
    sign: int = 0
    is_exchanged: bool = False


def estimate_input_gains(vehicle: Vehicle, r: FlightRecord) -> tuple[dict[str, InputGain], float]:
    """Return the input gain of every channel, and the model's mean ratio of thrust to weight.

    Keys are ``heave``, ``yaw``, ``roll``, ``pitch``, ``north``, ``east``, as far as the record holds their signals.
    """
    problem = make_problem(
        vehicle, (), [r.select_outputs([o for o in r.output_names if o != "voltage"])], voltage="measured"
    )
    f, dt, has = problem.prepared_records[0], r.sample_s, set(r.output_names)
    p, thrust, torque = _simulate_rotors(f, dt)
    m = f.smoothed_motion

    found: dict[str, InputGain] = {}
    turn = body_to_ned_matrices(m[:, MOTION_EULER:MOTION_RATES])
    lagged = {"skip_s": _START_TRANSIENT_S, "longest_lag_s": _MAX_MOTION_LAG_S}

    def estimate_gain(rate: str, angle: str, *made: Array, sign: float = 1.0, **options: Any) -> InputGain:
        is_rate = rate in has
        seen = sign * r.measured[:, r.output_names.index(rate if is_rate else angle)]
        return _judge_gain(
            estimate_causal_gain(seen, np.column_stack(made), dt, is_rate=is_rate, **options), len(made) > 1
        )

    load = (thrust.sum(axis=1) - p["downwash_drag"]) / p["mass"]
    if has & {"height", "climb"}:
        found["heave"] = estimate_gain("climb", "height", load * turn[:, 2, 2], **lagged)
    if has & {"yaw", "r"}:
        found["yaw"] = estimate_gain("r", "yaw", (torque[:, 0] - torque[:, 1]) / p["Izz"], **lagged)
        if found["yaw"].sign == 0:  # unequal rotors: exchanged motors differ from an inverted sign
            _, _, other = _simulate_rotors(dataclasses_replace(f, inputs=f.inputs[:, SWAPPED_MOTOR_INPUT_INDICES]), dt)
            if estimate_gain("r", "yaw", (other[:, 0] - other[:, 1]) / p["Izz"], **lagged).sign == 1:
                found["yaw"] = dataclasses_replace(found["yaw"], sign=-1)
    tilt = tip_path_tilt_target.py_func(
        *np.clip(f.inputs[:, SERVO_INPUT_SLICE], -1.0, 1.0).T, p["swash_gain"], p["swash_phase"]
    )
    arm = -p["z_dw"] * thrust[:, 1, None] * np.sin(np.column_stack((-tilt[1], tilt[0])))
    bar = np.einsum("nji,nj->ni", turn, _simulate_bar_normal(f.mast_direction, -np.expm1(-dt * p["bar_rate"])))
    lean = -p["z_up"] * p["bar_gain"] * thrust[:, :1] * bar[:, :2]
    if has & {"roll", "p"}:
        made = arm / p["Ixx"]
        found["roll"] = estimate_gain("p", "roll", made[:, 1], made[:, 0], beside=lean[:, 1:], **lagged)
    if has & {"pitch", "q"}:
        made = -arm / p["Iyy"]
        found["pitch"] = estimate_gain("q", "pitch", made[:, 0], made[:, 1], beside=lean[:, :1], **lagged)
    if {"roll", "pitch", "yaw"} <= has:
        pull = -turn[:, :2, 2] * GRAVITY
        for k, axis in enumerate(("north", "east")):
            if has & {axis, f"v_{axis}"}:
                found[axis] = estimate_gain(f"v_{axis}", axis, pull[:, k], pull[:, 1 - k], skip_s=_START_TRANSIENT_S)
    settled = min(round(_START_TRANSIENT_S / dt), len(m) // 2)
    return found, float(thrust[settled:].sum(axis=1).mean() / (p["mass"] * GRAVITY))


def _simulate_rotors(f: PreparedRecord, dt: float) -> tuple[np.void, Array, Array]:
    """Return the model parameters, and thrust (N) and torque on the body (N m) of the rotors, each (n, 2)."""
    p = parameters_at_theta(f.base_parameters, f.parameter_changes, np.zeros((1, 0)))
    starts = np.arange(0, len(f.inputs), max(1, round(0.5 / dt)))  # restarts limit the body motion
    x = np.zeros((1, STATE_SIZE))
    x[:, MODEL_ATTITUDE], x[:, MODEL_BAR_NORMAL + 2] = 1.0, -1.0
    first = f.inputs[: max(1, round(0.3 / dt)), MOTOR_INPUT_SLICE].mean(axis=0)
    x[:, ROTOR_SPEED_SLICE] = steady_rotor_speeds(p, np.clip(first, 0.0, 1.0), f.first_and_mean_voltage[0])
    codes = np.array([FLIGHT_OUTPUTS.index("speed_up"), FLIGHT_OUTPUTS.index("speed_dw")], dtype=np.int64)
    speed = simulate_batch(
        x,
        p,
        f.inputs,
        sample_s=dt,
        codes=codes,
        starts=starts,
        motion=f.smoothed_motion[starts][None],
        mast=f.mast_direction,
    )[0]
    one = p[0]
    thrust = np.array([one["thrust_up"], one["thrust_dw"]]) * speed**2
    react = np.array([one["Jreact_up"], one["Jreact_dw"]]) * np.gradient(speed, dt, axis=0)
    return one, thrust, np.array([one["torque_up"], one["torque_dw"]]) * speed**2 + react


def _simulate_bar_normal(mast: Array, follow: float) -> Array:
    """Return the bar's normal (n, 3), which follows the mast with a first-order lag of gain ``follow`` per sample."""
    bar = mast.copy()
    for k in range(1, len(mast)):
        bar[k] = bar[k - 1] + follow * (0.5 * (mast[k - 1] + mast[k]) - bar[k - 1])
    return bar


def _judge_gain(found: CausalGain | None, is_crossed: bool) -> InputGain:
    """Return the gain of an input; its sign is 0 unless the record determines it.

    The leading gain must be significant, large enough, and far likelier than one of the other sign.
    """
    if found is None:
        return InputGain(0.0, np.inf)
    g, std, lead = found.value, found.std, found.lead_samples
    sure = (
        abs(g[lead]) > max(_MIN_ABSOLUTE_INPUT_GAIN, _MIN_GAIN_SIGMAS * std[lead])
        and found.sign_log_likelihood_ratio > _MIN_SIGN_LOG_LIKELIHOOD_RATIO
    )
    # The other servo counts only if the own servo has little effect in comparison.
    sure = bool(sure and (lead == 0 or abs(g[0]) < 0.4 * abs(g[1])))
    side = (1 if g[lead] > 0.0 else -1) if sure else 0
    cross = (float(g[1]), float(std[1])) if is_crossed else (0.0, 0.0)
    return InputGain(float(g[0]), float(std[0]), *cross, side, sure and lead == 1)


def check_flight_records(
    records: Sequence[FlightRecord], vehicle: Vehicle, *, as_is: bool = False, uses_voltage: bool = True
) -> tuple[str, ...]:
    """Check records for faults that would cause wrong parameters in a fit of this vehicle.

    All records count as output of one logger: signs and axes found in one record help to name faults of the others.

    Parameters
    ----------
    records : sequence of FlightRecord
    vehicle : Vehicle
        Vehicle with start values; only order of magnitude and sign of its parameters need be correct.
    as_is : bool
        Report faults as warnings, and reject only a record in which no input moves.
    uses_voltage : bool
        Whether the fit uses the recorded voltage; otherwise an implausible voltage gives a warning.

    Returns
    -------
    tuple of str
        Warnings.

    Raises
    ------
    InputError
        As :func:`mufly.identify.require_consistent_record`; and for a wrong unit of the voltage, inverted or exchanged
        inputs, axes that are not forward, right, down, or a wrong unit or sign of the height.
    """
    warnings: list[str] = []
    seen: list[tuple[FlightRecord, dict[str, InputGain], float]] = []
    for r in records:
        warnings += require_consistent_record(r, as_is=as_is)
        volts = _check_voltage_unit(r, vehicle)
        if volts and not uses_voltage:
            warnings.append(f"{r.name}: voltage {volts[0].problem}. The fit does not use it.")
            r, volts = dataclasses_replace(r, voltage=None), []
        warnings += refuse_fatal_faults(r, volts, as_is=as_is)
        if stopped := r.describe_stopped_motors():
            warnings.append(f"{r.name}: {stopped}. The model has no floor: fit the flight alone, with --from and --to.")
        if not volts and not (as_is and any(f.is_fatal for f in find_signal_faults(r))):
            seen.append((r, *estimate_input_gains(vehicle, r)))
    told: dict[str, InputGain] = {}
    for _, found, _ in seen:
        for axis, g in found.items():
            if g.sign and (axis not in told or g.std < told[axis].std):
                told[axis] = g
    for r, found, load in seen:
        wrong = list(find_gain_faults(r, found, load))
        if any(f.is_fatal for f in wrong):
            wrong = list(find_gain_faults(r, {**found, **{k: g for k, g in told.items() if k != "heave"}}, load))
        warnings += refuse_fatal_faults(r, sorted(wrong, key=lambda f: not f.is_fatal), as_is=as_is)
    return tuple(warnings)


def _check_voltage_unit(r: FlightRecord, vehicle: Vehicle) -> list[SignalFault]:
    if r.voltage is None:
        return []
    volts, nominal = float(np.median(r.voltage)), float(vehicle.battery.nominal_voltage)
    if _VOLTAGE_RATIO_RANGE[0] < volts / nominal < _VOLTAGE_RATIO_RANGE[1]:
        return []
    units = (("millivolts", 1e3, "mV"), ("centivolts", 1e2, "cV"), ("decivolts", 10.0, "dV"))
    for words, size, _ in units:
        if _VOLTAGE_RATIO_RANGE[0] < volts / nominal / size < _VOLTAGE_RATIO_RANGE[1]:
            what = f"reads {volts:.4g} where the vehicle's battery has {nominal:g} V: it seems to be in {words}"
            return [SignalFault("voltage", what, f"scale it by {1.0 / size:g} in the column map")]
    what = f"reads {volts:.3g} V where the vehicle's battery has {nominal:g} V: another or a simulated battery"
    remedy = "state the voltage with --voltage (nominal or a number), or set the battery in the vehicle file"
    return [SignalFault("voltage", what, remedy)]


def find_gain_faults(r: FlightRecord, found: dict[str, InputGain], load: float) -> Iterator[SignalFault]:
    """Yield the faults of a record that its input gains and its mean ratio of thrust to weight (``load``) show."""
    if not _THRUST_TO_WEIGHT_RANGE[0] < load < _THRUST_TO_WEIGHT_RANGE[1]:
        yield SignalFault(
            "motor_upper, motor_lower",
            f"lift {load:.2g} times the weight on average, as the vehicle's numbers and the voltage have it",
            "check their scale (0 to 1 of full), the voltage, and the vehicle's mass and thrust coefficients",
        )
    yield from _check_height_sign_and_unit(r, found.get("heave"))
    sign = {k: g.sign for k, g in found.items() if not g.is_exchanged}
    servos = [found[k] for k in ("roll", "pitch") if k in found and found[k].is_exchanged]
    if servos:
        turned = " and turned round" if any(g.sign < 0 for g in servos) else ""
        yield SignalFault(
            "servo_1, servo_2",
            f"act on each other's axis ({_describe_gains(found)}): they are exchanged{turned}, or roll and pitch are",
            "exchange them in the column map",
        )
    ground = [found[k] for k in ("north", "east") if k in found and found[k].is_exchanged]
    if ground:
        yield SignalFault(
            "north, east", "follow each other's tilt: they are exchanged, or yaw counts from another axis (ENU)",
            "give north first, and yaw from north, clockwise from above",
        )  # fmt: skip
    if sign.get("pitch") == -1 and sign.get("yaw") == -1:
        yield SignalFault(
            "pitch, q, yaw, r",
            "respond to servo_1 and the motors with the wrong sign: the record's axes seem to be forward, left, up",
            "invert the signs of these four in the column map (or that of servo_1, and exchange the motors)",
        )
        return
    tilts = {"roll": sign.get("east", 0), "pitch": sign.get("north", 0)}
    for axis, servo, rate in (("roll", "servo_2", "p"), ("pitch", "servo_1", "q")):
        if sign.get(axis) != -1:
            continue
        # The horizontal acceleration shows whether the angle or the servo is inverted.
        which = {1: servo, -1: f"{axis}, {rate}", 0: servo}[tilts[axis]]
        other = f" (or {axis} and {rate} are)" if tilts[axis] == 0 else ""
        goes = {"servo_2": "to the right", "servo_1": "nose down"}[servo]
        yield SignalFault(
            which, f"inverted{other}: positive {servo} should accelerate {goes} ({_describe_gains(found)})",
            "invert its sign in the column map",
        )  # fmt: skip
    if sign.get("yaw") == -1:
        yield SignalFault(
            "motor_upper, motor_lower",
            "exchanged (or yaw and r count anticlockwise): a higher upper input should turn the nose "
            f"right ({_describe_gains(found)})",
            "exchange them in the column map",
        )
    for axis in ("north", "east"):
        if sign.get(axis) == -1:
            yield SignalFault(
                axis, f"accelerates against the tilt ({_describe_gains(found)}): its sign is inverted",
                "invert its sign in the column map",
            )  # fmt: skip


def _describe_gains(found: dict[str, InputGain]) -> str:
    told = [
        (k, g.cross_gain, g.cross_std) if g.is_exchanged else (k, g.value, g.std) for k, g in found.items() if g.sign
    ]
    return "gains over the model's: " + ", ".join(f"{k} {v:.2g} +- {s:.1g}" for k, v, s in told)


def _check_height_sign_and_unit(r: FlightRecord, heave: InputGain | None) -> list[SignalFault]:
    """Check sign and unit of the height by its response to thrust, or by its resolution if the response is small."""
    if heave is None:
        return []
    if heave.sign == -1:
        return [
            SignalFault(
                "height", f"falls where thrust rises (gain {heave.value:.2g} +- {heave.std:.1g} of the model's): "
                "the vertical axis points up in this log, or the motors' inputs are inverted",
                "invert its sign in the column map: position is north, east, down",
            )
        ]  # fmt: skip
    low, high = heave.value - 3.0 * heave.std, heave.value + 3.0 * heave.std
    unit = "millimetres" if heave.value > 300.0 else "centimetres"
    if low > _MAX_HEAVE_GAIN_IN_METRES:
        what = f"accelerates {heave.value:.3g} +- {heave.std:.2g} times as much as thrust makes it"
        return [
            SignalFault(
                "height", f"{what}: it seems to be in {unit}", "state the unit in the column map ('cm' or 'mm')"
            )
        ]
    if "height" not in r.output_names:
        return []
    k = r.output_names.index("height")
    y = r.measured[np.isfinite(r.measured[:, k]), k]
    steps = np.abs(np.diff(y))
    resolution = float(steps[steps > 0.0].min(initial=np.inf))
    noise = float(estimate_noise_from_differences(r)[k])
    coarse = noise if noise > _MAX_HEIGHT_NOISE_M else resolution if np.isfinite(resolution) else 0.0
    if coarse > _MAX_HEIGHT_NOISE_M:
        what = f"is resolved to {coarse:.2g} m only: it seems to be in centimetres or millimetres"
        return [SignalFault("height", what, "state the unit in the column map ('cm' or 'mm')")]
    if high < _MAX_HEAVE_GAIN_IN_METRES and heave.value > 0.1:
        return []
    size = f"{heave.value:.2g} +- {heave.std:.2g} of the model's"
    what = f"responds too little to thrust to distinguish metres from centimetres ({size})"
    return [SignalFault("height", f"{what}: its unit is not checked", "", is_fatal=False)]
