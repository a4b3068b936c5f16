"""Compiled functions that always are what their source says.

Numba keeps compiled functions on disk and compiles anew when the *file of the function* has changed. A
function also holds what it calls and the constants it reads, and those come from other files: with Numba's
own rule, a term added to the equations of motion was seen by whoever called them directly, while the
integrator that had compiled them in went on as before.

Here the cache of a file is kept in a folder named after a hash of that file and of every file of this package
that it imports, directly or through others, and of every named tuple of the package, since a caller may hand
one over. Any change there leads to another folder; nothing needs to be deleted. Folders that no process has
used for :data:`UNUSED_CACHE_DAYS` days are removed. The same sources share a folder, in whichever checkout or
environment they stand.

The folder is ``NUMBA_CACHE_DIR`` where that is set, else the user's cache folder; where neither can be
written, a temporary one, which costs compiling at every start.
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

UNUSED_CACHE_DAYS = 30.0
_PACKAGE_FOLDER = Path(__file__).resolve().parent
_IMPORT_PATTERN = re.compile(r"^[ \t]*from (mufly[\w.]*) import (\([^)]*\)|[^\n]*)|^[ \t]*import (mufly[\w.]*)", re.M)
_NAMED_TUPLE_PATTERN = re.compile(r"^class \w+\((?:typing\.)?NamedTuple\):\n(?:[ \t]+[^\n]*\n|[ \t]*\n)*", re.M)
_IMPORT_LIST_ITEM_PATTERN = re.compile(r"(\w+)(?:\s+as\s+\w+)?\s*(?:,|$)", re.M)


def cached_njit(function: Any = None, **options: Any) -> Any:
    """Compile a function with Numba, kept on disk under a hash of its sources.

    Parameters
    ----------
    function : callable
        What is decorated; leave it out to give options: ``@compiled(parallel=True)``.
    **options
        Those of :func:`numba.njit`; ``cache`` is on, and nothing is made for callers in C: a tenth of compiling.
    """
    options = {"cache": True, "no_cfunc_wrapper": True, **options}
    return numba.njit(**options) if function is None else numba.njit(**options)(function)


def record_as_array(record: np.void) -> NDArray[np.void]:
    """Return an array of one that shares a record's memory, for functions that are called in every period.

    A compiled function that is handed a record asks NumPy for its memory, and NumPy answers by spelling out the names
    of all its fields anew: 2 to 4 microseconds a call, ten times the rest of the call. An array says where it lies.
    """
    return np.asarray(record).reshape(1)


def imported_sources(file: Path) -> list[Path]:
    """Return the file and all files of this package that it imports, directly or through others, sorted.

    A name imported from a room leads to the file that defines it, not to the whole room. Imports inside
    functions count.
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
    """Return what a file imports from this package: (module, name), the name empty for a whole module."""
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
    """Files of this package that a file imports names from, itself excluded."""
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
    """Digest of where a file stands in the package and of what it holds."""
    name = str(path.relative_to(_PACKAGE_FOLDER)).encode()
    return hashlib.sha256(name + b"\0" + path.read_bytes()).digest()


@functools.cache
def _named_tuple_sources() -> bytes:
    """Source of every named tuple of the package: whoever calls a compiled function may hand it one.

    The caller's file is none that the function's file imports, yet the order of the fields is compiled in.
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
    """Return the folder in which compiled code is kept: the first of those named above that can be written."""
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
    """Return the folder of one file's functions, made and marked as used; long unused ones of that file go."""
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


class _BySource(_CacheLocator):
    """Tells Numba where a function of this package is kept, and what it was made from."""

    def __init__(self, function: Any, file: Path) -> None:
        self._line = function.__code__.co_firstlineno
        self._file = file

    def get_cache_path(self) -> str:
        return str(_function_cache_folder(self._file))

    def get_source_stamp(self) -> str:
        return _source_digest(self._file)

    def get_disambiguator(self) -> str:
        return str(self._line)

    @classmethod
    def from_function(cls, function: Any, file: str) -> _BySource | None:
        path = Path(file).resolve()
        return cls(function, path) if path.is_relative_to(_PACKAGE_FOLDER) and path.is_file() else None


# The one place where Numba looks a folder up; only functions of this package are answered here.
if not any(locator.__name__ == "_BySource" for locator in CacheImpl._locator_classes):
    CacheImpl._locator_classes.insert(0, _BySource)
