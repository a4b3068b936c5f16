"""``mufly drive``: a drive train's operating points with a rotor, its best gear, and its endurance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mufly.cli.options import (
    CHARGE_RANGE,
    DUTY_RANGE,
    GEAR_RATIO_RANGE,
    PITCH_RANGE,
    THRUST_RANGE,
    CommandGroup,
    JsonOption,
    ModelOption,
    default_text,
    define_argument,
    define_option,
)
from mufly.cli.output import (
    make_console,
    print_answer,
    print_json,
    print_lines,
    print_result_table,
    save_figure,
)
from mufly.results import ResultColumn, select_fields

if TYPE_CHECKING:
    from mufly.drive import RotorLoad

app = CommandGroup(
    help=(
        "Compute drive trains: motor, gear, battery, and their operating points with a rotor; see "
        "docs/explanation/drive.md."
    ),
    no_args_is_help=True,
)

_DriveFileArgument = Annotated[
    str,
    define_argument("NAME|FILE", "Drive train: 'mufly', a built-in vehicle, a drive file or a vehicle file (TOML)."),
]
_RotorOption = Annotated[
    str,
    define_option(
        "--rotor NAME|FILE",
        "Rotor: a name or file, or 'upper' or 'lower': that rotor of --vehicle, by its constant coefficients.",
    ),
]
_VehicleOption = Annotated[str, define_option("--vehicle NAME|FILE", "Vehicle that 'upper' and 'lower' refer to.")]
_PitchOption = Annotated[
    float | None,
    define_option("--pitch", "Pitch setting of a rotor file, as 12.", unit="deg", within=PITCH_RANGE),
]
_VoltageOption = Annotated[
    float | None, define_option("--voltage", "Supply voltage. Default: the battery's nominal voltage.", unit="V")
]
_POINT_COLUMNS = (
    ResultColumn("thrust_N", form=".3f"),
    ResultColumn("speed_rad_s", "rpm", ".0f", "rotor speed"),
    ResultColumn("duty", form=".3f"),
    ResultColumn("input_power_W", form=".2f"),
    ResultColumn("mechanical_power_W", form=".2f", head="rotor power"),
    ResultColumn("efficiency", "%", ".1f"),
    ResultColumn("thrust_per_power_N_W", form=".4f"),
    ResultColumn("motor_current_A", form=".2f"),
)


def _make_rotor_load(rotor: str, vehicle: str, pitch: float | None, model: str) -> tuple[RotorLoad, str]:
    """Make the load of a drive from the rotor options; return it, and its name."""
    from mufly.drive import make_blade_load, make_coefficient_load
    from mufly.errors import InputError
    from mufly.rotor import load_rotor, prepare_blading
    from mufly.study import BEMT_MODELS
    from mufly.vehicle import load_vehicle

    if rotor in ("upper", "lower"):
        if pitch is not None:
            raise InputError("--pitch", "", f"the {rotor} rotor of a vehicle has none", "leave it out")
        v = load_vehicle(vehicle)
        one = v.rotors.upper if rotor == "upper" else v.rotors.lower
        load = make_coefficient_load(
            float(one.thrust_coefficient), float(one.torque_coefficient), radius_m=float(v.rotors.radius),
            density_kg_m3=float(v.air.density),
        )  # fmt: skip
        return load, f"{rotor} rotor of {v.name}"
    if pitch is None:
        raise InputError("--pitch", "", f"is missing for rotor {rotor}", "give the pitch setting, as --pitch 12")
    r = load_rotor(rotor)
    blading = prepare_blading(r, corrections=BEMT_MODELS[model])
    return make_blade_load(blading, pitch_rad=math.radians(pitch)), f"{r.name} at {pitch:g} deg"


@app.command()
def show(
    drive: _DriveFileArgument = "mufly",
    rotor: _RotorOption = "upper",
    vehicle: _VehicleOption = "mufly-1.1",
    pitch: _PitchOption = None,
    thrust: Annotated[
        list[float] | None,
        define_option("--thrust", "Thrust of one rotor. Repeat it for a table.", unit="N", within=THRUST_RANGE),
    ] = None,
    duty: Annotated[
        list[float] | None,
        define_option(
            "--duty",
            "Share of the supply voltage at the motor, 0.01 to 1, instead of a thrust. Repeat it for a table.",
            unit="1",
            within=DUTY_RANGE,
        ),
    ] = None,
    supply: _VoltageOption = None,
    charge: Annotated[
        float | None,
        define_option(
            "--charge",
            "Charge of the battery, 0 to 1, whose voltage sags under load, instead of --voltage.",
            unit="1",
            within=CHARGE_RANGE,
        ),
    ] = None,
    model: ModelOption = "full",
    as_json: JsonOption = False,
) -> None:
    """Show a drive's constants, its operating points with a rotor, and its hover endurance.

    All rotors of the drive are loaded alike. Without --thrust and --duty, five duties are shown.

    Examples: mufly drive show; mufly drive show mufly --rotor naca4412-r60-c20 --pitch 12 --thrust 0.3
    """
    import numpy as np

    from mufly.drive import find_operating_point, hover_endurance, load_drive
    from mufly.errors import InputError, MuflyError

    d = load_drive(drive)
    load, name = _make_rotor_load(rotor, vehicle, pitch, model)
    if thrust and duty:
        raise InputError("drive show", "", "both --thrust and --duty are given", "give one of the two")
    given: dict[str, Any] = {"thrust_N": thrust} if thrust else {"duty": duty or [0.2, 0.4, 0.6, 0.8, 1.0]}
    point = find_operating_point(d, load, supply_V=supply, charge=charge, **given)
    lasts: list[Any] = []
    for k in range(point.thrust_N.size):
        try:
            power, volts = d.rotors * float(point.input_power_W[k]), float(point.motor_voltage_V[k])
            lasts.append(hover_endurance(d.battery, power_W=power, motor_voltage_V=volts))
        except MuflyError:  # not even with a full battery: reported in the table
            lasts.append(None)
    c = d.motor_constants()
    if as_json:
        points = {k: np.atleast_1d(v) for k, v in vars(point).items()}
        more = {"constants": c, "rotor": name, "points": points, "endurance": lasts}
        return print_json({"drive": d.name, **select_fields(d, "description rotors"), **more})
    make_console().print(f"[bold]{d.name}[/bold]  {d.description}", highlight=False)
    print_lines(
        f"kE {1e3 * float(c.back_emf_V_s):.4g} mV s, kM {1e3 * float(c.torque_Nm_A):.4g} mN m/A, "
        f"R {float(c.resistance_ohm):.4g} ohm, dR {1e6 * float(c.friction_Nm_s):.4g} uN m s, "
        f"{f'Mf {1e3 * float(c.friction_Nm):.4g} mN m, ' if c.friction_Nm else ''}"
        f"gear {float(c.gear_ratio):g} with efficiency {float(c.gear_efficiency):.0%}; "
        f"{d.rotors} rotor{'s' if d.rotors > 1 else ''} on {float(d.battery.capacity) / 3.6:.0f} mA h"
    )
    rows = [
        {
            **{key: float(v[k]) for key, v in vars(point).items() if np.ndim(v)},
            "endurance* (min)": "-" if e is None else f"{e.time_s / 60:.1f}",
        }
        for k, e in enumerate(lasts)
    ]
    print_result_table(rows, [*_POINT_COLUMNS, "endurance* (min)"], title=name)
    print_lines(
        "* from a full battery, all rotors at this thrust, with electronics; -: beyond the battery's power",
        style="dim",
    )


@app.command()
def sweep(
    drive: _DriveFileArgument = "mufly",
    gear: Annotated[
        tuple[float, ...],
        define_option(
            "--gear",
            "Gear ratios (motor speed over rotor speed), as 1.5,2 or 0.5:8:0.1.",
            unit="1",
            form="values",
            within=GEAR_RATIO_RANGE,
        ),
    ] = default_text("0.5:8:0.1"),
    rotor: _RotorOption = "upper",
    vehicle: _VehicleOption = "mufly-1.1",
    pitch: _PitchOption = None,
    thrust: Annotated[
        float | None,
        define_option("--thrust", "Thrust for which to find the largest gear ratio.", unit="N", within=THRUST_RANGE),
    ] = None,
    duty: Annotated[
        float,
        define_option("--duty", "Share of the supply voltage at the motor, 0.01 to 1.", unit="1", within=DUTY_RANGE),
    ] = 1.0,
    supply: _VoltageOption = None,
    model: ModelOption = "full",
    out: Annotated[Path | None, define_option("--out DIR", "Folder for gear.nc, gear.csv and gear.png.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Compute power, thrust and efficiency over the gear ratio at constant motor voltage (dissertation, Fig. 3.7).

    Example: mufly drive sweep mufly --thrust 0.6 --out gears
    """
    from mufly.drive import find_gear_optima, load_drive, sweep_gear_ratio
    from mufly.study import draw_gear_curve, write_study_results

    d = load_drive(drive)
    load, name = _make_rotor_load(rotor, vehicle, pitch, model)
    curve = sweep_gear_ratio(d, load, gear, duty=duty, supply_V=supply)
    best = find_gear_optima(d, load, thrust_N=thrust, duty=duty, supply_V=supply)
    marks = {k.replace("_", " "): v for k, v in vars(best).items() if k != "for_required_thrust" or math.isfinite(v)}
    files = []
    if out is not None:
        picture = draw_gear_curve(curve, marks=marks, thrust_N=thrust, title=f"{d.name}, {name}")
        files = [*write_study_results(curve, out, "gear"), save_figure(picture, out, "gear")]

    def print_sweep() -> None:
        shown = [
            ResultColumn("gear_ratio", form=".2f"),
            *(c for c in _POINT_COLUMNS if c.name in curve.data_vars),
        ]
        rows = [
            {c.name: float(curve[c.name][k]) for c in shown}
            for k in range(0, curve.sizes["gear_ratio"], max(1, curve.sizes["gear_ratio"] // 16))
        ]
        at = f"{curve.attrs['motor_voltage_V']:.3g} V at the motor"
        print_result_table(rows, shown, title=f"{d.name}, {name}, {at}")
        greatest = ", ".join(f"{k} {v:.2f}" for k, v in marks.items() if k != "for required thrust")
        print_lines(f"Greatest at gear ratio: {greatest}")
        if thrust is not None:
            found = f"{best.for_required_thrust:.2f}" if math.isfinite(best.for_required_thrust) else "none"
            print_lines(f"Largest gear ratio that gives {thrust:g} N: {found}")

    print_answer(as_json, {**curve.to_dict(), "optima": best, "rotor": name}, print_sweep, files)
