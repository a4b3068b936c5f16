"""Errors for users, with a one-line message."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path


class MuflyError(Exception):
    """Error that a user can act on. The message is one line; the command line prints it without traceback."""


class InputError(MuflyError):
    """Error in a file or an argument.

    Parameters
    ----------
    where : str
        File name or argument with the fault.
    key : str
        Dotted key inside it (``"body.mass"``), or ``""``.
    problem : str
        Description of the fault, with the wrong value.
    remedy : str
        Description of a valid input.
    """

    def __init__(self, where: str, key: str, problem: str, remedy: str) -> None:
        self.where, self.key, self.problem, self.remedy = where, key, problem, remedy
        place = f"{where}: {key}" if key else where
        super().__init__(f"{place}: {problem}; {remedy}")

    def with_location(self, where: str) -> InputError:
        """Return the same error with another location."""
        return InputError(where, self.key, self.problem, self.remedy)


class ArgumentError(InputError):
    """Error in an argument of a function; the command line names the corresponding option.

    Parameters
    ----------
    argument : str
        Name of the argument.
    key : str
        Wrong part of the argument, or ``""``.
    problem : str
    remedy : str
        ``argument=value`` in it becomes ``--option value`` on the command line.
    """

    def __init__(self, argument: str, key: str, problem: str, remedy: str) -> None:
        super().__init__(argument, key, problem, remedy)
        self.argument = argument


@contextmanager
def convert_write_errors(where: str | Path, remedy: str = "give another folder", key: str = "") -> Iterator[None]:
    """Context manager that converts file errors in its block to an :class:`InputError` about the path ``where``."""
    try:
        yield
    except OSError as error:
        raise InputError(str(where), key, f"cannot be written ({error.strerror or error})", remedy) from error


def suggest_name(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """Return the remedy for an unknown name as a text: the most similar known names.

    Parameters
    ----------
    name : str
        Unknown name.
    known : iterable of str
        Known names.
    otherwise : str
        Remedy if no name is similar; default: a list of all known names.
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
