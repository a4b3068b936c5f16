"""C toolchain: compiler of this machine, and shared libraries that are built once and cached on disk.

A library is stored beside Numba's compiled code (:mod:`mufly.compiled.numba_cache`) under a hash of its sources, flags
and compiler; a change leads to another file. It is written under a temporary name first, so that several processes can
build it at the same time.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from mufly.compiled.numba_cache import cache_folder
from mufly.errors import MuflyError
from mufly.files.answer_store import hash_inputs

COMPILER_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno")
"""Flags for results equal to the simulation; any -O level is valid, -ffast-math and contraction are not."""


def find_compiler() -> str:
    """Return the C compiler of this machine: ``$CC``, else cc, gcc or clang.

    Raises
    ------
    MuflyError
        If there is no compiler.
    """
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        found = shutil.which(name) if name else None
        if found:
            return found
    raise MuflyError(
        "there is no C compiler: install gcc or clang (Debian, Ubuntu: apt-get install gcc; macOS: xcode-select "
        "--install), or name one in the environment as CC"
    )


def compile_library(
    sources: Sequence[Path], out: Path, *, flags: Sequence[str] = COMPILER_FLAGS, cc: str | None = None
) -> None:
    """Build C sources as a shared library.

    Raises
    ------
    MuflyError
        If there is no compiler, or compilation fails; the message contains its first error.
    """
    command = [cc or find_compiler(), *flags, "-fPIC", "-shared", *map(str, sources), "-o", str(out), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
        raise MuflyError(f"{command[0]} could not build {out.parent}: {first}")


def build_cached_library(name: str, files: Mapping[str, str], *, flags: Sequence[str] = COMPILER_FLAGS) -> Path:
    """Return the shared library built from C sources; an earlier build of the same sources is used from the cache.

    Parameters
    ----------
    name : str
        First part of the file name.
    files : mapping
        Text of every source and header, by its path relative to the include folder; files ``.c`` are compiled.
    flags : sequence of str
        Compiler flags.

    Raises
    ------
    MuflyError
        If there is no compiler, or it refuses.
    """
    cc = find_compiler()
    real = Path(cc).resolve()
    stamp = (str(real), real.stat().st_size, real.stat().st_mtime_ns, *flags)
    digest = hash_inputs(stamp, sorted(files.items()))[:24]
    library = cache_folder() / f"{name}-{digest}.so"
    if not library.exists():
        with tempfile.TemporaryDirectory(prefix="mufly-c-", dir=library.parent) as temporary:
            folder = Path(temporary)
            for file, text in files.items():
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                (folder / file).write_text(text, encoding="utf-8")
            made = folder / library.name
            compile_library(sorted(folder.rglob("*.c")), made, flags=(*flags, f"-I{folder}"), cc=cc)
            os.replace(made, library)
    return library
