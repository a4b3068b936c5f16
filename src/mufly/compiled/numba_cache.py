"""Cache of Numba functions whose key covers all imported sources.

Numba stores compiled functions on disk and recompiles only if the *file of the function* changes. Compiled code also
contains called functions and constants of other files, so that Numba's rule can leave outdated code in the cache.

Here the cache folder of a file is named after a hash of that file, of all files of this package that it imports
directly or indirectly, and of all named tuples of the package, because callers may pass them. A change leads to another
folder. Folders without use for :data:`UNUSED_CACHE_DAYS` days are removed. Equal sources share a folder across
checkouts and environments.

The root folder is ``NUMBA_CACHE_DIR`` if set, else the user's cache folder. If neither is writable, a temporary folder
is used, and functions are compiled at every start.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import os
import re
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np
import platformdirs
from numba.core import config
from numba.core.caching import CacheImpl, _CacheLocator
from numpy.typing import NDArray

# Idle threads of a parallel function sleep instead of spinning: a wake on a busy machine takes half the processor time.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # read when Numba loads its threads

UNUSED_CACHE_DAYS = 30.0
_PACKAGE_FOLDER = Path(__file__).resolve().parents[1]
_IMPORT_PATTERN = re.compile(r"^[ \t]*from (mufly[\w.]*) import (\([^)]*\)|[^\n]*)|^[ \t]*import (mufly[\w.]*)", re.M)
_NAMED_TUPLE_PATTERN = re.compile(r"^class \w+\((?:typing\.)?NamedTuple\):\n(?:[ \t]+[^\n]*\n|[ \t]*\n)*", re.M)
_IMPORT_LIST_ITEM_PATTERN = re.compile(r"(\w+)(?:\s+as\s+\w+)?\s*(?:,|$)", re.M)


def cached_njit(function: Any = None, **options: Any) -> Any:
    """Compile a function with Numba, cached on disk under a hash of its sources.

    Parameters
    ----------
    function : callable
        Decorated function; omit it to give options: ``@cached_njit(parallel=True)``.
    **options
        Options of :func:`numba.njit`. ``cache`` is on, and wrappers for C are off, which saves a tenth of compile time.
    """
    options = {"cache": True, "no_cfunc_wrapper": True, **options}
    return numba.njit(**options) if function is None else numba.njit(**options)(function)


def view_record_as_array(record: np.void) -> NDArray[np.void]:
    """Return an array of length 1 that shares a record's memory, for functions that are called in every period.

    Passing a record to a compiled function takes 2 to 4 microseconds per call, because NumPy lists the names of all its
    fields; that is ten times the rest of the call. Passing an array avoids this cost.
    """
    return np.asarray(record).reshape(1)


def imported_sources(file: Path) -> list[Path]:
    """Return the file and all files of this package that it imports directly or indirectly, sorted.

    A name imported from a subpackage counts as the file that defines it. Imports inside functions are included.
    """
    found: set[Path] = set()
    left = [file.resolve()]
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            left += [p for p in _imported_files(path) if p not in found]
    return sorted(found)


@functools.cache
def _imported_names(path: Path) -> tuple[tuple[str, str], ...]:
    """Return the imports of a file from this package as (module, name); the name is empty for a whole module."""
    found = []
    for module, names, whole in _IMPORT_PATTERN.findall(path.read_text(encoding="utf-8")):
        if whole:
            found.append((whole, ""))
        else:
            plain = re.sub(r"#[^\n]*", "", names.strip("()"))
            found += [(module, name) for name in _IMPORT_LIST_ITEM_PATTERN.findall(plain)]
    return tuple(found)


def _module_file(module: str) -> Path | None:
    path = _PACKAGE_FOLDER.joinpath(*module.split(".")[1:])
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if candidate.is_file() and path != _PACKAGE_FOLDER:
            return candidate
    return None


@functools.cache
def _imported_files(path: Path) -> tuple[Path, ...]:
    """Return the files of this package from which a file imports names, without the file itself."""
    found = []
    for module, name in _imported_names(path):
        file = (name and _module_file(f"{module}.{name}")) or _module_file(module)
        if file is None:
            continue
        if file.name == "__init__.py" and name and file != path:
            origins = [m for m, n in _imported_names(file) if n == name and _module_file(m) is not None]
            file = _module_file(origins[0]) if origins else file
        if file is not None and file != path:
            found.append(file)
    return tuple(found)


@functools.cache
def _file_digest(path: Path) -> bytes:
    """Return the digest of a file's path in the package and its content."""
    name = str(path.relative_to(_PACKAGE_FOLDER)).encode()
    return hashlib.sha256(name + b"\0" + path.read_bytes()).digest()


@functools.cache
def _named_tuple_sources() -> bytes:
    """Return the source of every named tuple of the package, because callers may pass them to compiled functions.

    The function's file does not import the caller's file, but the order of the fields is compiled into the code.
    """
    found = []
    for path in sorted(_PACKAGE_FOLDER.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if "NamedTuple" in text:
            found.append("\0".join([path.relative_to(_PACKAGE_FOLDER).as_posix(), *_NAMED_TUPLE_PATTERN.findall(text)]))
    return "\0".join(found).encode()


@functools.cache
def _source_digest(file: Path) -> str:
    digest = hashlib.sha256(numba.__version__.encode() + _named_tuple_sources())
    for path in imported_sources(file):
        digest.update(_file_digest(path))
    return digest.hexdigest()[:24]


@functools.cache
def cache_folder() -> Path:
    """Return the root folder of compiled code: the first writable folder of those in the module docstring."""
    for base in (getattr(config, "CACHE_DIR", ""), platformdirs.user_cache_dir("mufly")):
        if base:
            folder = Path(base) / "mufly-compiled"
            try:
                folder.mkdir(parents=True, exist_ok=True)
                tempfile.TemporaryFile(dir=folder).close()
            except OSError:
                continue
            return folder
    folder = Path(tempfile.mkdtemp(prefix="mufly-compiled-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@functools.cache
def _function_cache_folder(file: Path) -> Path:
    """Return the folder of one file's functions, created and marked as used; remove unused folders of that file."""
    name = ".".join(file.relative_to(_PACKAGE_FOLDER).with_suffix("").parts)
    folder = cache_folder() / f"{name}-{_source_digest(file)}"
    new = not folder.is_dir()
    folder.mkdir(exist_ok=True)
    os.utime(folder)
    if new:
        oldest = time.time() - 86400.0 * UNUSED_CACHE_DAYS
        for other in cache_folder().glob(f"{name}-*"):
            try:
                unused = other.stat().st_mtime < oldest
            except OSError:
                continue
            if unused:
                shutil.rmtree(other, ignore_errors=True)
    return folder


class _SourceHashCacheLocator(_CacheLocator):
    """Numba cache locator for the functions of this package."""

    def __init__(self, function: Any, file: Path) -> None:
        self._line = function.__code__.co_firstlineno
        self._file = file
        self._py_file = str(file)  # Numba's warnings read this name

    def get_cache_path(self) -> str:
        return str(_function_cache_folder(self._file))

    def get_source_stamp(self) -> str:
        return _source_digest(self._file)

    def get_disambiguator(self) -> str:
        return str(self._line)

    @classmethod
    def from_function(cls, function: Any, file: str) -> _SourceHashCacheLocator | None:
        path = Path(file).resolve()
        return cls(function, path) if path.is_relative_to(_PACKAGE_FOLDER) and path.is_file() else None


# Numba's list of cache locators; this one serves functions of this package only.
if not any(locator.__name__ == "_SourceHashCacheLocator" for locator in CacheImpl._locator_classes):
    CacheImpl._locator_classes.insert(0, _SourceHashCacheLocator)
