"""The methods of controller synthesis, with one result for all: a controller, its anti-windup input and its levels.

All methods start from the same scaled plant and the same generalised plant, so their loops compare. The methods that do
not minimise the H-infinity norm have that norm all the same: it is computed from their loop.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import control
import numpy as np

from mufly.control.h2 import h2syn
from mufly.control.hinf import close_loop, hinfsyn
from mufly.control.linear_systems import Array, hinf_norm
from mufly.control.lqg import LqgWeights, design_lqg, limit_recovery

SynthesisMethod = Literal["hinf", "h2", "lqg", "ltr"]
METHODS: tuple[SynthesisMethod, ...] = get_args(SynthesisMethod)
METHOD_NAMES: dict[SynthesisMethod, str] = {
    "hinf": "H-infinity",
    "h2": "H2",
    "lqg": "LQG",
    "ltr": "LQG/LTR",
}


class SynthesisProblem(NamedTuple):
    """One loop to design, in scaled units.

    Attributes
    ----------
    generalised : control.StateSpace
        Plant with weights; its last outputs and inputs are those of the controller.
    plant : control.StateSpace
        Plant without weights.
    references : tuple of int
        Outputs of the plant with a reference.
    two_degrees : bool
        Whether the controller reads references and errors apart.
    n_measurements : int
        Number of the controller's inputs.
    relaxation : float
        Factor on the smallest H-infinity level; see ``hinfsyn``.
    lqg : LqgWeights or None
        Weights of LQG and LTR.
    sampling_rate : float
        Sampling rate of the controller (rad/s).
    """

    generalised: control.StateSpace
    plant: control.StateSpace
    references: tuple[int, ...]
    two_degrees: bool
    n_measurements: int
    relaxation: float
    lqg: LqgWeights | None
    sampling_rate: float


class SynthesisedController(NamedTuple):
    """A controller in scaled units.

    Attributes
    ----------
    controller : control.StateSpace
    actuation : array, shape (states, controls)
        Effect of actuation beyond the command on its states; see ``hinf.HinfResult.actuation``.
    gamma, gamma_optimal : float
        Level claimed and smallest level; nan for a method that claims none.
    norm : float
        H-infinity norm of the weighted loop.
    """

    controller: control.StateSpace
    actuation: Array
    gamma: float
    gamma_optimal: float
    norm: float


def synthesise_controller(method: SynthesisMethod, problem: SynthesisProblem) -> SynthesisedController:
    """Return a controller of full order by a method; LQG without weights falls back on H-infinity.

    Raises
    ------
    MuflyError
        If the method finds no controller; the message names what is in the way.
    """
    p, n_controls = problem, problem.plant.ninputs
    if method == "h2":
        optimal = h2syn(p.generalised, p.n_measurements, n_controls)
        norm = hinf_norm(optimal.closed_loop)[0]
        return SynthesisedController(optimal.controller, optimal.actuation, np.nan, np.nan, norm)
    if method in ("lqg", "ltr") and p.lqg is not None:
        recovery = limit_recovery(p.plant, p.lqg, p.sampling_rate) if method == "ltr" else None
        lqg = design_lqg(p.plant, p.references, p.lqg, recovery=recovery, two_degrees=p.two_degrees)
        norm = hinf_norm(close_loop(p.generalised, lqg.controller))[0]
        return SynthesisedController(lqg.controller, lqg.actuation, np.nan, np.nan, norm)
    found = hinfsyn(p.generalised, p.n_measurements, n_controls, relaxation=p.relaxation)
    return SynthesisedController(found.controller, found.actuation, found.gamma, found.gamma_optimal, found.norm)
