"""Reports of solved cases: loads beside those of other methods, and tables, pictures and surfaces of the flow."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mufly.cfd import cfd_pictures
from mufly.cfd.case_studies import PAIR_FOLDERS, PairSolution, SpanLoads
from mufly.cfd.cfd_comparison import predict_span_loads
from mufly.cfd.cfd_solution import (
    CfdSolution,
    FlowField,
    WakeProfile,
    compute_wake_profile,
    read_flow,
    read_solution,
)
from mufly.cfd.meshes.polymesh import PolyMesh, read_poly_mesh
from mufly.cfd.openfoam_case import OperatingPoint
from mufly.cfd.rotor_pair import read_actuator_disc
from mufly.cfd.solver_process import ConvergenceAssessment, read_load_history
from mufly.cfd.surface_export import (
    average_faces_at_points,
    extract_blade_surface,
    extract_vortex_surface,
    map_colours,
    write_glb,
    write_vtp,
)
from mufly.quantities.units import RPM
from mufly.results import (
    ResultColumn,
    ShownBlock,
    ShownTable,
    make_lines_block,
    result,
    select_fields,
    tabulate_results,
)
from mufly.rotor import Rotor
from mufly.rotor.structure.coupled_rounds import AeroelasticSolution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_LOAD_FIELDS = (
    "verdict thrust_N torque_Nm power_W c_T c_Q figure_of_merit friction_torque_fraction r_m dr_m thrust_N_m "
    "torque_Nm_m reversed_flow_fraction"
)
_METHOD_COLUMNS = (
    ResultColumn("thrust_N", form=".4f"),
    ResultColumn("torque_Nm", "mN m", ".4f"),
    ResultColumn("cfd_thrust_difference", "%", "+.1f"),
    ResultColumn("cfd_torque_difference", "%", "+.1f"),
)


@result(eq=False)
class SolutionReport:
    """Solution of a case with loads by other methods, load history and flow field.

    Attributes
    ----------
    solution : CfdSolution
        Solution of the rotor; for a pair in one mesh, of the upper one.
    other_loads : tuple of SpanLoads
        Loads by methods without CFD at the same point.
    lower, lower_other_loads : CfdSolution or None, tuple of SpanLoads
        The same for the lower rotor of a pair in one mesh; None and empty without it.
    history : (iterations, 3) array
        Iteration, thrust (N) and torque (N m).
    mesh : PolyMesh
    flow : FlowField
    wake : WakeProfile
    rounds : AeroelasticSolution, optional
        Rounds of solver and beam of an elastic blade.
    """

    solution: CfdSolution
    other_loads: tuple[SpanLoads, ...]
    lower: CfdSolution | None
    lower_other_loads: tuple[SpanLoads, ...]
    history: Array
    mesh: PolyMesh
    flow: FlowField
    wake: WakeProfile
    rounds: AeroelasticSolution | None = None

    @property
    def settled(self) -> bool:
        """True if the loads of all rotors of the case have converged."""
        return self.solution.verdict.settled and (self.lower is None or self.lower.verdict.settled)

    def as_record(self) -> dict[str, Any]:
        """Return the operating point, loads, verdict and the loads by other methods."""
        more = "max_eddy_viscosity_ratio wake_torque_ratio wake_thrust_ratio yplus_largest=yplus.max yplus_median"
        return {
            "point": self.solution.point,
            **select_fields(self.solution, f"{_LOAD_FIELDS} {more}"),
            "beside": {o.method: select_fields(o, "thrust_N torque_Nm") for o in self.other_loads},
            **({} if self.lower is None else {"lower": select_fields(self.lower, _LOAD_FIELDS)}),
            **({} if self.rounds is None else {"rounds": self.rounds}),
        }

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return verdict and loads of each rotor, beside those of other methods."""
        point, low = self.solution.point, self.lower
        side = "lower rotor: " if point.other_m > 0 else "upper rotor: " if point.other_m < 0 else ""
        blocks = [] if self.rounds is None else [*self.rounds.make_printed_blocks()]
        blocks += _show_rotor(self.solution, self.other_loads, point, side)
        if low is not None:
            under = replace(point, pitch_rad=point.lower_pitch_rad, speed_rad_s=point.lower_rad_s)
            blocks += _show_rotor(low, self.lower_other_loads, under, "lower rotor: ")
            blocks.append(_tabulate_load_ratios(self.solution, low, self.other_loads, self.lower_other_loads))
        return tuple(blocks)

    def list_tables(self) -> Iterator[tuple[str, tuple[str, ...], Iterable[Sequence[float]]]]:
        """Yield the name, the heads and the rows of each table: load history, loads along the blade, and wake."""
        yield "history", ("iteration", "thrust_N", "torque_Nm"), self.history
        heads = ("r_m", "dr_m", "thrust_N_m", "torque_Nm_m", "reversed_flow_fraction")
        yield "loads", heads, np.column_stack([getattr(self.solution, name) for name in heads])
        w = self.wake
        depth, radius = np.meshgrid(w.below_m, w.r_m, indexing="ij")
        columns = [x.ravel() for x in (depth, radius, w.down_m_s, w.swirl_m_s)]
        yield "wake", ("below_m", "r_m", "down_m_s", "swirl_m_s"), np.column_stack(columns)

    def draw_pictures(self) -> Iterator[tuple[str, Figure]]:
        """Yield the name and the picture of loads, pressure, load history, friction, vorticity, vortices and wake."""
        s, mesh, flow = self.solution, self.mesh, self.flow
        yield "loads", cfd_pictures.draw_span_loads(s, self.other_loads)
        yield "pressure", cfd_pictures.draw_surface_pressure(mesh, s)
        yield "history", cfd_pictures.draw_iteration_history(self.history)
        yield "friction", cfd_pictures.draw_skin_friction(mesh, s)
        yield "vorticity", cfd_pictures.draw_vorticity(mesh, flow, s.point)
        vortices = extract_vortex_surface(mesh, flow, s.point)
        yield "vortices", cfd_pictures.draw_vortices(vortices, mesh, s.point)
        yield "wake", cfd_pictures.draw_wake_profile(self.wake)

    def write_surfaces(self, folder: Path) -> list[Path]:
        """Write the blades with their pressure, and the vortices with the downward velocity, as VTP and glTF."""
        name, mesh = self.solution.point.rotor, self.mesh
        points, faces, data = extract_blade_surface(mesh, self.solution)
        at, sides, values = extract_vortex_surface(mesh, self.flow, self.solution.point)
        down = average_faces_at_points(at, sides, values["down_m_s"])
        return [
            write_vtp(folder / "blades.vtp", points, faces, data),
            write_glb(folder / "blades.glb", points, faces, map_colours(data["pressure_Pa"]), name),
            write_vtp(folder / "vortices.vtp", at, sides, values),
            write_glb(folder / "vortices.glb", at, sides, map_colours(down), name, shared=True),
        ]


@result(eq=False)
class PairReport:
    """Reports of both rotors of a pair whose cases are solved alternately.

    Attributes
    ----------
    pair : PairSolution
    upper, lower : SolutionReport
    """

    pair: PairSolution
    upper: SolutionReport
    lower: SolutionReport

    def as_record(self) -> dict[str, Any]:
        """Return the ratios of the pair, and the record of each rotor."""
        ratios = select_fields(self.pair, "settled thrust_ratio torque_ratio midway_downwash_m_s")
        return {**ratios, "upper": self.upper, "lower": self.lower}

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return both rotors, their ratios by every method, and the velocity between the discs."""
        up, low = self.pair.midway_downwash_m_s
        above, below = self.upper.other_loads, self.lower.other_loads
        return (
            *self.upper.make_printed_blocks(),
            *self.lower.make_printed_blocks(),
            _tabulate_load_ratios(self.pair.upper, self.pair.lower, above, below),
            make_lines_block(
                f"Half way between the discs the mean downward velocity is {up:.2f} m/s under the upper rotor's blades "
                f"and {low:.2f} m/s in the lower one's case."
            ),
            *_warn_unless_settled(self.pair.settled),
        )


def build_solution_report(
    folder: Path, rotor: Rotor | None, rounds: AeroelasticSolution | None = None
) -> SolutionReport:
    """Read the last state of a case, and predict its loads by other methods.

    Parameters
    ----------
    folder : Path
    rotor : Rotor, optional
        Rotor of the case; without it there are no loads by other methods.
    rounds : AeroelasticSolution, optional
        Rounds of solver and beam of an elastic blade.

    Raises
    ------
    InputError
        If there is no state, or a file is truncated.
    """
    mesh = read_poly_mesh(folder)
    found, other = read_solution(folder, mesh), read_actuator_disc(folder)
    low = read_solution(folder, mesh, patch="blade_lower") if found.point.gap_m else None
    beside = () if rotor is None else predict_span_loads(rotor, found, other, int(found.point.other_m > 0.0))
    beside_low = () if rotor is None or low is None else predict_span_loads(rotor, found, None, 1)
    flow, second = read_flow(folder, mesh), low or other
    wake = compute_wake_profile(mesh, flow, found.point, found.thrust_N + (second.thrust_N if second else 0.0))
    return SolutionReport(
        found, tuple(beside), low, tuple(beside_low), read_load_history(folder), mesh, flow, wake, rounds
    )


def build_pair_report(folder: Path, rotor: Rotor | None, pair: PairSolution) -> PairReport:
    """Read the reports of both cases of a pair that is solved alternately."""
    upper, lower = (build_solution_report(folder / name, rotor) for name in PAIR_FOLDERS)
    return PairReport(pair, upper, lower)


def _show_rotor(
    found: CfdSolution, others: Sequence[SpanLoads], p: OperatingPoint, side: str
) -> tuple[ShownBlock, ...]:
    """Return the verdict and the loads of one rotor at an operating point."""
    v = found.verdict
    loads = [{"thrust_N": v.thrust_N, "torque_Nm": v.torque_Nm, **dict.fromkeys(_DIFFERENCES)}]
    for o in others:
        change = (v.thrust_N / o.thrust_N - 1.0, v.torque_Nm / o.torque_Nm - 1.0)
        loads.append({**select_fields(o, "thrust_N torque_Nm"), **dict(zip(_DIFFERENCES, change, strict=True))})
    note = f"With {p.geometry_note}; blade elements and wake are computed for the plain blade."
    return (
        make_lines_block(
            f"  {np.degrees(p.pitch_rad):.4g}°, {p.speed_rad_s / RPM:.0f} rpm, {p.model}, {p.level} mesh, "
            f"{v.iterations} iterations: {v.outcome}",
            head=f"{side}{p.rotor}",
        ),
        *((make_lines_block(note),) if p.geometry_note else ()),
        tabulate_results(loads, _METHOD_COLUMNS, names=["cfd", *(o.method for o in others)]),
        *found.make_printed_blocks(),
        *_warn_unless_settled(v.settled, v.outcome),
    )


def _warn_unless_settled(settled: bool, outcome: str = "") -> tuple[ShownBlock, ...]:
    what = f"Not settled ({outcome})" if outcome else "Not settled"
    return () if settled else (make_lines_block(f"{what}: do not rely on these numbers.", style="yellow"),)


_DIFFERENCES = ("cfd_thrust_difference", "cfd_torque_difference")


def _tabulate_load_ratios(
    upper: CfdSolution, lower: CfdSolution, above: Sequence[SpanLoads], below: Sequence[SpanLoads]
) -> ShownTable:
    """Return the loads of the lower rotor of a pair over those of the upper one, by every method."""
    second = {o.method: o for o in below}
    rows = {"cfd": _divide_loads(lower.verdict, upper.verdict)}
    rows |= {o.method: _divide_loads(second[o.method], o) for o in above if o.method in second}
    columns = [ResultColumn(name, form=".3f", head=f"{name}, lower over upper rotor") for name in ("thrust", "torque")]
    return tabulate_results([*rows.values()], columns, names=[*rows])


def _divide_loads(
    lower: SpanLoads | ConvergenceAssessment, upper: SpanLoads | ConvergenceAssessment
) -> dict[str, float]:
    return {"thrust": lower.thrust_N / upper.thrust_N, "torque": lower.torque_Nm / upper.torque_Nm}
