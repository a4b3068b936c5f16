"""Selection of the filter's implementation: the C code that flies on board, or Numba, with equal results.

The C sources of :mod:`mufly.firmware` are a manual translation of this package's compiled functions with results equal
bit for bit (``tests/firmware/test_estimate_c.py``). A C compiler needs a second or two, Numba half a
minute; both results are cached on disk. C is used in double precision if a compiler exists and the Python sources have
the stamp of the last proof of equality (:data:`VERIFIED_STAMP`). After a change of these sources Numba is used until C
is updated.

``MUFLY_ESTIMATOR=numba`` or ``c`` in the environment selects the implementation.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import os
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mufly.compiled import portable_math
from mufly.compiled.toolchain import COMPILER_FLAGS, build_cached_library
from mufly.drive import drive_train
from mufly.dynamics import equations_of_motion, model_parameters
from mufly.errors import MuflyError
from mufly.estimate.filter import (
    ekf_step,
    filter_horizon,
    filter_inputs,
    output_predictor,
    strapdown,
    ud_filter,
)
from mufly.estimate.filter.c_records import RECORDS_HEADER_PATH, flight_model_record, render_records_header
from mufly.estimate.filter.measurements import (
    fix_fusion,
    fusion,
    scalar_fusion,
    sensor_checks,
)
from mufly.rotor import coax_maps
from mufly.vehicle import Vehicle

VERIFIED_STAMP = "6f263f5eb5495a3b"
"""Stamp (:func:`source_stamp`) of the Python sources that the C code is verified to equal."""

FILTER_SOURCES = (
    "estimate/filter/ekf_step",
    "estimate/filter/filter_inputs",
    "estimate/filter/filter_horizon",
    "estimate/filter/output_predictor",
    "estimate/filter/measurements/fusion",
    "estimate/filter/measurements/fix_fusion",
    "estimate/filter/measurements/scalar_fusion",
    "estimate/filter/measurements/sensor_checks",
    "estimate/filter/ud_filter",
    "estimate/filter/strapdown",
    "dynamics/flight_model",
    "real",
)
"""C source files of the filter with a header each, in ``firmware/sources``."""
_SOURCE_FOLDER = Path(__file__).resolve().parents[1] / "firmware" / "sources"
_BACKEND_VARIABLE = "MUFLY_ESTIMATOR"
_C_DECLARATIONS = """
void estimator_reset(void *m, const void *s);
_Bool estimator_step(void *m, const void *s, const void *p, double *z, int32_t *fresh, const double *age);
"""


BackendName = Literal["", "c", "numba"]


@dataclass(frozen=True)
class FilterBackend:
    """An implementation of the filter's step.

    Attributes
    ----------
    name : str
        ``"C"`` or ``"Numba"``.
    selection_reason : str
        Reason for not using C; empty with C.
    reset_memory : callable
        Resets the memory.
    step_filter : callable
        Steps the memory; returns whether the estimate is valid. Readings, flags of new readings, and their ages are in
        the arrays passed to :func:`make_backend`.
    function_addresses : tuple of int
        With C, addresses of its step and of the records of settings and flight model, for other compiled code.
    settings : record
        Settings, read in every step.
    """

    name: str
    selection_reason: str
    reset_memory: Callable[[np.ndarray], None]
    step_filter: Callable[[np.ndarray], bool]
    function_addresses: tuple[int, ...] = ()
    settings: Any = None


def make_backend(
    settings: Any, parameters: Any, z: np.ndarray, new: np.ndarray, age: np.ndarray, code: BackendName = ""
) -> FilterBackend:
    """Return the implementation of the filter's step.

    Parameters
    ----------
    settings, parameters : records
        Settings of the filter (:func:`mufly.estimate.filter.filter_records.make_filter_settings`); parameters of the
        flight model.
    z, new, age : arrays
        Input arrays, which the caller fills in every period (:func:`mufly.estimate.filter.ekf_step.estimator_step`).
    code : "", "c" or "numba"
        Implementation; ``""``: from the environment, or else C if available.

    Raises
    ------
    MuflyError
        If C is requested but unavailable.
    """
    asked = code or os.environ.get(_BACKEND_VARIABLE, "")
    why = _reason_against_c(asked, z.dtype)
    if not why:
        try:
            return make_c_backend(settings, parameters, z, new, age)
        except (MuflyError, OSError) as error:
            if asked == "c":
                raise MuflyError(f"the estimator in C: {error}") from None
            why = str(error)

    def step_with_numba(memory: np.ndarray) -> bool:
        return bool(ekf_step.estimator_step(memory[0], settings, parameters, z, new, age))

    return FilterBackend(
        "Numba",
        why,
        lambda memory: ekf_step.estimator_reset(memory[0], settings),
        step_with_numba,
        settings=settings,
    )


def explain_numba_choice(vehicle: Vehicle) -> str:
    """Return why a vehicle's filter uses Numba; "" if it uses C, which is built if needed."""
    asked = os.environ.get(_BACKEND_VARIABLE, "")
    why = _reason_against_c(asked, np.float64)
    if not why:
        try:
            _load_filter_library(render_records_header(model_parameters(vehicle)))
        except (MuflyError, OSError) as error:
            why = str(error)
    return why


def _reason_against_c(asked: str, kind: Any) -> str:
    """Return the reason for not using C, as far as it is known before a build; "" to use C."""
    if asked == "numba":
        return f"Numba is selected by {_BACKEND_VARIABLE} or by code"
    if kind != np.float64:
        return "single precision"
    if asked != "c" and source_stamp() != VERIFIED_STAMP:
        return "the filter's Python sources differ from those that its C code was verified to equal"
    return ""


def make_c_backend(
    settings: Any,
    parameters: Any,
    z: np.ndarray,
    new: np.ndarray,
    age: np.ndarray,
    flags: tuple[str, ...] = COMPILER_FLAGS,
) -> FilterBackend:
    """Return the C implementation, as :func:`make_backend` does, built with these flags.

    Raises
    ------
    MuflyError
        If there is no compiler.
    """
    ffi, lib = _load_filter_library(render_records_header(parameters), flags)
    # Records and structs share their bytes; ffi keeps references to the arrays.
    own = np.array([settings])
    s = ffi.from_buffer(own)
    p = ffi.from_buffer(flight_model_record(parameters))
    values, fresh, ages = (
        ffi.from_buffer("double[]", z),
        ffi.from_buffer("int32_t[]", new),
        ffi.from_buffer("double[]", age),
    )
    begin, advance, view = lib.estimator_reset, lib.estimator_step, ffi.from_buffer
    held: list[Any] = [None, None]

    def step_in_c(memory: np.ndarray) -> bool:
        if held[0] is not memory:
            held[:] = memory, view(memory)
        return advance(held[1], s, p, values, fresh, ages)

    place = tuple(int(ffi.cast("uintptr_t", p)) for p in (ffi.addressof(lib, "estimator_step"), s, p))
    return FilterBackend("C", "", lambda memory: begin(view(memory), s), step_in_c, place, settings=own[0])


@functools.lru_cache(maxsize=8)
def _load_filter_library(records: str, flags: tuple[str, ...] = COMPILER_FLAGS) -> tuple[Any, Any]:
    import cffi  # imported here: not needed without a compiler

    ffi = cffi.FFI()
    ffi.cdef(_C_DECLARATIONS)
    return ffi, ffi.dlopen(str(build_cached_library("estimate", collect_filter_sources(records), flags=flags)))


def collect_filter_sources(records: str) -> dict[str, str]:
    """Return the text of the filter's C sources and headers by their path in a tree."""
    names = [f"{name}.{suffix}" for name in FILTER_SOURCES for suffix in "ch"]
    return {RECORDS_HEADER_PATH: records} | {n: (_SOURCE_FOLDER / n).read_text(encoding="utf-8") for n in names}


_TRANSLATED_MODULES: tuple[tuple[types.ModuleType, tuple[str, ...]], ...] = (
    *(
        (module, ())
        for module in (
            ekf_step,
            filter_inputs,
            filter_horizon,
            output_predictor,
            fusion,
            fix_fusion,
            scalar_fusion,
            sensor_checks,
            ud_filter,
            strapdown,
        )
    ),
    (portable_math, ("sine_cosine", "portable_atan2", "wrap_angle", "floor_int")),
    (
        equations_of_motion,
        (
            "state_derivative_from_tilt_sines",
            "_derivative_with_map",
            "compute_battery_supply",
            "interpolate_coefficient_map",
            "compute_axial_climb_velocity",
            "_inplane_drag",
            "_clip_value",
        ),
    ),
    (drive_train, ("armature_current", "rotor_acceleration", "interpolate_table", "terminal_voltage")),
    (coax_maps, ("interpolate_coefficient_tables", "_cubic_weights")),
)
"""Modules with a C translation, and the names of the translated functions (empty: all compiled ones)."""


@functools.cache
def source_stamp() -> str:
    """Return a hash of the Python functions that are translated to C, independent of layout and comments.

    Module constants are excluded, since C gets them by code generation.
    """
    digest = hashlib.sha256()
    for module, names in _TRANSLATED_MODULES:
        for node in ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and (node.name in names if names else node.decorator_list):
                digest.update("\0".join(_node_tokens(node)).encode())
    return digest.hexdigest()[:16]


def _node_tokens(function: ast.FunctionDef) -> Iterator[str]:
    """Return the node kinds, names and numbers of a function, without its docstring."""
    yield from (function.name, *(argument.arg for argument in function.args.args))
    body = function.body[1:] if ast.get_docstring(function, clean=False) is not None else function.body
    for part in body:
        for node in ast.walk(part):
            yield type(node).__name__
            yield from (repr(v) for k, v in ast.iter_fields(node) if isinstance(v, (str, int, float)) and k != "kind")
