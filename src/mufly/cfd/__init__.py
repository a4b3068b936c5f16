"""What would a Navier-Stokes solver say? Meshes of a rotor's sector, OpenFOAM cases, runs, results."""

from mufly.cfd.case import MODELS, Point, read_point, write_case
from mufly.cfd.comparison import Compared, compare
from mufly.cfd.form import TIPS, Form, Hub, Tip, named_form
from mufly.cfd.mesh import LEVELS, Domain, Mesh, blade_mesh
from mufly.cfd.mesh_error import Convergence, convergence, mesh_study
from mufly.cfd.pictures import history_picture, loads_picture, mesh_picture, pair_picture, pressure_picture
from mufly.cfd.point import (
    Beside,
    MeanPair,
    beside,
    read_pair,
    save_case,
    solve_pair,
    solve_point,
    study,
    study_cases,
    sweep,
)
from mufly.cfd.polymesh import PolyMesh, Quality, poly_mesh, quality, read_poly_mesh, write_poly_mesh
from mufly.cfd.results import Solution, read_solution
from mufly.cfd.run import Progress, Verdict, find_solver, history, judge, judged, run_case
from mufly.cfd.sections import Counts
from mufly.cfd.start import slipstream
from mufly.cfd.surfaces import blade_surface, pressure_colours, write_glb, write_vtp

__all__ = [
    "LEVELS",
    "MODELS",
    "TIPS",
    "Beside",
    "Compared",
    "Convergence",
    "Counts",
    "Domain",
    "Form",
    "Hub",
    "MeanPair",
    "Mesh",
    "Point",
    "PolyMesh",
    "Progress",
    "Quality",
    "Solution",
    "Tip",
    "Verdict",
    "beside",
    "blade_mesh",
    "blade_surface",
    "compare",
    "convergence",
    "find_solver",
    "history",
    "history_picture",
    "judge",
    "judged",
    "loads_picture",
    "mesh_picture",
    "mesh_study",
    "named_form",
    "pair_picture",
    "poly_mesh",
    "pressure_colours",
    "pressure_picture",
    "quality",
    "read_pair",
    "read_point",
    "read_poly_mesh",
    "read_solution",
    "run_case",
    "save_case",
    "slipstream",
    "solve_pair",
    "solve_point",
    "study",
    "study_cases",
    "sweep",
    "write_case",
    "write_glb",
    "write_poly_mesh",
    "write_vtp",
]
