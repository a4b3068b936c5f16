"""``mufly cfd``: meshes of rotors, OpenFOAM cases, their runs and results."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from mufly.cli.aero.cfd_case_report import report_case, report_climb_thrust, report_pair
from mufly.cli.options import (
    PITCH_RANGE,
    SPEED_RANGE,
    ClimbOption,
    CommandGroup,
    DensityOption,
    JsonOption,
    OutOption,
    PitchOption,
    RotorArgument,
    RpmOption,
    check_choice,
    default_text,
    define_argument,
    define_option,
)
from mufly.cli.output import (
    make_console,
    print_answer,
    print_result_table,
    print_table,
    save_figure,
    write_records,
)
from mufly.errors import InputError, convert_write_errors
from mufly.quantities.units import RPM
from mufly.results import ResultColumn, make_lines_block, select_fields

if TYPE_CHECKING:
    from mufly.cfd import SolverProgress

app = CommandGroup(
    help=(
        "Solve the flow of a rotor in hover or climb with OpenFOAM; assumptions and validation: "
        "docs/explanation/cfd.md."
    ),
    no_args_is_help=True,
)

MeshOption = Annotated[
    Literal["tiny", "coarse", "medium", "fine"],
    define_option(
        "--mesh LEVEL", "Mesh: 'coarse', 'medium' or 'fine' with 61, 136 or 376 thousand cells; 'tiny' for trials."
    ),
]
CoresOption = Annotated[int, define_option("N", "Number of solver processes.", min=1, max=256)]


@dataclass(frozen=True)
class BladeOptions:
    """Options of a blade and its mesh."""

    pitch: PitchOption = 12.0
    level: MeshOption = "medium"
    tip: Annotated[
        str,
        define_option(
            "--tip NAME", "Tip of the blades: 'square', 'round', 'swept', 'winglet-up', ... (docs/explanation/cfd.md)."
        ),
    ] = "square"
    hub: Annotated[
        float,
        define_option(
            "--hub", "Radius of a hub with grips; 0: no hub, which may make the flow unsteady.", unit="mm", min=0.0
        ),
    ] = 0.0
    gurney: Annotated[
        float,
        define_option("--gurney", "Height of a Gurney flap, relative to the chord.", unit="%", min=0.0),
    ] = 0.0

    def check_tip(self) -> None:
        """Raise InputError if the tip is unknown."""
        from mufly.cfd import BLADE_TIPS

        check_choice("--tip", self.tip, BLADE_TIPS)


@dataclass(frozen=True)
class CaseOptions(BladeOptions):
    """Options of one rotor's CFD cases, and the number of parallel solver processes."""

    density: DensityOption = 1.2
    model: Annotated[
        Literal["laminar", "k-epsilon", "sst", "k-omega"],
        define_option("--model NAME", "Turbulence model: 'laminar', 'k-epsilon', 'sst' or 'k-omega'."),
    ] = "laminar"
    cores: CoresOption = 1

    def to_library_arguments(self) -> dict[str, Any]:
        """Return the options as the library's arguments; InputError for an unknown tip."""
        from mufly.rotor import Air

        self.check_tip()
        return {
            "pitch_rad": math.radians(self.pitch), "air": Air(density_kg_m3=self.density), "model": self.model,
            "level": self.level, "tip": self.tip, "hub_m": 1e-3 * self.hub, "gurney": 0.01 * self.gurney,
            "cores": self.cores,
        }  # fmt: skip


BLADE_DEFAULTS, CASE_DEFAULTS = BladeOptions(), CaseOptions()
DEFAULT_SPEEDS_RPM = (5000.0, 6000.0, 7000.0)


@app.command()
def mesh(
    rotor: RotorArgument = "naca0012-r60-c20",
    blade: BladeOptions = BLADE_DEFAULTS,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Mesh a rotor's sector and report the quality of the mesh.

    With --out, OpenFOAM's constant/polyMesh and a picture are written there.
    Example: mufly cfd mesh naca0012-r60-c20 --pitch 12 --out case
    """
    from mufly import cfd
    from mufly.rotor import load_rotor

    blade.check_tip()
    form = cfd.make_tip_hub_geometry(blade.tip, 1e-3 * blade.hub, 0.01 * blade.gurney)
    sector = cfd.make_sector_mesh(load_rotor(rotor), math.radians(blade.pitch), level=blade.level, form=form)
    found = cfd.make_poly_mesh(sector)
    good, files = cfd.measure_mesh_quality(found), []
    if out is not None:
        with convert_write_errors("--out", key=str(out)):
            files.append(cfd.write_poly_mesh(found, out))
        files.append(save_figure(cfd.draw_mesh(found), out, "mesh"))

    title = make_lines_block("", head=f"{rotor}, {blade.level} mesh")
    content = {"rotor": rotor, "level": blade.level, "good": good.is_good, "quality": good}
    print_answer(as_json, content, (title, *good.make_printed_blocks()), files)


@app.command()
def run(
    rotor: RotorArgument = "naca0012-r60-c20",
    rpm: RpmOption = 5000.0,
    climb: ClimbOption = 0.0,
    case: CaseOptions = CASE_DEFAULTS,
    gap: Annotated[
        float,
        define_option("--gap", "Distance of a second rotor below the first; 0: no second rotor.", unit="mm", min=0.0),
    ] = 0.0,
    frozen: Annotated[
        bool, define_option("--frozen", "Solve both rotors in one mesh, with the blades fixed above each other.")
    ] = False,
    lower_pitch: Annotated[
        float | None,
        define_option(
            "--lower-pitch",
            "Pitch setting of the second rotor. Default: the first rotor's.",
            unit="deg",
            within=PITCH_RANGE,
        ),
    ] = None,
    lower_rpm: Annotated[
        float | None,
        define_option(
            "--lower-rpm",
            "Speed of the second rotor, in the opposite direction. Default: the first rotor's.",
            unit="rpm",
            within=SPEED_RANGE,
        ),
    ] = None,
    start: Annotated[
        Path | None,
        define_option("--start DIR", "Case whose solution is the start; it may differ in speed, pitch or tip."),
    ] = None,
    out: Annotated[Path, define_option("--out DIR", "Folder of the case; a stopped run resumes there.")] = Path("case"),
    save_only: Annotated[bool, define_option("--save-only", "Write the case without running it.")] = False,
    elastic: Annotated[
        bool, define_option("--elastic", "Let the blades twist under their loads, in rounds until the twist converges.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Solve one operating point: mesh, run, convergence, loads along the blade, pictures.

    The same command resumes a stopped run. The case is a plain OpenFOAM case: its Allrun runs it without mufly.
    With --gap a second rotor turns the other way below. The solver alternates between the rotors; each is an actuator
    disc with mean loads in the other's case. A solution that does not settle ends with status 1. With --elastic the
    folder holds one case for each round of solver and beam (docs/explanation/blade-structure.md).
    Example: mufly cfd run naca0012-r60-c20 --pitch 12 --rpm 5000 --mesh coarse --out case
    """
    by_turns = gap > 0.0 and not frozen
    if elastic:
        if gap > 0.0 or save_only or start is not None:
            raise InputError(
                "--elastic", "", "needs a single rotor, run from its own start", "leave --gap, --save-only, --start out"
            )
        return solve_and_report_elastic_point(rotor, case, rpm=rpm, climb=climb, out=out, as_json=as_json)
    if by_turns and save_only:
        raise InputError("--gap", f"{gap:g}", "needs two running cases", "add --frozen, or leave --save-only out")
    second = {
        "gap_m": 1e-3 * gap,
        "lower_pitch_rad": None if lower_pitch is None else math.radians(lower_pitch),
        "lower_speed_rad_s": None if lower_rpm is None else lower_rpm * RPM,
    }
    solve_and_report_point(
        rotor, case, rpm=rpm, climb=climb, pair=second, by_turns=by_turns, neighbour=start, out=out,
        save_only=save_only, as_json=as_json,
    )  # fmt: skip


def solve_and_report_point(
    rotor: str, case: CaseOptions, *, rpm: float, climb: float, out: Path, as_json: bool,
    pair: Mapping[str, float | None] = MappingProxyType({}), by_turns: bool = False, neighbour: Path | None = None,
    save_only: bool = False,
) -> None:  # fmt: skip
    """Solve and report one operating point; ``pair`` describes a second rotor, and ``by_turns`` solves both rotors
    alternately instead of in one mesh.

    Raises
    ------
    typer.Exit
        With status 1 if the answer did not settle.
    """
    from mufly import cfd
    from mufly.rotor import load_rotor

    r = load_rotor(rotor)
    given = {
        **case.to_library_arguments(),
        "speed_rad_s": rpm * RPM,
        "climb_m_s": climb,
        "neighbour": neighbour,
        **pair,
    }
    if not save_only:
        cfd.find_solver()
    if by_turns:
        with _show_solver_progress(not as_json) as tell:
            solved = cfd.solve_rotor_pair(out, r, progress=tell, **given)
        raise typer.Exit(int(not report_pair(out, r, solved, as_json)))
    good = cfd.mesh_and_write_case(out, r, **given)
    if save_only:
        print_answer(as_json, {"quality": good}, lambda: None, [out])
        return
    with _show_solver_progress(not as_json) as tell:
        cfd.run_case(out, cores=case.cores, progress=tell)
    if not report_case(out, r, as_json):
        raise typer.Exit(1)


def solve_and_report_elastic_point(
    rotor: str, case: CaseOptions, *, rpm: float, climb: float, out: Path, as_json: bool
) -> None:
    """Solve and report one operating point of a rotor with elastic blades.

    Raises
    ------
    typer.Exit
        With status 1 if the answer did not settle.
    """
    from mufly import cfd
    from mufly.rotor import load_rotor
    from mufly.rotor.structure.flap_modes import blade_structure

    r = load_rotor(rotor)
    blade_structure(r)
    given = {**case.to_library_arguments(), "speed_rad_s": rpm * RPM, "climb_m_s": climb}
    cfd.find_solver()
    with _show_solver_progress(not as_json) as tell:
        _, rounds = cfd.solve_elastic_blade(out, r, progress=tell, **given)
    last = out / f"round-{rounds.tip_twist_by_round_rad.size - 1}"
    if not report_case(last, r, as_json, rounds):
        raise typer.Exit(1)


@contextmanager
def _show_solver_progress(shown: bool) -> Iterator[Callable[[SolverProgress], None] | None]:
    """Report the progress of the solver on standard error."""
    if not shown:
        yield None
        return
    with make_console(stderr=True).status("solver starts") as status:

        def show_progress(p: SolverProgress) -> None:
            worst = max(p.residuals.values(), default=math.nan)
            status.update(
                f"iteration {p.iteration}: thrust {p.thrust_N:.4g} N, torque {1e3 * p.torque_Nm:.4g} mN m, residual "
                f"{worst:.1e}, {p.seconds_left:.0f} s left of this stretch"
            )

        yield show_progress


@app.command()
def sweep(
    rotor: RotorArgument = "naca0012-r60-c20",
    rpm: Annotated[
        tuple[float, ...],
        define_option("--rpm", "Rotor speeds, best from low to high.", unit="rpm", form="values", within=SPEED_RANGE),
    ] = default_text("5000,6000,7000"),
    case: CaseOptions = CASE_DEFAULTS,
    climb: Annotated[
        tuple[float, ...] | None,
        define_option(
            "--climb",
            "Climb velocities at the first speed, instead of several speeds, as -0.5,0,0.5; negative is descent.",
            unit="m/s",
            form="values",
        ),
    ] = None,
    out: Annotated[
        Path, define_option("--out DIR", "Folder with a folder for each point; solved points are kept.")
    ] = Path("sweep"),
    as_json: JsonOption = False,
) -> None:
    """Solve several speeds, each from the scaled solution of the one before, or several climb velocities.

    With --climb one speed is solved at each climb, from its own start, and the thrust over the climb is drawn beside
    blade elements, wake and the flight model's coefficient map. `mufly cfd show sweep` repeats this report.
    Example: mufly cfd sweep naca0012-r60-c20 --pitch 12 --rpm 5000,6000,7000 --mesh coarse --out sweep
    Example: mufly cfd sweep naca0012-r60-c20 --pitch 12 --rpm 5000 --climb -1,0,1 --mesh coarse --out climbs
    """
    from mufly import cfd
    from mufly.rotor import load_rotor

    given = case.to_library_arguments()
    speeds = [value * RPM for value in rpm]
    if climb is not None and len(speeds) > 1 and rpm != DEFAULT_SPEEDS_RPM:
        raise InputError("--climb", "", f"needs one speed, and --rpm has {len(rpm)}", "give one speed")
    cfd.find_solver()
    r = load_rotor(rotor)
    with _show_solver_progress(not as_json) as tell:
        if climb is not None:
            found = cfd.sweep_climb(out, r, list(climb), speed_rad_s=speeds[0], progress=tell, **given)
            report_climb_thrust(out, r, found, as_json)
            return
        found = cfd.sweep_speed(out, r, speeds, progress=tell, **given)
    names = "thrust_N=verdict.thrust_N torque_Nm=verdict.torque_Nm c_T c_Q figure_of_merit verdict=verdict.outcome"
    rows = [{"rpm": s.point.speed_rad_s / RPM, **select_fields(s, names)} for s in found]
    files = [write_records(out / "sweep.csv", rows)]
    print_answer(as_json, {"points": rows}, lambda: print_result_table(rows, list(rows[0])), files)


@app.command()
def study(
    what: Annotated[str, define_argument("mesh|domain|model", "Quantity to vary: mesh, domain or model.")],
    rotor: RotorArgument = "naca0012-r60-c20",
    pitch: PitchOption = 12.0,
    rpm: RpmOption = 5000.0,
    density: DensityOption = 1.2,
    level: MeshOption = "coarse",
    cores: CoresOption = 1,
    out: Annotated[
        Path, define_option("--out DIR", "Folder with a folder for each case; solved cases are kept.")
    ] = Path("study"),
    as_json: JsonOption = False,
) -> None:
    """Vary the mesh, the size of the domain (1.5 times) or the turbulence model at one operating point.

    Example: mufly cfd study domain naca0012-r60-c20 --pitch 12 --rpm 5000 --mesh coarse --out study
    """
    from mufly import cfd
    from mufly.rotor import Air, load_rotor

    cfd.list_study_cases(what)
    cfd.find_solver()
    with _show_solver_progress(not as_json) as tell:
        found = cfd.solve_study(
            out, load_rotor(rotor), what, cores=cores, progress=tell, pitch_rad=math.radians(pitch),
            speed_rad_s=rpm * RPM, air=Air(density_kg_m3=density), level=level,
        )  # fmt: skip
    first = next(iter(found.values())).verdict
    rows = [
        {
            "case": name, "thrust_N": s.verdict.thrust_N, "thrust_change": s.verdict.thrust_N / first.thrust_N - 1.0,
            "torque_Nm": s.verdict.torque_Nm, "torque_change": s.verdict.torque_Nm / first.torque_Nm - 1.0,
            "wake_torque_ratio": s.wake_torque_ratio, "max_eddy_viscosity_ratio": s.max_eddy_viscosity_ratio,
            "verdict": s.verdict.outcome,
        }
        for name, s in found.items()
    ]  # fmt: skip
    columns: list[ResultColumn | str] = [
        "case", ResultColumn("thrust_N", form=".4f"), ResultColumn("thrust_change", form="+.1%"),
        ResultColumn("torque_Nm", "mN m", ".4f"), ResultColumn("torque_change", form="+.1%"),
        ResultColumn("wake_torque_ratio", form=".2f", head="torque in the wake"),
        ResultColumn("max_eddy_viscosity_ratio", form=".3g", head="nut/nu"), "verdict",
    ]  # fmt: skip
    files = [write_records(out / f"{what}.csv", rows)]
    print_answer(as_json, {"cases": rows}, lambda: print_result_table(rows, columns), files)


@app.command()
def show(
    case: Annotated[Path, define_argument("DIR", "Folder of a case that `mufly cfd run` wrote.")],
    rotor: Annotated[
        str | None,
        define_option(
            "--rotor NAME|FILE",
            "Rotor for the loads of the other methods. Default: the built-in rotor of the case's name.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the last state of a case or a pair: convergence, y+, and loads beside those of other methods.

    For a folder that `mufly cfd sweep --climb` wrote, the thrust over the climb is shown. No solver is needed.
    The blades, with pressure and friction, are written as VTP and glTF into the case's results.
    Example: mufly cfd show case
    """
    from mufly import cfd
    from mufly.rotor import list_builtin_rotors, load_rotor

    both = (case / "upper" / "mufly.json").is_file()
    climbs = [file.parent for file in sorted(case.glob("climb-*/mufly.json"))]
    name = rotor or cfd.read_operating_point(case / "upper" if both else (climbs or [case])[0]).rotor
    known = load_rotor(name) if rotor is not None or name in list_builtin_rotors() else None
    if climbs:
        report_climb_thrust(case, known, [cfd.read_solution(place) for place in climbs], as_json)
    elif both:
        report_pair(case, known, cfd.read_pair_solution(case), as_json)
    else:
        report_case(case, known, as_json)


@app.command()
def compare(
    table: Annotated[
        Path, define_argument("FILE.csv", "Table with columns pitch_deg, rpm, T_... (N) and Q_... (N m).")
    ],
    cases: Annotated[list[Path], define_argument("DIR...", "Folders of cases that `mufly cfd run` wrote.")],
    as_json: JsonOption = False,
) -> None:
    """Compare cases with a table of measurements and of published computations.

    Example: mufly cfd compare thesis_table_3_2.csv case-12-5000 case-12-7000
    """
    from mufly.cfd import compare_cases_with_table as lay_beside

    found = lay_beside(table, cases)

    def print_comparison() -> None:
        parts = (
            ("Thrust (N)", [(c.verdict.thrust_N, c.thrust_deviations) for c in found]),
            ("Torque (mN m)", [(1e3 * c.verdict.torque_Nm, c.torque_deviations) for c in found]),
        )
        for title, values in parts:
            names = list(values[0][1])
            rows = [
                (
                    Path(c.case).name + (f" ({c.point.geometry_note})" if c.point.geometry_note else ""),
                    f"{math.degrees(c.point.pitch_rad):.4g}°, {c.point.speed_rad_s / RPM:.0f}",
                    c.verdict.outcome,
                    f"{ours:.4g}",
                    *(f"{100 * beside[n]:+.1f} %" if n in beside else "" for n in names),
                )
                for c, (ours, beside) in zip(found, values, strict=True)
            ]
            heads = ("case", "pitch, rpm", "verdict", "ours", *(f"against {n}" for n in names))
            print_table(heads, rows, title=title, text=(0, 1, 2))

    print_answer(as_json, {"cases": found}, print_comparison)


@app.command("convergence")
def show_convergence(
    cases: Annotated[
        list[Path], define_argument("DIR DIR DIR", "Folders of three settled cases of one point, on three meshes.")
    ],
    as_json: JsonOption = False,
) -> None:
    """Estimate the observed order and the grid convergence index from three meshes (Celik and others, 2008).

    Example: mufly cfd convergence case-coarse case-medium case-fine
    """
    from mufly.cfd.grid_convergence import estimate_load_grid_convergence, tabulate_grid_convergence

    found = estimate_load_grid_convergence(cases)
    print_answer(as_json, {c.name: c for c in found}, (tabulate_grid_convergence(found),))
