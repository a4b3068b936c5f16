"""An edited source is what runs: a change in a file that a compiled function only calls is seen at the next start."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numba.core.caching import CompileResultCacheImpl
from numba.core.errors import NumbaWarning

import mufly
from mufly.compiled import numba_cache
from mufly.compiled.numba_cache import imported_sources, view_record_as_array

PACKAGE = Path(mufly.__file__).parent

GAIN = "from mufly.compiled.numba_cache import cached_njit\nK = {k}\n\n\n@cached_njit\ndef gain(x):\n    return K * x\n"
LOOP = """from mufly.compiled.numba_cache import cached_njit
from mufly.gains import gain


@cached_njit
def loop(x):
    return gain(x) + 1.0


if __name__ == "__main__":
    from mufly.loops import loop as kept

    print(kept(2.0), sum(kept.stats.cache_hits.values()))
"""


def run(folder: Path) -> tuple[float, int]:
    env = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")}
    words = [sys.executable, "-m", "mufly.loops"]
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=True)
    value, hits = done.stdout.split()
    return float(value), int(hits)


def copied(folder: Path) -> Path:
    """A package with nothing but the decorator."""
    package = folder / "mufly"
    (package / "compiled").mkdir(parents=True)
    shutil.copy(PACKAGE / "compiled" / "numba_cache.py", package / "compiled")
    (package / "__init__.py").write_text("")
    return package


def test_a_constant_of_another_file_is_seen(tmp_path):
    package = copied(tmp_path)
    (package / "loops.py").write_text(LOOP)
    (package / "gains.py").write_text(GAIN.format(k=3.0))
    assert run(tmp_path) == (7.0, 0)
    assert run(tmp_path) == (7.0, 1), "what did not change is not compiled again"
    (package / "gains.py").write_text(GAIN.format(k=5.0))
    assert run(tmp_path) == (11.0, 0)
    (package / "gains.py").write_text(GAIN.format(k=3.0))
    assert run(tmp_path) == (7.0, 1), "the old sources have their old folder"


RECORD = """from typing import NamedTuple

from mufly.gains import gain


class Pair(NamedTuple):
    {fields}


if __name__ == "__main__":
    from mufly.loops import Pair as Kept

    print(gain(Kept(a=2.0, b=5.0)), sum(gain.stats.cache_hits.values()))
"""
OF_RECORD = """from mufly.compiled.numba_cache import cached_njit


@cached_njit
def gain(pair):
    return pair.a - pair.b
"""


def test_the_fields_of_a_record_that_a_caller_defines_are_seen(tmp_path):
    package = copied(tmp_path)
    (package / "gains.py").write_text(OF_RECORD)
    (package / "loops.py").write_text(RECORD.format(fields="a: float\n    b: float"))
    assert run(tmp_path) == (-3.0, 0)
    assert run(tmp_path) == (-3.0, 1)
    (package / "loops.py").write_text(RECORD.format(fields="b: float\n    a: float"))
    assert run(tmp_path) == (-3.0, 0)


def test_sources_follow_imports_through_rooms():
    found = {p.relative_to(PACKAGE).as_posix() for p in imported_sources(PACKAGE / "dynamics" / "simulation.py")}
    assert {
        "dynamics/simulation.py",
        "dynamics/equations_of_motion.py",
        "drive/drive_train.py",
        "vehicle/vehicle_schema.py",
    } <= found
    assert not any(name.startswith(("control/", "flight/", "link/")) for name in found)


def test_every_compiled_function_of_the_package_is_kept_by_its_sources():
    """Numba's own decorator with its own cache would run stale code again."""
    for path in PACKAGE.rglob("*.py"):
        if path.name != "numba_cache.py":
            assert "njit(cache" not in path.read_text(encoding="utf-8"), path


def test_a_function_that_cannot_be_kept_is_told():
    """Numba warns with the file's name from our locator."""
    locator = numba_cache._SourceHashCacheLocator(view_record_as_array, Path(numba_cache.__file__))
    compiled = SimpleNamespace(
        lifted=[], library=SimpleNamespace(has_dynamic_globals=True), fndesc=SimpleNamespace(qualname="m.gain")
    )
    with pytest.warns(NumbaWarning, match='Cannot cache compiled function "gain"'):
        CompileResultCacheImpl.check_cachable(SimpleNamespace(_locator=locator, _lineno=1), compiled)


def test_a_boxed_record_is_the_record():
    """What a flight changes in its gains while it flies is what the compiled control law sees."""
    whole = np.zeros(1, [("a", "f8"), ("b", "f8", 3)])
    record = whole[0]
    box = view_record_as_array(record)
    record["a"] = 3.0
    box["b"][0, 1] = 4.0
    assert box[0]["a"] == 3.0
    assert record["b"][1] == 4.0
