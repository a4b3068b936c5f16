"""Errors that a user reads: one clear line each."""

from __future__ import annotations


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

    def at(self, where: str) -> InputError:
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
