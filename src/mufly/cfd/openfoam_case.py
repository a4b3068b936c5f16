"""OpenFOAM case of an operating point: boundary conditions, solver settings and initial state.

``simpleFoam`` solves the steady, incompressible Navier-Stokes equations for the absolute velocity (SIMPLEC; *p* is
pressure over density). The rotating zone of the mesh (:mod:`mufly.cfd.meshes.sector_mesh`) is a multiple reference
frame; the other cells are at rest. The dictionaries are for OpenFOAM v1912 and later (openfoam.com).

=============  =================================================================================================
blade          no slip, turning with the frame
top, side      total pressure of the oncoming air, w^2 / 2 (hover: 0), with free direction. In climb and descent the
               side has pressure 0, and air enters there with w along it
bottom         pressure 0; returning air enters with w
in descent     top and bottom are exchanged: total pressure of the oncoming air below, pressure 0 above
sector         cyclic by rotation
start          the slipstream of momentum theory (:mod:`mufly.cfd.initial_flow`)
first 80       first-order upwind, because a start at second order diverges
then           bounded linear upwind with limited gradients; corrections of the Laplacian limited to 0.5
=============  =================================================================================================

Ambient turbulence of the turbulence models: intensity 1 % of the induced velocity, turbulent viscosity equal to the
molecular viscosity. Walls are resolved for k-omega and SST (k 0, Menter's wall value of omega, nut 0). For k-epsilon
the standard wall functions are used although they require y+ above 11. This reproduces the dissertation and is no
suitable model for these Reynolds numbers.
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

from mufly.cfd.initial_flow import compute_momentum_slipstream
from mufly.cfd.meshes.polymesh import LOWER_ROTOR_BLADE_PATCH, PolyMesh, format_foam_header, write_poly_mesh
from mufly.cfd.meshes.sector_mesh import MeshDomain
from mufly.errors import InputError, convert_write_errors
from mufly.quantities.units import RPM
from mufly.rotor import Air, compute_tip_mach
from mufly.rotor.validity_checks import MAX_TIP_MACH, check_pitch

Array = NDArray[np.float64]

TURBULENCE_MODELS = {"laminar": "", "k-epsilon": "kEpsilon", "sst": "kOmegaSST", "k-omega": "kOmega"}
"""Turbulence models by OpenFOAM's names."""
FIRST_ORDER_ITERATIONS = 80
"""Number of iterations with the upwind scheme."""
MIN_ASSESSMENT_ITERATIONS = 1200
"""Least number of iterations before a verdict."""
MAX_DESCENT_OVER_INDUCED_VELOCITY = 0.5
"""Greatest ratio of descent velocity to induced velocity in hover; above it (vortex ring state) no case is solved."""
LOAD_FUNCTION_OBJECTS = {"blade": "loads", LOWER_ROTOR_BLADE_PATCH: "loads_lower"}
"""Function objects that report the loads of each rotor, by patch."""
STATE_WRITE_ITERATIONS = 40
"""Number of iterations between written states."""


@dataclass(frozen=True)
class OperatingPoint:
    """Operating point and settings of a case.

    Attributes
    ----------
    rotor : str
        Name of the rotor.
    blades : int
        Number of blades.
    radius_m : float
        Radius of the rotor.
    pitch_rad, speed_rad_s, climb_m_s : float
        Pitch setting, rotor speed and axial speed, positive in climb.
    model : str
        One of :data:`TURBULENCE_MODELS`.
    level : str
        Refinement level of the mesh.
    density_kg_m3, viscosity_Pa_s : float
        Properties of the air.
    induced_m_s : float
        Induced velocity of the initial flow.
    upwind, least : int
        Iterations at first order, and least iterations before a verdict: 0 and 400 for a scaled start.
    tip : str
        Name of the blade tip (:data:`mufly.cfd.meshes.blade_geometry.BLADE_TIPS`).
    hub_m, gurney : float
        Radius of the hub, height over chord of the Gurney flap; 0 for none.
    domain : MeshDomain
        Limits of the domain and of its rotating zone.
    gap_m, lower_pitch_rad, lower_rad_s : float
        Distance to the disc of a counter-rotating second rotor below, its pitch setting and speed (positive); 0 for
        none.
    other_m : float
        Height over this disc (negative: below) of a counter-rotating rotor that is modelled as an actuator disc
        (:mod:`mufly.cfd.rotor_pair`); 0 for none.
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
    upwind: int = FIRST_ORDER_ITERATIONS
    least: int = MIN_ASSESSMENT_ITERATIONS
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
        slowest = -MAX_DESCENT_OVER_INDUCED_VELOCITY * self.induced_m_s
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
                    f"stay below {MAX_TIP_MACH:g}: the air is assumed incompressible",
                )  # fmt: skip

    @property
    def patch_speeds_rad_s(self) -> dict[str, float]:
        """Rotational speed about +z (rad/s) of each wall, by patch name."""
        return {"blade": self.speed_rad_s} | ({LOWER_ROTOR_BLADE_PATCH: -self.lower_rad_s} if self.gap_m else {})

    @property
    def geometry_note(self) -> str:
        """Description of tip, hub and flap, which the rotor file does not contain; empty without them."""
        words = [self.tip] if self.tip != "square" else []
        words += [f"hub {1e3 * self.hub_m:g} mm"] if self.hub_m else []
        words += [f"Gurney flap {100 * self.gurney:g} %"] if self.gurney else []
        return ", ".join(words)

    @property
    def air(self) -> Air:
        """Properties of the air."""
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
    """Write a case for ``simpleFoam`` with script ``Allrun``; existing files in the folder are overwritten.

    Parameters
    ----------
    folder : Path
    mesh : PolyMesh
    point : OperatingPoint
    cores : int
        Number of processes.
    state : dict of arrays, optional
        Initial state from :func:`mufly.cfd.cfd_solution.scale_solution_state`; default: momentum theory.

    Raises
    ------
    InputError
        If the case cannot be written.
    """
    with convert_write_errors("--out", key=str(folder)):
        for part in folder.glob("processor[0-9]*"):  # remains of a previous case
            shutil.rmtree(part)
        write_poly_mesh(mesh, folder)
        for name, text in _format_case_dictionaries(point, cores).items():
            file = folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        (folder / "Allrun").chmod(0o755)
        _write_fields(folder / "0", mesh, point, state or {})
        (folder / "mufly.json").write_text(json.dumps(asdict(point), indent=2) + "\n", encoding="utf-8")


def read_operating_point(folder: Path) -> OperatingPoint:
    """Return the operating point of a case.

    Raises
    ------
    InputError
        If the folder is no case written by mufly.
    """
    file = folder / "mufly.json"
    try:
        told = json.loads(file.read_text(encoding="utf-8"))
        return OperatingPoint(**{**told, "domain": MeshDomain(**told.get("domain", {}))})
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            str(folder), "", "is not a case of mufly cfd", "give a folder written by mufly cfd run --out"
        ) from error


def set_schemes_and_end(folder: Path, *, upwind: bool, end: int) -> None:
    """Set the solver's schemes and the iteration at which it stops."""
    (folder / "system" / "fvSchemes").write_text(_format_fv_schemes(upwind), encoding="utf-8")
    (folder / "system" / "controlDict").write_text(
        _format_control_dict(read_operating_point(folder), end), encoding="utf-8"
    )


def _format_case_dictionaries(point: OperatingPoint, cores: int) -> dict[str, str]:
    turbulent = TURBULENCE_MODELS[point.model]
    kind = f"RAS; RAS {{ RASModel {turbulent}; turbulence on; printCoeffs off; }}" if turbulent else "laminar;"
    return {
        "system/controlDict": _format_control_dict(point, FIRST_ORDER_ITERATIONS),
        "system/fvSchemes": _format_fv_schemes(upwind=True),
        "system/fvSchemes.second": _format_fv_schemes(upwind=False),
        "system/fvSolution": format_foam_header("dictionary", "fvSolution", "system") + _FV_SOLUTION_DICTIONARY,
        "system/decomposeParDict": format_foam_header("dictionary", "decomposeParDict", "system") + (
            f"numberOfSubdomains {cores};\nmethod hierarchical;\n"
            f"coeffs {{ n ({_factor_cores(cores)[0]} {_factor_cores(cores)[1]} 1); delta 0.001; order xyz; }}\n"
        ),
        "constant/MRFProperties": format_foam_header("dictionary", "MRFProperties", "constant") + "".join(
            f"{patch}\n{{\n    cellZone {'rotor' if patch == 'blade' else 'lower'};\n    active yes;\n"
            "    nonRotatingPatches (top side bottom);\n"
            f"    origin (0 0 0);\n    axis (0 0 1);\n    omega constant {speed:.10g};\n}}\n"
            for patch, speed in point.patch_speeds_rad_s.items()
        ),
        "constant/transportProperties": format_foam_header("dictionary", "transportProperties", "constant")
        + f"transportModel Newtonian;\nnu {point.kinematic_viscosity_m2_s:.10g};\n",
        "constant/turbulenceProperties": format_foam_header("dictionary", "turbulenceProperties", "constant")
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
    return format_foam_header("dictionary", "controlDict", "system") + (
        "application simpleFoam;\nstartFrom latestTime;\nstartTime 0;\nstopAt endTime;\n"
        f"endTime {end};\ndeltaT 1;\nwriteControl timeStep;\nwriteInterval {STATE_WRITE_ITERATIONS};\npurgeWrite 2;\n"
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
    return format_foam_header("dictionary", "fvSchemes", "system") + (
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


_FV_SOLUTION_DICTIONARY = """solvers
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
        u = compute_momentum_slipstream(
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
    """Return velocity and pressure conditions of the outer boundaries.

    The oncoming air has static pressure 0 and total pressure w^2 / 2.
    """
    w = f"(0 0 {-climb_m_s:.10g})"
    comes = "type pressureInletOutletVelocity; value uniform (0 0 0);"
    along = f"type pressureInletOutletVelocity; tangentialVelocity uniform {w}; value uniform (0 0 0);"
    leaves = f"type inletOutlet; inletValue uniform {w}; value uniform {w};"
    total = f"type totalPressure; p0 uniform {0.5 * climb_m_s**2:.10g}; value uniform 0;"
    none = "type fixedValue; value uniform 0;"
    before, behind = ("top", "bottom") if climb_m_s >= 0.0 else ("bottom", "top")
    # At outflow a total pressure condition fixes the static pressure. Along the side inflow and outflow alternate, and
    # the pressure would jump between 0 and w^2 / 2: in climb the side has the static pressure 0.
    return (
        {before: comes, "side": along if climb_m_s else comes, behind: leaves},
        {before: total, "side": none if climb_m_s else total, behind: none},
    )


def _compute_face_fluxes(mesh: PolyMesh, u: Array, point: OperatingPoint) -> Array:
    """Compute the volume fluxes through the faces; fluxes of rotating cells are relative to the rotating frame.

    Without them the first step of the solver would use the fluxes of the absolute velocity. The Coriolis force would be
    unbalanced and accelerate the outer air to tens of metres per second.
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
        flux[mesh.patch_face_slice(patch)] = 0.0
    left, right = mesh.patch_face_slice("sector_left"), mesh.patch_face_slice("sector_right")
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
        body += (
            f"    {name} {{ type {kind}; value ".encode() + encode_values(flux[mesh.patch_face_slice(name)]) + b"; }\n"
        )
    head = format_foam_header("surfaceScalarField", "phi", file.parent.name, binary=True).encode()
    file.write_bytes(head + body + b"}\n")


def write_field(file: Path, kind: str, unit: str, values: str | Array, boundary: dict[str, str]) -> None:
    """Write a field: ``"uniform 0"`` or a value for each cell."""
    binary = not isinstance(values, str)
    head = format_foam_header(kind, file.name, file.parent.name, binary=binary).encode()
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
    """Return the induced velocity (m/s) of momentum theory in hover, sqrt(T / (2 rho pi R^2)); 0 without thrust."""
    return math.sqrt(max(thrust_N, 0.0) / (2.0 * air.density_kg_m3 * math.pi * radius_m**2))
