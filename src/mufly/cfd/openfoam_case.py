"""An OpenFOAM case of one operating point: boundary conditions, numbers for the solver, where it starts.

``simpleFoam`` solves the steady, incompressible Navier-Stokes equations, written with the absolute velocity (SIMPLEC;
*p* is pressure over density): in the blade's frame where the mesh says so (:mod:`mufly.cfd.sector_mesh`; a zone of a
multiple reference frame), around it in a frame at rest. Dictionaries are those of OpenFOAM v1912 and later
(openfoam.com).

=============  =================================================================================================
blade          no slip, turning with the frame
top, side      total pressure of the oncoming air, w^2 / 2 (hover: 0): it comes as it likes; in climb and descent the
               side has pressure 0, and air comes in there with w along it
bottom         pressure 0; what comes back comes with w
in descent     top and bottom change places: the oncoming air's total pressure below, pressure 0 above
sector         cyclic by rotation
start          the slipstream of momentum theory (:mod:`mufly.cfd.initial_flow`)
first 80       upwind: started at second order the solution leaves for ever
then           bounded linear upwind with limited gradients; corrections of the Laplacian limited to 0.5
=============  =================================================================================================

Ambient turbulence, for the models: 1 % of the induced velocity, turbulent viscosity that of the air itself. It stays
that low as it is blown in; the walls of k-omega and SST are resolved (k 0, omega as Menter's wall value, nut 0 by a
function that a smooth wall wants), those of k-epsilon are the standard functions, which hold for y+ above 11 and are
used all the same: a check of what the dissertation did, no model for these Reynolds numbers.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.initial_flow import momentum_slipstream
from mufly.cfd.polymesh import LOWER_BLADE_PATCH, PolyMesh, foam_header, write_poly_mesh
from mufly.cfd.sector_mesh import MeshDomain
from mufly.errors import InputError, report_write_errors
from mufly.rotor import Air, compute_tip_mach
from mufly.rotor.rotor_system import MAX_TIP_MACH, check_pitch
from mufly.units import RPM

Array = NDArray[np.float64]

TURBULENCE_MODELS = {"laminar": "", "k-epsilon": "kEpsilon", "sst": "kOmegaSST", "k-omega": "kOmega"}
"""Turbulence models, by OpenFOAM's names."""
UPWIND_ITERATIONS = 80
"""Iterations upwind."""
MIN_ITERATIONS = 1200
"""Iterations before a verdict."""
MAX_DESCENT_RATIO = 0.5
"""Descent, over the velocity induced in hover, at which the steady equations are given up (vortex ring state)."""
LOAD_FUNCTION_OBJECTS = {"blade": "loads", LOWER_BLADE_PATCH: "loads_lower"}
"""Function objects that tell each rotor's loads, by patch."""
WRITE_INTERVAL = 40
"""Iterations from one written state to the next."""


@dataclass(frozen=True)
class OperatingPoint:
    """What a case computes.

    Attributes
    ----------
    rotor : str
        Name of the rotor.
    blades : int
    radius_m : float
    pitch_rad, speed_rad_s, climb_m_s : float
        Axial speed positive in climb.
    model : str
        One of :data:`TURBULENCE_MODELS`.
    level : str
        Of the mesh.
    density_kg_m3, viscosity_Pa_s : float
        Of the air.
    induced_m_s : float
        Velocity in the disc that the start assumes.
    upwind, least : int
        Iterations at first order, and before a verdict: 0 and 400 where the start is a neighbour's solution, scaled.
    tip : str
        Name of the blades' tip (:data:`mufly.cfd.blade_geometry.BLADE_TIPS`).
    hub_m, gurney : float
        Radius of the hub, height over chord of the Gurney flap; 0 for none.
    domain : Domain
        Limits of the air, and of its turning part.
    gap_m, lower_pitch_rad, lower_rad_s : float
        Of a second rotor that turns the other way: how far its disc lies below, its pitch setting and speed (positive);
        0 for none.
    other_m : float
        Height over this disc (below 0: under it) of another rotor that turns the other way and stands there as a disc
        of force, the mean of its loads around the shaft (:mod:`mufly.cfd.rotor_pair`); 0 for none.
    """

    rotor: str
    blades: int
    radius_m: float
    pitch_rad: float
    speed_rad_s: float
    climb_m_s: float
    model: str
    level: str
    density_kg_m3: float
    viscosity_Pa_s: float
    induced_m_s: float
    upwind: int = UPWIND_ITERATIONS
    least: int = MIN_ITERATIONS
    tip: str = "square"
    hub_m: float = 0.0
    gurney: float = 0.0
    domain: MeshDomain = field(default_factory=MeshDomain)
    gap_m: float = 0.0
    lower_pitch_rad: float = 0.0
    lower_rad_s: float = 0.0
    other_m: float = 0.0

    def __post_init__(self) -> None:
        if self.model not in TURBULENCE_MODELS:
            raise InputError(
                "cfd", "model", f"{self.model!r} is unknown", f"use one of: {', '.join(TURBULENCE_MODELS)}"
            )
        check_pitch("cfd", "pitch_rad", [self.pitch_rad, self.lower_pitch_rad])
        slowest = -MAX_DESCENT_RATIO * self.induced_m_s
        if not slowest <= self.climb_m_s < math.inf:
            raise InputError(
                "cfd", "climb", f"is {self.climb_m_s:g} m/s",
                f"give {slowest:.2g} or more: in faster descent the rotor's wake is a ring that is not steady",
            )  # fmt: skip
        for speed in (self.speed_rad_s, self.lower_rad_s if self.gap_m else 1.0):
            if not 0.0 < speed < math.inf:
                raise InputError("cfd", "speed", f"is {speed:g} rad/s", "give a number above 0")
            if (mach := compute_tip_mach(self.radius_m, speed)) >= MAX_TIP_MACH:
                raise InputError(
                    "cfd", "speed", f"{speed / RPM:.6g} rpm moves the tips at Mach {mach:.2g}",
                    f"stay below {MAX_TIP_MACH:g}: the air is taken for incompressible",
                )  # fmt: skip

    @property
    def patch_speeds_rad_s(self) -> dict[str, float]:
        """Speeds (rad/s) about +z by the name of the patch."""
        return {"blade": self.speed_rad_s} | ({LOWER_BLADE_PATCH: -self.lower_rad_s} if self.gap_m else {})

    @property
    def geometry_note(self) -> str:
        """What stands on the blades beyond the rotor file: tip, hub, flap; empty for none."""
        words = [self.tip] if self.tip != "square" else []
        words += [f"hub {1e3 * self.hub_m:g} mm"] if self.hub_m else []
        words += [f"Gurney flap {100 * self.gurney:g} %"] if self.gurney else []
        return ", ".join(words)

    @property
    def air(self) -> Air:
        """The air."""
        return Air(self.density_kg_m3, self.viscosity_Pa_s)

    @property
    def kinematic_viscosity_m2_s(self) -> float:
        """Kinematic viscosity (m2/s)."""
        return self.viscosity_Pa_s / self.density_kg_m3


def write_case(
    folder: Path,
    mesh: PolyMesh,
    point: OperatingPoint,
    *,
    cores: int = 1,
    state: Mapping[str, Array] | None = None,
) -> None:
    """Write a case that ``simpleFoam`` and ``Allrun`` run; what is in the folder is written over.

    Parameters
    ----------
    folder : Path
    mesh : PolyMesh
    point : Point
    cores : int
        Processes.
    state : dict of arrays, optional
        Where to start, as :func:`mufly.cfd.cfd_solution.scale_state` returns it; default: momentum theory.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    with report_write_errors("--out", key=str(folder)):
        for part in folder.glob("processor[0-9]*"):  # of what was there before
            shutil.rmtree(part)
        write_poly_mesh(mesh, folder)
        for name, text in _dictionary_texts(point, cores).items():
            file = folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        (folder / "Allrun").chmod(0o755)
        _write_fields(folder / "0", mesh, point, state or {})
        (folder / "mufly.json").write_text(json.dumps(asdict(point), indent=2) + "\n", encoding="utf-8")


def read_point(folder: Path) -> OperatingPoint:
    """Return what a case computes.

    Raises
    ------
    InputError
        If the folder is no case of ours.
    """
    file = folder / "mufly.json"
    try:
        told = json.loads(file.read_text(encoding="utf-8"))
        return OperatingPoint(**{**told, "domain": MeshDomain(**told.get("domain", {}))})
    except (OSError, ValueError, TypeError) as error:
        raise InputError(str(folder), "", "is not a case of mufly cfd", "give the folder of --out") from error


def set_solver_phase(folder: Path, *, upwind: bool, end: int) -> None:
    """Tell the solver its schemes and the iteration at which it stops."""
    (folder / "system" / "fvSchemes").write_text(_format_fv_schemes(upwind), encoding="utf-8")
    (folder / "system" / "controlDict").write_text(_format_control_dict(read_point(folder), end), encoding="utf-8")


def _dictionary_texts(point: OperatingPoint, cores: int) -> dict[str, str]:
    turbulent = TURBULENCE_MODELS[point.model]
    kind = f"RAS; RAS {{ RASModel {turbulent}; turbulence on; printCoeffs off; }}" if turbulent else "laminar;"
    return {
        "system/controlDict": _format_control_dict(point, UPWIND_ITERATIONS),
        "system/fvSchemes": _format_fv_schemes(upwind=True),
        "system/fvSchemes.second": _format_fv_schemes(upwind=False),
        "system/fvSolution": foam_header("dictionary", "fvSolution", "system") + _FV_SOLUTION,
        "system/decomposeParDict": foam_header("dictionary", "decomposeParDict", "system") + (
            f"numberOfSubdomains {cores};\nmethod hierarchical;\n"
            f"coeffs {{ n ({_factor_cores(cores)[0]} {_factor_cores(cores)[1]} 1); delta 0.001; order xyz; }}\n"
        ),
        "constant/MRFProperties": foam_header("dictionary", "MRFProperties", "constant") + "".join(
            f"{patch}\n{{\n    cellZone {'rotor' if patch == 'blade' else 'lower'};\n    active yes;\n"
            "    nonRotatingPatches (top side bottom);\n"
            f"    origin (0 0 0);\n    axis (0 0 1);\n    omega constant {speed:.10g};\n}}\n"
            for patch, speed in point.patch_speeds_rad_s.items()
        ),
        "constant/transportProperties": foam_header("dictionary", "transportProperties", "constant")
        + f"transportModel Newtonian;\nnu {point.kinematic_viscosity_m2_s:.10g};\n",
        "constant/turbulenceProperties": foam_header("dictionary", "turbulenceProperties", "constant")
        + f"simulationType {kind}\n",
        "Allrun": (
            "#!/bin/sh\n# The whole case without mufly: first order, then second.\nset -e\ncd \"$(dirname \"$0\")\"\n"
            "export WM_PROJECT_DIR=\"${WM_PROJECT_DIR:-/usr/share/openfoam}\"\nsimpleFoam > log.first\n"
            "cp system/fvSchemes.second system/fvSchemes\n"
            "sed -i 's/^endTime .*/endTime 1200;/' system/controlDict\nsimpleFoam > log.second\n"
        ),
    }  # fmt: skip


def _factor_cores(cores: int) -> tuple[int, int]:
    a = max(d for d in range(1, math.isqrt(cores) + 1) if cores % d == 0)
    return cores // a, a


def _format_control_dict(point: OperatingPoint, end: int) -> str:
    return foam_header("dictionary", "controlDict", "system") + (
        "application simpleFoam;\nstartFrom latestTime;\nstartTime 0;\nstopAt endTime;\n"
        f"endTime {end};\ndeltaT 1;\nwriteControl timeStep;\nwriteInterval {WRITE_INTERVAL};\npurgeWrite 2;\n"
        "writeFormat binary;\n"
        "writePrecision 10;\ntimeFormat general;\ntimePrecision 8;\nrunTimeModifiable no;\n"
        "functions\n{\n"
        + "".join(
            f"    {LOAD_FUNCTION_OBJECTS[patch]}\n    "
            f"{{\n        type forces;\n        libs (forces);\n        patches ({patch});\n"
            f"        rho rhoInf;\n        rhoInf {point.density_kg_m3:.10g};\n        CofR (0 0 0);\n"
            "        executeControl timeStep;\n        writeControl timeStep;\n        log no;\n    }\n"
            for patch in point.patch_speeds_rad_s
        )
        + "    flows\n    {\n        type surfaceFieldValue;\n        libs (fieldFunctionObjects);\n"
        "        regionType patch;\n        name bottom;\n        operation sum;\n        fields (phi);\n"
        "        writeFields no;\n        executeControl timeStep;\n        writeControl timeStep;\n"
        "        log no;\n    }\n}\n"
    )


def _format_fv_schemes(upwind: bool) -> str:
    first = "bounded Gauss upwind"
    u = first if upwind else "bounded Gauss linearUpwind limited"
    return foam_header("dictionary", "fvSchemes", "system") + (
        "ddtSchemes { default steadyState; }\n"
        "gradSchemes\n{\n    default Gauss linear;\n    limited cellLimited Gauss linear 1;\n"
        "    grad(k) cellLimited Gauss linear 1;\n    grad(omega) cellLimited Gauss linear 1;\n}\n"
        "divSchemes\n{\n    default none;\n"
        f"    div(phi,U) {u};\n    div(phi,k) {first};\n    div(phi,epsilon) {first};\n    div(phi,omega) {first};\n"
        "    div((nuEff*dev2(T(grad(U))))) Gauss linear;\n}\n"
        "laplacianSchemes { default Gauss linear limited 0.5; }\n"
        "interpolationSchemes { default linear; }\n"
        "snGradSchemes { default limited 0.5; }\n"
        "wallDist { method meshWave; }\n"
    )


_FV_SOLUTION = """solvers
{
    p { solver GAMG; smoother GaussSeidel; tolerance 1e-9; relTol 0.01; nPreSweeps 0; nPostSweeps 2; maxIter 50; }
    "(U|k|epsilon|omega)" { solver smoothSolver; smoother symGaussSeidel; tolerance 1e-10; relTol 0.1; maxIter 10; }
    Phi { solver GAMG; smoother GaussSeidel; tolerance 1e-8; relTol 0.01; }
}
SIMPLE { nNonOrthogonalCorrectors 0; consistent yes; }
potentialFlow { nNonOrthogonalCorrectors 3; }
relaxationFactors
{
    fields { p 0.6; }
    equations { U 0.7; "(k|epsilon|omega)" 0.5; }
}
"""


def _write_fields(folder: Path, mesh: PolyMesh, point: OperatingPoint, state: Mapping[str, Array]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    u = state.get("U")
    if u is None:
        u = momentum_slipstream(
            mesh.cell_centres,
            radius_m=point.radius_m,
            induced_m_s=point.induced_m_s,
            climb_m_s=point.climb_m_s,
        )
    flow, onset = _far_field_conditions(point.climb_m_s)
    cyclic = {"sector_left": "type cyclic;", "sector_right": "type cyclic;"}
    blades = '"blade.*"' if point.gap_m else "blade"
    write_field(
        folder / "U", "volVectorField", "[0 1 -1 0 0 0 0]", u,
        {**cyclic, **flow, blades: "type fixedValue; value uniform (0 0 0);"},
    )  # fmt: skip
    write_field(
        folder / "p", "volScalarField", "[0 2 -2 0 0 0 0]", state.get("p", "uniform 0"),
        {**cyclic, **onset, blades: "type zeroGradient;"},
    )  # fmt: skip
    flux = state.get("phi")
    _write_flux(folder / "phi", mesh, _compute_face_fluxes(mesh, u, point) if flux is None else flux)
    if point.model == "laminar":
        return
    k = 1.5 * (0.01 * point.induced_m_s) ** 2
    values: dict[str, tuple[str, float, str]] = {
        "k": ("[0 2 -2 0 0 0 0]", k, "type kqRWallFunction; value $internalField;"),
        "nut": (
            "[0 2 -1 0 0 0 0]",
            point.kinematic_viscosity_m2_s,
            "type nutkWallFunction; value uniform 0;",
        ),
    }
    if point.model == "k-epsilon":
        values["epsilon"] = (
            "[0 2 -3 0 0 0 0]",
            0.09 * k * k / point.kinematic_viscosity_m2_s,
            "type epsilonWallFunction; value $internalField;",
        )
    else:
        values["k"] = (values["k"][0], k, "type fixedValue; value uniform 1e-12;")
        values["nut"] = (
            values["nut"][0],
            point.kinematic_viscosity_m2_s,
            "type nutLowReWallFunction; value uniform 0;",
        )
        values["omega"] = (
            "[0 0 -1 0 0 0 0]",
            k / point.kinematic_viscosity_m2_s,
            "type omegaWallFunction; value $internalField;",
        )
    for name, (unit, value, wall) in values.items():
        free = f"type inletOutlet; inletValue uniform {value:.10g}; value uniform {value:.10g};"
        if name == "nut":
            free = "type calculated; value $internalField;"
        write_field(
            folder / name, "volScalarField", unit, state.get(name, f"uniform {value:.10g}"),
            {**cyclic, "top": free, "side": free, "bottom": free, blades: wall},
        )  # fmt: skip


def _far_field_conditions(climb_m_s: float) -> tuple[dict[str, str], dict[str, str]]:
    """Velocity and pressure on the outer boundaries; the oncoming air has static pressure 0 and so w^2 / 2 in all."""
    w = f"(0 0 {-climb_m_s:.10g})"
    comes = "type pressureInletOutletVelocity; value uniform (0 0 0);"
    along = f"type pressureInletOutletVelocity; tangentialVelocity uniform {w}; value uniform (0 0 0);"
    leaves = f"type inletOutlet; inletValue uniform {w}; value uniform {w};"
    total = f"type totalPressure; p0 uniform {0.5 * climb_m_s**2:.10g}; value uniform 0;"
    none = "type fixedValue; value uniform 0;"
    before, behind = ("top", "bottom") if climb_m_s >= 0.0 else ("bottom", "top")
    # Where air goes out, a total pressure is the static one. Along the side it goes in here and out there, and would
    # meet 0 and w^2 / 2 by turns: in climb the side has the static pressure, 0.
    return (
        {before: comes, "side": along if climb_m_s else comes, behind: leaves},
        {before: total, "side": none if climb_m_s else total, behind: none},
    )


def _compute_face_fluxes(mesh: PolyMesh, u: Array, point: OperatingPoint) -> Array:
    """The fluxes through the faces; of the turning cells relative to their frame.

    Without them the solver would take those of the absolute velocity for its first step, in which Coriolis' force then
    has nothing to balance it: the outer air would be thrown about at tens of metres a second.
    """
    inside = len(mesh.neighbour)
    at = u[mesh.owner]
    at[:inside] = 0.5 * (at[:inside] + u[mesh.neighbour])
    centre = mesh.face_centres
    spin = np.where(mesh.cell_rotation_sign < 0.0, -point.lower_rad_s, point.speed_rad_s * mesh.cell_rotation_sign)
    turning = spin[mesh.owner]
    turning[:inside] = np.where(turning[:inside] == 0.0, spin[mesh.neighbour], turning[:inside])
    at[:, 0] += turning * centre[:, 1]
    at[:, 1] -= turning * centre[:, 0]
    flux = np.einsum("fi,fi->f", at, mesh.face_areas)
    for patch in point.patch_speeds_rad_s:
        flux[mesh.patch_faces(patch)] = 0.0
    left, right = mesh.patch_faces("sector_left"), mesh.patch_faces("sector_right")
    flux[left] = 0.5 * (flux[left] - flux[right])
    flux[right] = -flux[left]
    return flux


def _write_flux(file: Path, mesh: PolyMesh, flux: Array) -> None:
    inside = len(mesh.neighbour)

    def encode_values(v: Array) -> bytes:
        return f"nonuniform List<scalar> {len(v)}\n(".encode() + v.astype("<f8").tobytes() + b")"

    body = b"dimensions [0 3 -1 0 0 0 0];\n\ninternalField " + encode_values(flux[:inside]) + b";\n\nboundaryField\n{\n"
    for name in mesh.patches:
        kind = "cyclic" if name.startswith("sector") else "calculated"
        body += f"    {name} {{ type {kind}; value ".encode() + encode_values(flux[mesh.patch_faces(name)]) + b"; }\n"
    head = foam_header("surfaceScalarField", "phi", file.parent.name, binary=True).encode()
    file.write_bytes(head + body + b"}\n")


def write_field(file: Path, kind: str, unit: str, values: str | Array, boundary: dict[str, str]) -> None:
    """Write a field: ``"uniform 0"`` or a value for each cell."""
    binary = not isinstance(values, str)
    head = foam_header(kind, file.name, file.parent.name, binary=binary).encode()
    if isinstance(values, str):
        body = values.encode()
    else:
        rank = "vector" if values.ndim == 2 else "scalar"
        body = f"nonuniform List<{rank}> {len(values)}\n(".encode()
        body += np.ascontiguousarray(values, dtype="<f8").tobytes() + b")"
    patches = "".join(f"    {name} {{ {text} }}\n" for name, text in boundary.items())
    file.write_bytes(
        head + f"dimensions {unit};\n\ninternalField ".encode() + body
        + f";\n\nboundaryField\n{{\n{patches}}}\n".encode()
    )  # fmt: skip


def momentum_induced_velocity(thrust_N: float, radius_m: float, air: Air) -> float:
    """Induced velocity (m/s) of momentum theory in hover, sqrt(T / (2 rho pi R^2)); 0 without thrust."""
    return math.sqrt(max(thrust_N, 0.0) / (2.0 * air.density_kg_m3 * math.pi * radius_m**2))
