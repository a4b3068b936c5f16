"""Drivers of a board, built for this machine with models in place of its hardware, and called from tests."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cffi
import pytest

from mufly.compiled.toolchain import compile_library
from mufly.firmware.export.source_export import copy_sources, find_sources

COMPILERS = [c for c in ("cc", "gcc", "clang") if shutil.which(c)]
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror")
TRAPS = ("-fsanitize=bounds", "-fsanitize-undefined-trap-on-error")  # an index beyond its array ends the process
needs_cc = pytest.mark.skipif(not COMPILERS, reason="no C compiler: install gcc or clang")


def load_drivers(folder: Path, sources: Iterable[str], headers: Iterable[str], *flags: str) -> tuple[cffi.FFI, Any]:
    """Build a library in an empty folder; return the interface of the headers, and the library.

    ``sources`` are patterns, ``headers`` names without ending, both in the tree of an export.
    """
    copy_sources(folder)
    given = [*STRICT, *flags]
    built = folder / "drivers.so"
    compile_library(find_sources(folder, sources), built, flags=(*given, *TRAPS, "-O1", f"-I{folder}"), cc=COMPILERS[0])
    said = subprocess.run(
        [COMPILERS[0], "-E", "-DMUFLY_DECLARATIONS", *given, "-I.", "-x", "c", "-"],
        cwd=folder, input="".join(f'#include "{name}.h"\n' for name in headers), capture_output=True, text=True,
        check=True,
    ).stdout  # fmt: skip
    ffi = cffi.FFI()
    ffi.cdef(_read_declarations(said))
    return ffi, ffi.dlopen(str(built))


def _read_declarations(preprocessed: str) -> str:
    """Return the declarations of the tree's own headers: cffi knows this machine's types, no bodies of functions."""
    ours, kept = False, []
    for line in preprocessed.splitlines():
        place = re.match(r'# \d+ "(.*?)"', line)
        if place:
            ours = not place[1].startswith(("/", "<"))
        elif ours:
            kept.append(line)
    text = re.sub(r"static inline[^{]*{.*?\n}", "", "\n".join(kept), flags=re.DOTALL)
    return text.replace("extern const ", "extern ")  # cffi gives no address of a constant
