"""What would a Navier-Stokes solver say? Meshes of a rotor's sector, OpenFOAM cases, runs, results."""

from mufly.cfd.case import MODELS, Point, read_point, write_case
from mufly.cfd.comparison import Compared, compare
from mufly.cfd.mesh import LEVELS, Domain, Mesh, blade_mesh
from mufly.cfd.mesh_error import Convergence, convergence, mesh_study
from mufly.cfd.pictures import history_picture, loads_picture, mesh_picture, pressure_picture
from mufly.cfd.point import Beside, beside, save_case, solve_point, sweep
from mufly.cfd.polymesh import PolyMesh, Quality, poly_mesh, quality, read_poly_mesh, write_poly_mesh
from mufly.cfd.results import Solution, read_solution
from mufly.cfd.run import Progress, Verdict, find_solver, history, judge, judged, run_case
from mufly.cfd.sections import Counts
from mufly.cfd.start import slipstream

__all__ = [
    "LEVELS",
    "MODELS",
    "Beside",
    "Compared",
    "Convergence",
    "Counts",
    "Domain",
    "Mesh",
    "Point",
    "PolyMesh",
    "Progress",
    "Quality",
    "Solution",
    "Verdict",
    "beside",
    "blade_mesh",
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
    "poly_mesh",
    "pressure_picture",
    "quality",
    "read_point",
    "read_poly_mesh",
    "read_solution",
    "run_case",
    "save_case",
    "slipstream",
    "solve_point",
    "sweep",
    "write_case",
    "write_poly_mesh",
]
