"""The dissertation's 91 figures and 7 tables, each with what it is and, where it is no result, what stands for it here.

A photograph, sketch or block diagram cannot agree or differ: it gets a line that says where in mufly the same thing
is. A result has a study (:mod:`mufly.thesis.study_runner`). Titles are in our words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mufly.errors import InputError

ItemKind = Literal["result", "photograph", "sketch", "diagram"]

FIGURE_COUNTS = {1: 3, 2: 12, 3: 45, 4: 5, 5: 6, 6: 20}
"""Chapter -> number of figures."""
TABLE_COUNTS = {3: 4, 5: 3}
"""Chapter -> number of tables."""


@dataclass(frozen=True)
class ThesisItem:
    """One figure or table.

    Attributes
    ----------
    name : str
        ``fig-3.26`` or ``table-3.3``.
    kind : str
    section : str
        Where it stands.
    title : str
    substitute : str
        What stands for it here; "" for a result.
    """

    name: str
    kind: ItemKind
    section: str
    title: str
    substitute: str = ""

    @property
    def citation(self) -> str:
        """As it is cited: ``Fig. 3.26``, ``Table 3.3``."""
        kind, _, number = self.name.partition("-")
        return f"{'Fig.' if kind == 'fig' else 'Table'} {number}"

    @property
    def cli_command(self) -> str:
        """What repeats or shows it."""
        return f"mufly thesis {'run' if self.kind == 'result' else 'show'} {self.name}"


_ITEM_ROWS: tuple[tuple[str, ItemKind, str, str, str], ...] = (
    (
        "fig-1.1",
        "sketch",
        "1.1",
        "Five rotor configurations",
        "`rotor.RotorSystem` holds one rotor or a coaxial pair; quadrotor, tandem and tail rotor are not modelled",
    ),
    (
        "fig-1.2",
        "sketch",
        "1.2",
        "Three ways to steer a coaxial helicopter",
        "the one chosen, tilting the tip path plane, is `dynamics/equations_of_motion.py` "
        "(docs/explanation/dynamics.md); the "
        "other two are not modelled",
    ),
    (
        "fig-1.3",
        "sketch",
        "1.2",
        "Azimuth of a blade",
        "the azimuth of `rotor/wake` and of the load over a turn in docs/explanation/wake.md",
    ),
    ("fig-2.1", "photograph", "2", "Prototype 1.0", "no vehicle file: nothing of it is stated that flies"),
    ("fig-2.2", "photograph", "2", "Prototype 1.1", "`mufly vehicle show mufly-1.1`"),
    ("fig-2.3", "photograph", "2", "Prototype 2.0", "`mufly vehicle show mufly-2.0`"),
    ("fig-2.4", "result", "2", "Masses of prototypes 1.1 and 2.0", ""),
    ("fig-2.5", "result", "2.1.1", "How the stabiliser bar rights the helicopter", ""),
    ("fig-2.6", "result", "2.1.2", "Inertial unit, and what the text says of its clipping", ""),
    ("fig-2.7", "result", "2.1.2", "Ultrasonic sensor, laser ring and omnidirectional camera", ""),
    (
        "fig-2.8",
        "photograph",
        "2.1.2",
        "Pictures of the down-looking camera and of a webcam",
        "pictures are not made; the position that V-SLAM made of them is `sensors/position_fix.py` "
        "(docs/reference/sensors.md)",
    ),
    (
        "fig-2.9",
        "photograph",
        "2.1.2",
        "Motor and servo",
        "`mufly drive show mufly`, and the swash plate of the vehicle file",
    ),
    ("fig-2.10", "sketch", "2.1.3", "Assembly of prototype 2.0", "`[mass_budget]` and `[sensors]` of `mufly-2.0`"),
    (
        "fig-2.11",
        "diagram",
        "2.1.3",
        "Electronics",
        "docs/reference/firmware.md: what runs on the processor; docs/reference/sensors.md: what is on board",
    ),
    ("fig-2.12", "photograph", "2.2", "Ground station", "`mufly station` (docs/reference/station.md)"),
    (
        "fig-3.1",
        "sketch",
        "3.1.1",
        "Names and forces of an aerofoil",
        "`rotor/bemt.py` and docs/explanation/polars.md use the same",
    ),
    ("fig-3.2", "result", "3.1.1", "Reynolds number and smooth or rough aerofoils", ""),
    (
        "fig-3.3",
        "sketch",
        "3.1.2",
        "Flow around a blade",
        "tip loss and finite chord in docs/explanation/bemt.md; the vortex itself in docs/explanation/wake.md",
    ),
    ("fig-3.4", "photograph", "3.1.2", "Tip vortices that condense", "ours are drawn in fig-3.18 and fig-3.19"),
    (
        "fig-3.5",
        "sketch",
        "3.1.3",
        "The lower rotor in the downwash of the upper",
        "`rotor.RotorSystem.coaxial_pair` (docs/explanation/coax.md)",
    ),
    ("fig-3.6", "result", "3.1.3", "Wakes of a coaxial pair, one in the other", ""),
    ("fig-3.7", "result", "3.1.4", "Gear ratio of muFly's drive", ""),
    (
        "fig-3.8",
        "photograph",
        "3.2.1",
        "Rotor test bench",
        "`mufly bench plan`, `run`, `analyse`, with a simulated rig or a real one (docs/reference/bench.md)",
    ),
    ("fig-3.9", "result", "3.2.1", "Motor current over the torque of a rotor", ""),
    ("fig-3.10", "photograph", "3.2.1", "Printed blades", "rotor files: `mufly rotor show naca0012-r60-c20`"),
    (
        "fig-3.11",
        "diagram",
        "3.2.1",
        "Wiring of the bench",
        "the drivers of `bench/`: one for each device of such a bench (docs/reference/bench.md)",
    ),
    ("fig-3.12", "sketch", "3.3.1", "Blade element", "`rotor/bemt.py`, eqs 3.6 to 3.10"),
    ("fig-3.13", "sketch", "3.3.1", "Annuli of momentum theory", "`rotor/bemt.py`, eq. 3.11"),
    (
        "fig-3.14",
        "diagram",
        "3.3.1",
        "How blade elements are iterated",
        "`rotor/bemt.py` finds the root of one residual instead (docs/explanation/bemt.md)",
    ),
    ("fig-3.15", "result", "3.3.1", "Blade elements beside the bench, three aerofoils", ""),
    (
        "fig-3.16",
        "sketch",
        "3.3.2",
        "Lifting line with horseshoe vortices",
        "`rotor/wake/lifting_surface.py`, eq. 3.14",
    ),
    ("fig-3.17", "result", "3.3.2", "Velocity of a straight vortex", ""),
    ("fig-3.18", "result", "3.3.2", "Wakes of one rotor and of a pair", ""),
    ("fig-3.19", "result", "3.3.2", "Velocities around a rotor by the vortex method", ""),
    ("fig-3.20", "result", "3.3.2", "Vortex method beside the bench, coaxial pair", ""),
    ("fig-3.21", "result", "3.3.3", "Domains and mesh of the CFD", ""),
    ("fig-3.22", "result", "3.3.3", "Height of the domain, and number of cells", ""),
    ("fig-3.23", "result", "3.3.3", "Pressure on the blade by CFD", ""),
    ("fig-3.24", "result", "3.3.3", "Velocities in the downwash by CFD", ""),
    ("fig-3.25", "result", "3.3.4", "Coefficients over the speed", ""),
    ("fig-3.26", "result", "3.4.1", "Number of blades", ""),
    ("fig-3.27", "result", "3.4.2", "Radius", ""),
    ("fig-3.28", "result", "3.4.2", "Chord", ""),
    ("fig-3.29", "result", "3.4.3", "Four-digit NACA sections", ""),
    ("fig-3.30", "result", "3.4.3", "Thickness", ""),
    ("fig-3.31", "result", "3.4.3", "Camber", ""),
    ("fig-3.32", "result", "3.4.3", "Place of the camber", ""),
    ("fig-3.33", "result", "3.4.3", "The four best airfoils of Table 3.3", ""),
    ("fig-3.34", "result", "3.4.3", "The four worst airfoils of Table 3.3", ""),
    ("fig-3.35", "result", "3.4.4", "Taper", ""),
    ("fig-3.36", "result", "3.4.4", "Twist", ""),
    (
        "fig-3.37",
        "sketch",
        "3.4.5",
        "Two tip shapes",
        "no sizes are given; `mufly cfd mesh naca0012-r60-c20 --tip thesis-1` meshes our guess, fig-3.38 has chords",
    ),
    ("fig-3.38", "result", "3.4.5", "Tip shapes", ""),
    (
        "fig-3.39",
        "sketch",
        "3.4.6",
        "Three winglets",
        "no sizes are given; `mufly cfd mesh naca0012-r60-c20 --tip winglet-1` meshes our guess (to winglet-3)",
    ),
    ("fig-3.40", "result", "3.4.6", "Winglets", ""),
    (
        "fig-3.41",
        "sketch",
        "3.4.6",
        "Gurney flap",
        "`load_airfoil('naca0012+gurney3')` (docs/explanation/polars.md); drawn in fig-3.42",
    ),
    ("fig-3.42", "result", "3.4.6", "Gurney flaps", ""),
    ("fig-3.43", "result", "3.4.7", "Coaxial pair at equal speeds", ""),
    ("fig-3.44", "result", "3.4.7", "Coaxial pair, one speed kept", ""),
    ("fig-3.45", "result", "3.4.7", "Distance of the rotors of a pair", ""),
    ("table-3.1", "result", "3.3.1", "What n_crit to take", ""),
    ("table-3.2", "result", "3.3.3", "Methods beside the bench at four points", ""),
    ("table-3.3", "result", "3.4.3", "247 airfoils on the standard blade", ""),
    ("table-3.4", "result", "3.4.7", "Coaxial pair with equal torques", ""),
    (
        "fig-4.1",
        "sketch",
        "4.1",
        "Axes and forces",
        "`dynamics/model_state.py`: the same axes; the thrust's direction: docs/thesis/thesis-errata.md, point 1",
    ),
    ("fig-4.2", "result", "4.3.1", "Coefficients over the climb", ""),
    (
        "fig-4.3",
        "sketch",
        "4.3.1",
        "Tilted thrust",
        "`dynamics/equations_of_motion.py`, eq. 4.14; its sign: docs/thesis/thesis-errata.md, point 1",
    ),
    ("fig-4.4", "result", "4.4.1", "Roll of 20 degrees, righted by the bar", ""),
    (
        "fig-4.5",
        "diagram",
        "4.5",
        "The dynamic model",
        "`dynamics/equations_of_motion.py` (docs/explanation/dynamics.md); its states are those of eq. 4.30",
    ),
    ("table-5.1", "result", "5.1", "Parameters known before any test", ""),
    ("table-5.2", "result", "5.2", "Parameters found on benches", ""),
    ("table-5.3", "result", "5.3.3", "All parameters", ""),
    ("fig-5.1", "result", "5.2", "Motor constants by least squares", ""),
    (
        "fig-5.2",
        "diagram",
        "5.3.2",
        "How flights are identified",
        "`identify.fit_flight_records` (docs/explanation/identification.md): the same loop, by least squares "
        "or by CMA-ES",
    ),
    ("fig-5.3", "result", "5.3.3", "Identified from flight: yaw", ""),
    ("fig-5.4", "result", "5.3.3", "Identified from flight: heave", ""),
    ("fig-5.5", "result", "5.3.3", "Identified from flight: roll", ""),
    ("fig-5.6", "result", "5.3.3", "Identified from flight: pitch", ""),
    ("fig-6.1", "diagram", "6.1.1", "Weights of an H-infinity design", "`control/hinf.py`"),
    (
        "fig-6.2",
        "diagram",
        "6.1.2",
        "Which controller moves what",
        "`control/law.py`: the same three controllers (docs/explanation/control.md)",
    ),
    ("fig-6.3", "result", "6.1.4", "Heave-yaw plant", ""),
    ("fig-6.4", "diagram", "6.1.4", "Scheme of two degrees of freedom", "`control.two_degree_plant`, eq. 6.3"),
    ("fig-6.5", "result", "6.1.4", "Heave-yaw loop", ""),
    ("fig-6.6", "diagram", "6.1.5", "Scheme of one degree of freedom", "`control.one_degree_plant`, eq. 6.5"),
    ("fig-6.7", "result", "6.1.5", "Roll-pitch plant", ""),
    ("fig-6.8", "result", "6.1.5", "Roll-pitch loop", ""),
    ("fig-6.9", "diagram", "6.1.6", "Position cascade", "`control/law.py`, `position_step`"),
    ("fig-6.10", "result", "6.1.8", "Step in heave, simulated", ""),
    ("fig-6.11", "result", "6.1.8", "Step in heave, measured there; flown on sensors here", ""),
    ("fig-6.12", "result", "6.1.8", "Following in pitch, simulated", ""),
    ("fig-6.13", "result", "6.1.8", "Following in pitch, measured there; flown on sensors here", ""),
    (
        "fig-6.14",
        "diagram",
        "6.2.1",
        "Structure of the high-level control",
        "`mission/` above `control/` (docs/explanation/architecture.md)",
    ),
    ("fig-6.15", "result", "6.2.1", "State machine of the mission", ""),
    ("fig-6.16", "result", "6.2.2", "Cubic spline in space", ""),
    ("fig-6.17", "result", "6.2.2", "Following waypoints", ""),
    ("fig-6.18", "result", "6.2.3", "Directions of the eight beams", ""),
    ("fig-6.19", "result", "6.2.3", "Repulsive forces", ""),
    ("fig-6.20", "result", "6.2.4", "Square track", ""),
)

THESIS_ITEMS: dict[str, ThesisItem] = {row[0]: ThesisItem(*row) for row in _ITEM_ROWS}
"""Name -> figure or table, chapter by chapter as listed above."""


def find_item(name: str) -> ThesisItem:
    """Return a figure or table by name; ``3.26`` and ``Fig. 3.26`` are understood too.

    Raises
    ------
    InputError
        If there is none.
    """
    text = name.strip().lower().replace(" ", "").replace("figure", "fig").replace("fig.", "fig-")
    for known in (text, f"fig-{text}", text.replace("fig", "fig-"), text.replace("table", "table-")):
        if known in THESIS_ITEMS:
            return THESIS_ITEMS[known]
    raise InputError(
        "thesis",
        name,
        "is no figure or table of the dissertation",
        "use a name of `mufly thesis list`, as fig-3.26",
    )
