"""Errors that a user reads: one clear line each."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path


class MuflyError(Exception):
    """Something a user can act on. The message is one line; the command line prints it without a traceback."""


class InputError(MuflyError):
    """A file or an argument is wrong.

    Parameters
    ----------
    where : str
        File name or argument that holds the fault.
    key : str
        Dotted key inside it (``"body.mass"``), or ``""``.
    problem : str
        What is wrong, with the offending value.
    remedy : str
        What would be right.
    """

    def __init__(self, where: str, key: str, problem: str, remedy: str) -> None:
        self.where, self.key, self.problem, self.remedy = where, key, problem, remedy
        place = f"{where}: {key}" if key else where
        super().__init__(f"{place}: {problem}; {remedy}")

    def with_location(self, where: str) -> InputError:
        """The same fault, of a file that its finder knew only by the name of what is in it."""
        return InputError(where, self.key, self.problem, self.remedy)


class ArgumentError(InputError):
    """An argument of a function is wrong; the command line names the option that gave it.

    Parameters
    ----------
    argument : str
        Its name.
    key : str
        What in it is wrong, or ``""``.
    problem : str
    remedy : str
        ``argument=value`` in it becomes ``--option value`` on the command line.
    """

    def __init__(self, argument: str, key: str, problem: str, remedy: str) -> None:
        super().__init__(argument, key, problem, remedy)
        self.argument = argument


@contextmanager
def report_write_errors(where: str | Path, remedy: str = "give another folder", key: str = "") -> Iterator[None]:
    """Raise an :class:`InputError` about ``where`` for what goes wrong while files are written in the block."""
    try:
        yield
    except OSError as error:
        raise InputError(str(where), key, f"cannot be written ({error.strerror or error})", remedy) from error


def suggest_name(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """Return the remedy for an unknown name: the known names most like it.

    Parameters
    ----------
    name : str
        As it was given.
    known : iterable of str
        What there is.
    otherwise : str
        The remedy where nothing is like it; default: a list of all that there is.
    """

    def normalise_name(text: str) -> str:
        return re.sub(r"[\s_-]", "", text.lower())

    names = list(known)
    by_plain = {normalise_name(n): n for n in names}
    near = difflib.get_close_matches(normalise_name(name), by_plain, n=3, cutoff=0.65)
    if not near:
        return otherwise or f"use one of: {', '.join(names)}"
    ratios = [difflib.SequenceMatcher(None, normalise_name(name), n).ratio() for n in near]
    shown = [by_plain[n] for n, r in zip(near, ratios, strict=True) if r > max(ratios) - 0.1]
    return f"did you mean {' or '.join(map(repr, shown))}?"
