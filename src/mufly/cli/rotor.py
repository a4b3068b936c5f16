"""``mufly rotor``: geometry, hover performance, fits and comparisons of rotors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from mufly.cli.aero.interval_options import DEFAULT_INTERVAL_OPTIONS, IntervalOptions
from mufly.cli.aero.rotor_theory_options import WakeOptions, show_wake_progress, write_wakes
from mufly.cli.options import (
    SPEED_RANGE,
    ClimbOption,
    CommandGroup,
    DensityOption,
    DriveOption,
    JsonOption,
    OptionalPitchOption,
    OptionalRpmOption,
    OptionRange,
    OutOption,
    RotorArgument,
    define_argument,
    define_option,
    load_drive_option,
)
from mufly.cli.output import (
    make_console,
    print_answer,
    print_files,
    print_json,
    print_result_table,
    print_table,
    save_figure,
    write_text_file,
)
from mufly.quantities.units import RPM, list_compatible_units
from mufly.results import ResultColumn, columns_to_rows, select_fields

MaterialOption = Annotated[
    str | None,
    define_option("--material NAME", "Material of elastic blades, as abs, in place of the file's."),
]

_PLATE_THICKNESS_RANGE_M = OptionRange(
    1e-5, 0.05, "m", "no blade of a small rotor has such a thickness; write 0.8 mm as 0.8mm"
)

PlateOption = Annotated[
    float | None,
    define_option(
        "--thickness",
        "Thickness of a plate on the camber line, as 0.8mm, in place of the file's.",
        unit="m",
        within=_PLATE_THICKNESS_RANGE_M,
    ),
]

_DIAMETER_RANGE = OptionRange(1e-3, 10.0, "m", "no small rotor has such a diameter; write 127 mm as 127mm")
_PITCH_RANGE = OptionRange(1e-3, 10.0, "m", "no propeller has such a pitch; write 3 inches as 3in")
_EDGE_THICKNESS_RANGE = OptionRange(0.0, 0.1, "m", "no trailing edge has such a thickness; write 0.3 mm as 0.3mm")


@dataclass(frozen=True)
class HoverOptions(WakeOptions):
    """Options of the methods for one rotor."""

    method: Annotated[
        Literal["bemt", "tubes", "wake", "cfd"],
        define_option(
            "--method NAME",
            "Method: 'bemt' (blade elements), 'tubes' (vortex tubes), 'wake' (vortex wake, seconds) or "
            "'cfd' (OpenFOAM, minutes).",
        ),
    ] = "bemt"


DEFAULT_HOVER_OPTIONS = HoverOptions()
app = CommandGroup(
    help=(
        "Show, compute, fit, rank and optimise rotors. Rotor files and polars: docs/explanation/polars.md; blade "
        "element theory: docs/explanation/bemt.md; forward flight: "
        "docs/explanation/forward-flight.md; sweeps and rankings: docs/explanation/studies.md."
    ),
    no_args_is_help=True,
)


@app.command("list")
def list_rotors(as_json: JsonOption = False) -> None:
    """List the built-in rotors."""
    from mufly.rotor import list_builtin_rotors, load_rotor

    rotors = [load_rotor(name) for name in list_builtin_rotors()]
    if as_json:
        return print_json([select_fields(r, f"name description {_GEOMETRY_FIELDS}") for r in rotors])
    print_table(
        ("name", "blades", "radius", "solidity", "description"),
        [(r.name, f"{r.blades}", f"{1e3 * r.radius_m:g} mm", f"{r.solidity:.3f}", r.description) for r in rotors],
        text=(0, 4),
    )


_GEOMETRY_FIELDS = "blades radius_m hub_radius_m disc_area_m2 blade_area_m2 solidity thrust_solidity aspect_ratio"


@app.command()
def show(
    rotor: RotorArgument = "naca4412-r60-c20",
    rpm: Annotated[
        float, define_option("--rpm", "Rotor speed for the Reynolds numbers.", unit="rpm", within=SPEED_RANGE)
    ] = 5000.0,
    out: OutOption = None,
    as_json: JsonOption = False,
    toml: Annotated[bool, define_option("--toml", "Print the whole file, as a start for a rotor of your own.")] = False,
) -> None:
    """Show a rotor's geometry: solidity, aspect ratio, thickness, Reynolds numbers.

    With --out, planform, twist and sections are drawn (blade.png).
    Example: mufly rotor show walkera-5g6 --rpm 4000 --out walkera
    """
    from mufly.rotor import draw_blade, format_rotor_toml, load_rotor, tabulate_blade_stations

    r = load_rotor(rotor)
    if toml:
        return print(format_rotor_toml(r), end="")
    stations = tabulate_blade_stations(r, rpm * RPM)
    picture = save_figure(draw_blade(r), out, "blade") if out is not None else None
    if as_json:
        about = select_fields(r, f"name description {_GEOMETRY_FIELDS} airfoils=airfoil_names")
        return print_json({**about, "speed_rpm": rpm, "stations": stations})
    c = make_console()
    c.print(f"[bold]{r.name}[/bold]  {r.description}", highlight=False)
    c.print(
        f"{r.blades} blades, R {1e3 * r.radius_m:g} mm, cut-out {1e3 * r.hub_radius_m:.3g} mm, solidity "
        f"{r.solidity:.3f}, aspect ratio {r.aspect_ratio:.2f}, airfoils {r.describe_sections()}",
        highlight=False,
    )
    columns = (
        ResultColumn("r_over_R", form=".3f", head="r/R"), ResultColumn("chord_m", "mm", ".2f"),
        ResultColumn("twist_rad", "deg", ".2f"), ResultColumn("thickness_m", "mm", ".2f"),
        ResultColumn("reynolds", form=".0f", head=f"Reynolds number at {rpm:g} rpm"),
    )  # fmt: skip
    print_result_table(columns_to_rows(stations), columns)
    c.print(
        "Sources of the values: "
        + ", ".join(
            f"{key} {q.source}"
            for key, q in (
                ("radius", r.radius), ("cut-out", r.hub_cutout), ("chord", r.blade.chord), ("twist", r.blade.twist),
            )
        ),
        style="dim",
    )  # fmt: skip
    if picture is not None:
        c.print(f"Picture: {picture}")


@app.command("import")
def import_blade(
    blade: Annotated[
        Path,
        define_argument(
            "FILE",
            "Blade file: APC's ...-PERF.PE0, UIUC's geometry (r/R c/R beta), a table with units in its "
            "header, an STL or a STEP file.",
        ),
    ],
    diameter: Annotated[
        float | None,
        define_option(
            "--diameter",
            "Diameter of the rotor, as 5in or 127mm; required where the file gives ratios.",
            unit="m",
            within=_DIAMETER_RANGE,
        ),
    ] = None,
    blades: Annotated[int | None, define_option("N", "Number of blades. Default: the file's.", min=1, max=20)] = None,
    airfoil: Annotated[str | None, define_option("NAME", "Airfoil of the whole blade. Default: the file's.")] = None,
    trailing_edge: Annotated[
        float | None,
        define_option(
            "--trailing-edge",
            "Thickness of the trailing edge, as 0.3mm. Default: the airfoils'.",
            unit="m",
            within=_EDGE_THICKNESS_RANGE,
        ),
    ] = None,
    geometry: Annotated[
        Literal["photograph", "maker", "caliper", "scan", "CAD"] | None,
        define_option(
            "--geometry NAME",
            "Source of the geometry: photograph, maker, caliper, scan or CAD. Default: maker for a PE0 file, "
            "photograph for UIUC's table, scan for a solid.",
        ),
    ] = None,
    nominal_pitch: Annotated[
        float | None,
        define_option(
            "--nominal-pitch",
            "Pitch that the maker states, as 3in. Default: that in the name of a UIUC table.",
            unit="m",
            within=_PITCH_RANGE,
        ),
    ] = None,
    unit: Annotated[
        str | None,
        define_option("NAME", "Length unit of an STL file: mm, m, cm or in. Default: mm."),
    ] = None,
    axis: Annotated[
        str | None,
        define_option(
            "--axis NAME",
            "Direction of the thrust in a solid's file: x, y, z, -x, -y or -z. Default: z, or -z if found.",
        ),
    ] = None,
    centre: Annotated[
        str | None,
        define_option(
            "--centre X,Y",
            "Point of the shaft in an STL file's unit, or mm, as 30,-12 or 30,-12,5. Default: the origin, or a whole "
            "rotor's axis of symmetry.",
        ),
    ] = None,
    name: Annotated[str | None, define_option("NAME", "Name of the rotor. Default: the file's.")] = None,
    out: Annotated[Path | None, define_option("--out FILE.toml", "Rotor file to write.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Convert a blade's table or solid to a rotor file, with notes on values that are guessed.

    A table has the columns r_mm, chord_mm, beta_deg; a solid has its shaft along z. Scans may be noisy, have gaps, or
    lie off the shaft or upside down. Notes state the changes.

    Examples:

      mufly rotor import da4002_5x3.75_geom.txt --diameter 5in --airfoil sda1075 --out da.toml

      mufly rotor import 10x7E-PERF.PE0 --out apc.toml

      mufly rotor import calipers.csv --blades 2

      mufly rotor import blade.stl --unit mm --out cut.toml
    """
    from mufly.errors import InputError
    from mufly.rotor import format_rotor_toml, import_rotor, replace_rotor

    if out is not None and out.suffix != ".toml":
        raise InputError("--out", str(out), "does not end in .toml", "give a name that ends in .toml")
    radius = None if diameter is None else 0.5 * diameter
    if unit is not None and (unit not in list_compatible_units("m") or blade.suffix.lower() != ".stl"):
        problem, remedy = f"{unit!r} is not a length", f"use one of: {', '.join(list_compatible_units('m'))}"
        if blade.suffix.lower() != ".stl":
            problem, remedy = "is of STL files", f"omit it: {blade.name} states its units"
        raise InputError("--unit", "", problem, remedy)
    if blade.suffix.lower() in (".stl", ".step", ".stp"):
        from mufly.rotor.blades.body_import import rotor_from_body

        if out is None:
            raise InputError(
                "--out", "", "is missing", "give --out: the sections of a solid are written beside this file"
            )
        try:
            point = None if centre is None else [float(v) for v in centre.split(",")]
        except ValueError:
            raise InputError("--centre", str(centre), "is no point", "give two or three numbers, as 30,-12") from None
        length_m = list_compatible_units("m")[unit or "mm"]
        r, notes = rotor_from_body(
            blade, folder=out.parent, blades=blades, name=name or out.stem, axis=axis,
            centre=None if point is None else [length_m * v for v in point],
            unit_m=None if unit is None else list_compatible_units("m")[unit],
        )  # fmt: skip
        stated = {} if nominal_pitch is None else {"nominal_pitch": nominal_pitch}
        r = replace_rotor(r, {"blade.geometry": geometry or "scan", **stated}, source="datasheet")
    else:
        r, notes = import_rotor(
            blade, radius_m=radius, blades=blades, airfoil=airfoil, name=name, geometry=geometry,
            nominal_pitch_m=nominal_pitch,
        )  # fmt: skip
    if trailing_edge is not None:
        r = replace_rotor(r, {"trailing_edge": trailing_edge}, source="measured")
    if out is not None:
        write_text_file(out, format_rotor_toml(r))
    if as_json:
        return print_json({**select_fields(r, f"name {_GEOMETRY_FIELDS} airfoils=airfoil_names"), "notes": notes})
    c = make_console()
    c.print(
        f"[bold]{r.name}[/bold]: {r.blades} blades, R {1e3 * r.radius_m:g} mm, {len(r.blade.chord.value)} stations, "
        f"solidity {r.solidity:.3f}, airfoils {r.describe_sections()}",
        highlight=False,
    )
    for note in notes:
        c.print(f"Note: {note}", style="yellow", highlight=False)
    if out is None:
        return c.print("Nothing written; add --out FILE.toml")
    print_files([out])


@app.command()
def hover(
    rotor: RotorArgument = "naca4412-r60-c20",
    pitch: OptionalPitchOption = None,
    rpm: OptionalRpmOption = None,
    thrust: Annotated[
        float | None,
        define_option("--thrust", "Thrust; with --pitch the speed is found, with --rpm the pitch.", unit="N"),
    ] = None,
    climb: ClimbOption = 0.0,
    density: DensityOption = 1.2,
    drive: DriveOption = None,
    theory: HoverOptions = DEFAULT_HOVER_OPTIONS,
    interval_options: IntervalOptions = DEFAULT_INTERVAL_OPTIONS,
    elastic: Annotated[
        bool, define_option("--elastic", "Let the blades twist and bend; print the rigid rotor beside them.")
    ] = False,
    material: MaterialOption = None,
    thickness: PlateOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute thrust, torque, power and figure of merit, and the loads along the blade.

    Give two of --pitch, --rpm and --thrust. With --drive, the electrical power at the same point is printed as well.
    With --out, the stations are drawn and written as CSV; with --method wake also wake and air velocity. A wake that
    does not converge ends the command with status 1; its history is written. --method cfd runs `mufly cfd run` with
    its defaults, which takes minutes and needs OpenFOAM. --elastic computes the blades as beams
    (docs/explanation/blade-structure.md), with a 90 % band for values that the rotor file leaves out.
    Examples: mufly rotor hover naca0012-r60-c20 --pitch 12 --rpm 5000; mufly rotor hover --pitch 12 --thrust 0.4
    --drive mufly; mufly rotor hover naca0012-r60-c20 --pitch 14 --rpm 6000 --method wake --out wake
    """
    from dataclasses import replace

    from mufly.errors import InputError, MuflyError
    from mufly.rotor import Air, OperatingCondition, draw_spanwise_loads, load_rotor
    from mufly.study import write_spanwise_loads
    from mufly.study.solved_points import solve_rotor_point

    found_point = pitch is None or rpm is None
    for conflict, key, value, problem, remedy in (
        (sum(v is not None for v in (pitch, rpm, thrust)) != 2, "rotor hover", "",
         "needs two of --pitch, --rpm and --thrust", "give two; the third is found"),
        (material is not None and not elastic, "--material", material, "applies to elastic blades only",
         "add --elastic"),
        (thickness is not None and not elastic, "--thickness", f"{1e3 * (thickness or 0.0):g} mm",
         "applies to elastic blades only", "add --elastic"),
        (elastic and found_point, "--elastic", "", "cannot solve for speed or pitch", "give --pitch and --rpm"),
        (elastic and (theory.method != "bemt" or interval_options.band is not None or drive is not None), "--elastic",
         "", "is for blade elements alone", "leave --method, --band and --drive out"),
        (theory.method == "cfd" and found_point, "--method", "cfd", "cannot solve for speed or pitch",
         "give --pitch and --rpm"),
        (interval_options.band is not None and theory.method == "cfd", "--band", "", "does not apply to CFD",
         "leave --method cfd or --band out"),
    ):  # fmt: skip
        if conflict:
            raise InputError(key, value or "", problem, remedy)
    if elastic and pitch is not None and rpm is not None:
        from mufly.cli.aero.elastic_hover import show_elastic_hover

        return show_elastic_hover(
            rotor, theory, pitch, rpm, climb=climb, density=density, material=material, thickness=thickness, out=out,
            as_json=as_json,
        )  # fmt: skip
    if theory.method == "cfd":
        from mufly.cli.aero.cfd import CaseOptions, solve_and_report_point

        case = CaseOptions(pitch=pitch or 0.0, density=density)
        return solve_and_report_point(
            rotor, case, rpm=rpm or 0.0, climb=climb, out=out or Path("case"), as_json=as_json
        )
    settings, count = theory.wake_settings_and_stations()
    r, air = load_rotor(rotor), Air(density_kg_m3=density)
    condition = OperatingCondition(
        None if pitch is None else math.radians(pitch), None if rpm is None else rpm * RPM, thrust, climb, air
    )
    with show_wake_progress("wake", theory.method == "wake" and not as_json, out) as progress:
        found = solve_rotor_point(
            theory.prepare_blading(r, count), condition, method=theory.method, model=theory.model, n_crit=theory.n_crit,
            settings=settings, drive=load_drive_option(drive), progress=progress,
        )  # fmt: skip
    files = write_wakes(found.solution, out) if found.solution.wakes and out is not None else []
    if not found.solution.converged:
        kept = "" if out is None else f"; its history is in {out}"
        raise MuflyError(f"wake: {found.solution.message}{kept}")
    found = replace(found, interval=interval_options.predict_interval(found.solution, theory))
    if out is not None:
        stations = save_figure(draw_spanwise_loads(found.loads), out, "stations")
        files = [stations, write_spanwise_loads(found.loads, out), *files]
    print_answer(as_json, found, files=files)
