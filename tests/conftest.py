"""Keeps Numba's cache honest, and Hypothesis repeatable and without a clock.

A cached function is compiled again when its own file changes, but not when a function that it calls in another file
does. So the cache of a test run lies in a folder named after the whole package's source.
"""

import hashlib
import os
import shutil
import sys
import time
from pathlib import Path

from hypothesis import settings

_ROOT = Path(__file__).resolve().parents[1]


def _cache_folder() -> Path:
    """Folder of this source's cache; folders of other sources are deleted once nobody used them for a day."""
    digest = hashlib.sha256(sys.version.encode())
    source = _ROOT / "src" / "mufly"
    for path in sorted(source.rglob("*.py")):
        digest.update(str(path.relative_to(source)).encode() + b"\0" + path.read_bytes())
    base = _ROOT / ".pytest_cache" / "numba"
    folder = base / digest.hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    os.utime(folder)
    for other in base.iterdir():
        if other != folder and time.time() - other.stat().st_mtime > 86400:
            shutil.rmtree(other, ignore_errors=True)
    return folder


if "numba" in sys.modules:
    raise RuntimeError("numba was imported before tests/conftest.py could set its cache folder")
os.environ["NUMBA_CACHE_DIR"] = str(_cache_folder())

# A first call compiles, so an example may take seconds; and a red suite has to be red again on the next run.
settings.register_profile("mufly", deadline=None, derandomize=True)
settings.load_profile("mufly")
