"""C functions from Python source: the same numbers in the same order of operations, and refusals of other forms."""

import ctypes
import math
from pathlib import Path

import numpy as np
import pytest

from mufly.compiled.toolchain import compile_library, find_compiler
from mufly.dynamics import PARAMETER_DTYPE
from mufly.errors import MuflyError
from mufly.fmi.c_translation import CTranslation
from mufly.fmi.c_types import C_DOUBLE, C_INT64, TableTupleType, TableType
from mufly.fmi.unit_sources import render_flight_model

_WEIGHT = 0.3
_ROWS = 3


def operate(a: float, b: float, c: float) -> float:
    d = a - (b - c) - a / (b / c) * -(a + b)
    d -= 2 * a - b * c
    return d if a < b and c != 0.5 else -d * _WEIGHT


def weigh_pair(a: float, n: int) -> tuple[int, float, float]:
    """Two numbers that change places, and an index."""
    b = a * a
    a, b = b - a, a + b
    if n > 2:
        a, b = b, a
    return n - 1, a, b


def nest(a: float) -> tuple[tuple[float, float], float]:
    return (a, a + 1.0), a + 2.0


def fill(x: np.ndarray, out: np.ndarray) -> None:
    work = np.empty((3, x.shape[0]))
    for k in range(_ROWS):
        for i in range(x.shape[0]):
            work[k, i] = x[i] * (k + 1)
    k, first, second = weigh_pair(x[0], 3)
    total = 0.0
    for i in range(1, x.shape[0]):
        if work[1, i] <= 0.0:
            continue
        bounded = min(max(work[2, i], -1.0), 1.0)
        total += bounded
    pair = nest(total)
    both = weigh_pair(total, 1)[1:3]
    out[0], out[1], out[2], out[3] = first, second, total, pair[0][1] + pair[1]
    out[4], out[5] = operate(x[0], x[1], x[2]), both[0] - both[1]
    out[6], out[7] = int(x[1] * 10.0) + k, max(x[2], 0.0)


def turn_matrix(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def walk(rows: np.ndarray, parts: tuple[np.ndarray, np.ndarray], out: np.ndarray) -> None:
    first, second = parts
    turn, n = turn_matrix(rows[0, 1]), rows.size // 4 - 1
    work = np.empty(n)
    work[0], work[1] = turn[0, 0] * rows[1, 0] + turn[0, 1] * rows[1, 1], n / 4
    for row in rows:
        part = row[1:]
        part[0] += first[0] ** 2
    k, total = 0, 0.0
    while True:
        k += 3
        if k & 4 == 4 or k // 2 > 7:
            total += (k - 11) % 4
        if not k < 20:
            break
    second[1] = (rows[1, 0] - 5.0) % 1.5 if 0.0 <= rows[1, 0] <= 1e9 and not math.isnan(total) else math.exp(-total)
    half = second[1:]
    for j in range(2):
        line = rows[j + 1 : j + 2]
        total += math.ceil(line[0, 1]) + np.rint(half[0])
    out[0], out[1], out[2], out[3] = work[0], work[1], total, second[1]


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    try:
        find_compiler()
    except MuflyError as error:
        pytest.skip(str(error))
    translation = CTranslation(PARAMETER_DTYPE, "record")
    made = translation.add_function(fill, [TableType(C_DOUBLE, (5,)), TableType(C_DOUBLE, (8,))])
    assert made.written == (False, True)
    folder: Path = tmp_path_factory.mktemp("c")
    translation.add_function(
        walk,
        [
            TableType(C_DOUBLE, (4, 3)),
            TableTupleType((TableType(C_DOUBLE, (1,)), TableType(C_DOUBLE, (2,)))),
            TableType(C_DOUBLE, (4,)),
        ],
    )
    text = "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n" + translation.render_c_source()
    (folder / "f.c").write_text(
        f"{text}\nvoid call_fill(const double *x, double *out) {{ fill(x, out); }}\n"
        "void call_walk(double (*x)[3], const double *a, double *b, double *out) { walk(x, a, b, out); }\n"
    )
    compile_library([folder / "f.c"], folder / "f.so")
    return ctypes.CDLL(str(folder / "f.so"))


def in_c(library: ctypes.CDLL, x: np.ndarray) -> np.ndarray:
    out = np.full(8, np.nan)
    library.call_fill(*(ctypes.c_void_p(a.ctypes.data) for a in (x, out)))
    return out


def test_c_gives_the_numbers_of_python(compiled: ctypes.CDLL) -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        x, out = rng.normal(0.0, 2.0, 5), np.empty(8)
        fill(x, out)
        assert np.array_equal(in_c(compiled, x), out)


def test_loops_parts_and_matrices_give_the_numbers_of_python(compiled: ctypes.CDLL) -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        x, b, out = rng.normal(1.0, 2.0, (4, 3)), rng.normal(0.0, 1.0, 2), np.empty(4)
        a = rng.normal(0.0, 1.0, 1)
        others = [v.copy() for v in (x, a, b, out)]
        walk(x, (a, b), out)
        compiled.call_walk(*(ctypes.c_void_p(v.ctypes.data) for v in others))
        for mine, other in zip((x, a, b, out), others, strict=True):
            assert np.array_equal(mine, other)


def test_numbers_that_are_none_leave_no_table(compiled: ctypes.CDLL) -> None:
    """As Numba, ``max`` keeps the first of two if one is not a number; an index that is none is 0."""
    out = in_c(compiled, np.array([1.0, math.nan, math.nan, 1.0, 1.0]))
    assert out[6] == 2.0
    assert math.isnan(out[7])
    assert in_c(compiled, np.array([1.0, 1e300, -0.0, 1.0, 1.0]))[6] == 2.0


def _with_list(a: float) -> float:
    return [a, a][0]


def _with_power(a: float) -> float:
    return a**3


def _with_two_kinds(a: float) -> float:
    n = 1
    n = 0.5 * a
    return n


def _with_whole_power(n: int) -> float:
    return n**2


@pytest.mark.parametrize("function", [_with_list, _with_power, _with_two_kinds, _with_whole_power])
def test_other_forms_are_refused(function: object) -> None:
    kind = C_INT64 if function is _with_whole_power else C_DOUBLE
    with pytest.raises(NotImplementedError, match="no C form of"):
        CTranslation(PARAMETER_DTYPE, "record").add_function(function, [kind])


def test_flight_model_names_its_sources() -> None:
    text = render_flight_model()
    for name in (
        "equations_of_motion.state_derivative",
        "simulation.integrate_state",
        "edgewise_loads.flight_map_loads",
    ):
        assert f"mufly.dynamics.{name}." in " ".join(text.split())
    assert "malloc" not in text
