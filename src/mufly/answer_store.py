"""Answers kept on disk: a question is computed once, and a run that was stopped resumes.

A kept file belongs to a question, the hash of everything that its answers depend on (:func:`hash_question`); a question
that can change with the program names the program's version. Three forms serve every room: a file with one answer
(:func:`write_answer`, :func:`read_answer`), a folder that belongs to one question (:func:`claim_folder`), and a file
that gets a line for each answer as it comes (:class:`AnswerLines`).

A file appears whole or not at all (:func:`replace_file`), so processes that write the same answer at once are safe. A
file that is damaged or answers another question is refused with one line where the caller gives its words, and else
computed anew.
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

from mufly.errors import InputError, report_write_errors

One = TypeVar("One")
Words = tuple[str, str]
"""Problem and remedy of an :class:`mufly.errors.InputError`."""

_FAULTS = (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile)


def cache_folder(room: str) -> Path | None:
    """Return the folder in which a room keeps answers for every later run, or None where ``MUFLY_CACHE`` is ``off``.

    The environment variable ``MUFLY_CACHE`` names another folder than the platform's cache folder for mufly.
    """
    chosen = os.environ.get("MUFLY_CACHE", "")
    if chosen.lower() == "off":
        return None
    return (Path(chosen) if chosen else user_cache_path("mufly")) / room


def hash_question(*parts: object) -> str:
    """Return the hash of everything that an answer depends on.

    Arrays and bytes count bit by bit, the rest by its JSON with sorted keys, or by ``repr`` where JSON has no form.
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            part = part.tobytes()
        raw = part if isinstance(part, bytes) else json.dumps(part, sort_keys=True, default=repr).encode()
        digest.update(raw + b"\0")
    return digest.hexdigest()


@contextmanager
def replace_file(path: Path, remedy: str = "give another place") -> Iterator[Path]:
    """Yield a temporary path beside ``path``, in a folder made if need be, that replaces it at the end of the block.

    Raises
    ------
    InputError
        If the file cannot be written; ``remedy`` says what to do. The file that was there stays.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.part")
    try:
        with report_write_errors(path, remedy):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield part
            os.replace(part, path)
    finally:
        if part.exists():
            part.unlink()


def write_answer(path: Path, question: str, content: Mapping[str, Any], *, indent: int | None = None) -> None:
    """Write the answer to a question: arrays as ``.npz``, else JSON.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    whole = {"question": question, **content}
    with replace_file(path) as part:
        if path.suffix == ".npz":
            with part.open("wb") as file:
                np.savez(file, **whole)
        else:
            part.write_text(json.dumps(whole, indent=indent, default=lambda a: a.tolist()) + "\n", encoding="utf-8")


def read_answer(
    path: Path,
    question: str,
    *,
    damaged: Words | None = None,
    other: Words | None = None,
    where: Path | None = None,
) -> dict[str, Any] | None:
    """Read what :func:`write_answer` wrote; None if it is not there, damaged or the answer to another question.

    Raises
    ------
    InputError
        With the words ``damaged`` or ``other``, where they are given, about ``where`` (by default the file).
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
    except _FAULTS as error:
        if damaged is not None:
            raise InputError(str(where or path), "", *damaged) from error
        return None
    if found == question:
        return dict(content)
    if other is not None:
        raise InputError(str(where or path), "", *other)
    return None


def claim_folder(folder: Path, note: str, question: str, content: Mapping[str, Any], other: Words) -> None:
    """Make a folder the place of the answers to a question, with a file ``note`` that says so.

    Raises
    ------
    InputError
        If it belongs to another question (with the words ``other``) or cannot be written.
    """
    read_answer(folder / note, question, damaged=other, other=other, where=folder)
    write_answer(folder / note, question, content, indent=2)


class AnswerLines(Generic[One]):
    """Answers in a file, a line of JSON each, written as they come; a last line that was cut off is taken away.

    Parameters
    ----------
    path : Path, optional
        None: answers are kept in memory only.
    read : callable
        Returns the key of an answer and the answer itself, from the content of a line.
    question : str
        Written in the first line; empty: the file has no such line.
    other : (problem, remedy), optional
        Words for the file of another question; needed with ``question``.
    damaged : (problem, remedy), optional
        Words for a line that cannot be read. None: what stands from there on is computed anew.

    Attributes
    ----------
    known : dict
        Key to answer.

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
        with report_write_errors(path, "give another place"):
            lines = path.read_bytes().split(b"\n") if path.is_file() else [*head, b""]
            if lines[: len(head)] != head:
                raise InputError(str(path), "", *other)
            kept, cut = lines[:-1], lines[-1:] != [b""]
            for k, line in enumerate(lines[len(head) : -1], len(head)):
                try:
                    key, one = read(json.loads(line))
                except _FAULTS:
                    if damaged is not None:
                        raise InputError(str(path), f"line {k + 1}", *damaged) from None
                    kept, cut = lines[:k], True
                    break
                self.known[key] = one
            if cut or (head and not path.is_file()):
                with replace_file(path) as part:
                    part.write_bytes(b"".join(line + b"\n" for line in kept))

    def add(self, key: Any, one: One, content: Any) -> None:
        """Keep an answer, whose line holds ``content``."""
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(content) + "\n")
        self.known[key] = one

    def discard(self) -> None:
        """Delete the file."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
