"""Store of controllers whose synthesis takes long, so that a design is computed once and an interrupted run resumes.

The name of a file contains the hash of all inputs of the synthesis (:func:`hash_synthesis_problem`): plants, weights,
goals, and source files.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path

import control
import numpy as np

from mufly.compiled.numba_cache import imported_sources
from mufly.control.linear_systems import state_space
from mufly.control.synthesis.synthesis_methods import SynthesisedController, SynthesisMethod, SynthesisProblem
from mufly.files.answer_store import cache_folder, hash_inputs, read_stored_result, write_stored_result

STORED_METHODS: tuple[SynthesisMethod, ...] = ("mu", "fixed", "scheduled")
"""Methods that take seconds to minutes."""
_STORED_SCALARS = ("gamma", "gamma_optimal", "norm")


@cache
def _hash_synthesis_sources() -> str:
    libraries = [f"{name} {version(name)}" for name in ("numpy", "scipy")]
    sources = imported_sources(Path(__file__).parent / "synthesis" / "synthesis_methods.py")
    return hash_inputs(libraries, *(path.read_bytes() for path in sources))


def hash_synthesis_problem(method: SynthesisMethod, problem: SynthesisProblem) -> str:
    """Return a hash of all inputs that determine the controller of a method."""
    p = problem

    def shapes_and_matrices(system: control.StateSpace) -> list[object]:
        return [M for A in (system.A, system.B, system.C, system.D) for M in (A.shape, np.ascontiguousarray(A))]

    return hash_inputs(
        _hash_synthesis_sources(), method, *shapes_and_matrices(p.generalised_plant), *shapes_and_matrices(p.plant),
        p.referenced_outputs, p.two_degrees, p.n_measurements, p.relaxation,
        repr(p.lqg), repr(p.fixed), p.sampling_rate_rad_s, repr(p.robust),
        *(np.ascontiguousarray(E) for E in p.derivatives),
        *(() if p.given_controller is None else shapes_and_matrices(p.given_controller)),
    )  # fmt: skip


def load_or_compute_controller(
    method: SynthesisMethod,
    problem: SynthesisProblem,
    compute: Callable[[SynthesisMethod, SynthesisProblem], SynthesisedController],
) -> SynthesisedController:
    """Return the controller of a method, from the store if it holds it; otherwise compute it and store it.

    Only :data:`STORED_METHODS` are stored.
    """
    folder = cache_folder("control")
    taken = problem.given_controller is not None and method != "scheduled"
    if folder is None or taken or method not in STORED_METHODS:
        return compute(method, problem)
    question = hash_synthesis_problem(method, problem)
    path = folder / f"{method}-{question[:24]}.npz"
    kept = read_stored_result(path, question)
    if kept is None:
        found = compute(method, problem)
        K = found.controller
        numbers = {name: np.array(getattr(found, name)) for name in _STORED_SCALARS}
        write_stored_result(
            path, question, {"A": K.A, "B": K.B, "C": K.C, "D": K.D, "actuation": found.anti_windup_matrix, **numbers}
        )
        return found
    n, m = problem.n_measurements, problem.plant.ninputs
    K = state_space(
        *(kept[name] for name in "ABCD"),
        inputs=problem.generalised_plant.output_labels[-n:], outputs=problem.generalised_plant.input_labels[-m:],
    )  # fmt: skip
    return SynthesisedController(K, kept["actuation"], *(float(kept[name]) for name in _STORED_SCALARS))
