"""Store of computed answers on disk, for caching and for resumption of interrupted runs.

A file belongs to a question, the hash of all inputs of its answers (:func:`hash_inputs`). If answers depend on the
program version, the question includes it. There are three forms: a file with one answer (:func:`write_stored_result`,
:func:`read_stored_result`), a folder that belongs to one question (:func:`claim_folder`), and a file with a line for
each answer, written immediately (:class:`StoredResultLines`).

Files are replaced atomically (:func:`replace_file_atomically`), so processes may write the same answer at once.
A damaged file, or one of another question, raises an error if the caller gives its words; otherwise it is recomputed.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from platformdirs import user_cache_path

from mufly.errors import InputError, convert_write_errors

One = TypeVar("One")
Words = tuple[str, str]
"""Problem and remedy of an :class:`mufly.errors.InputError`."""

_UNREADABLE_ANSWER_ERRORS = (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile)


def cache_folder(room: str) -> Path | None:
    """Return the cache folder of a subpackage, or None if ``MUFLY_CACHE`` is ``off``.

    The environment variable ``MUFLY_CACHE`` overrides the platform's cache folder for mufly.
    """
    chosen = os.environ.get("MUFLY_CACHE", "")
    if chosen.lower() == "off":
        return None
    return (Path(chosen) if chosen else user_cache_path("mufly")) / room


def hash_inputs(*parts: object) -> str:
    """Return a hash of all inputs of a computation, which identifies its stored result.

    Arrays and bytes are hashed as they are, other values as JSON with sorted keys, or by ``repr`` if not JSON.
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            part = part.tobytes()
        raw = part if isinstance(part, bytes) else json.dumps(part, sort_keys=True, default=repr).encode()
        digest.update(raw + b"\0")
    return digest.hexdigest()


@contextmanager
def replace_file_atomically(path: Path, remedy: str = "give another place") -> Iterator[Path]:
    """Yield a temporary path that replaces ``path`` at the end of the block; create the folder if necessary.

    Raises
    ------
    InputError
        If the file cannot be written, with ``remedy`` in the message. The existing file is kept.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.part")
    try:
        with convert_write_errors(path, remedy):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield part
            os.replace(part, path)
    finally:
        if part.exists():
            part.unlink()


def write_stored_result(path: Path, question: str, content: Mapping[str, Any], *, indent: int | None = None) -> None:
    """Store the result of a computation with the hash of its inputs (``question``): arrays as ``.npz``, else JSON.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    whole = {"question": question, **content}
    with replace_file_atomically(path) as part:
        if path.suffix == ".npz":
            with part.open("wb") as file:
                np.savez(file, **whole)
        else:
            part.write_text(json.dumps(whole, indent=indent, default=lambda a: a.tolist()) + "\n", encoding="utf-8")


def read_stored_result(
    path: Path,
    question: str,
    *,
    damaged: Words | None = None,
    other: Words | None = None,
    where: Path | None = None,
) -> dict[str, Any] | None:
    """Read a stored result of :func:`write_stored_result`; None if it is missing, damaged or belongs to other inputs.

    Raises
    ------
    InputError
        If the file is damaged or of another question and the words ``damaged`` or ``other`` are given. ``where`` (by
        default the file) is the subject of the message.
    """
    if not path.is_file():
        return None
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                content = {name: arrays[name] for name in arrays.files}
        else:
            content = json.loads(path.read_text(encoding="utf-8"))
        found = str(content.pop("question"))
    except _UNREADABLE_ANSWER_ERRORS as error:
        if damaged is not None:
            raise InputError(str(where or path), "", *damaged) from error
        return None
    if found == question:
        return dict(content)
    if other is not None:
        raise InputError(str(where or path), "", *other)
    return None


def claim_folder(folder: Path, note: str, question: str, content: Mapping[str, Any], other: Words) -> None:
    """Reserve a folder for the results of one computation; the file ``note`` in it states the inputs.

    Raises
    ------
    InputError
        If the folder belongs to another question (with the words ``other``) or cannot be written.
    """
    read_stored_result(folder / note, question, damaged=other, other=other, where=folder)
    write_stored_result(folder / note, question, content, indent=2)


class StoredResultLines(Generic[One]):
    """File of computed results, one line of JSON each, written immediately; a truncated last line is removed.

    Parameters
    ----------
    path : Path, optional
        Path of the file; None keeps answers in memory only.
    read : callable
        Function that returns key and answer from the content of a line.
    question : str
        Question in the first line; if empty, the file has no such line.
    other : (problem, remedy), optional
        Words for the file of another question; required with ``question``.
    damaged : (problem, remedy), optional
        Words for a line that cannot be read. None: lines from there on are recomputed.

    Attributes
    ----------
    known : dict
        Answers by key.

    Raises
    ------
    InputError
        If the file belongs to another question, is damaged, or cannot be written.
    """

    def __init__(
        self, path: Path | None, read: Callable[[Any], tuple[Any, One]], *, question: str = "",
        other: Words = ("holds other answers", "give another file"), damaged: Words | None = None,
    ) -> None:  # fmt: skip
        self.known: dict[Any, One] = {}
        self._path = path
        if path is None:
            return
        head = [json.dumps({"question": question}).encode()] if question else []
        with convert_write_errors(path, "give another place"):
            lines = path.read_bytes().split(b"\n") if path.is_file() else [*head, b""]
            if lines[: len(head)] != head:
                raise InputError(str(path), "", *other)
            kept, cut = lines[:-1], lines[-1:] != [b""]
            for k, line in enumerate(lines[len(head) : -1], len(head)):
                try:
                    key, one = read(json.loads(line))
                except _UNREADABLE_ANSWER_ERRORS:
                    if damaged is not None:
                        raise InputError(str(path), f"line {k + 1}", *damaged) from None
                    kept, cut = lines[:k], True
                    break
                self.known[key] = one
            if cut or (head and not path.is_file()):
                with replace_file_atomically(path) as part:
                    part.write_bytes(b"".join(line + b"\n" for line in kept))

    def append_result(self, key: Any, one: One, content: Any) -> None:
        """Store a result: append ``content`` to the file as a line of JSON, and keep ``one`` as ``known[key]``."""
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(content) + "\n")
        self.known[key] = one

    def delete_file(self) -> None:
        """Delete the file with its results."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
