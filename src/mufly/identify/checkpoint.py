"""Where a fit stands, on disk: written after every iteration, so that a stopped fit goes on from its last one.

A JSON file beside the result, replaced as a whole each time (a crash in mid-write leaves the one before). It holds a
digest of the problem, so that a fit does not go on from another one's.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from mufly.errors import InputError
from mufly.identify.problem import Problem

__all__ = ["digest_of", "read_checkpoint", "write_checkpoint"]


def digest_of(problem: Problem, method: str) -> str:
    """Return a digest of everything that the course of a fit depends on."""
    h = hashlib.sha256(f"{method} {problem.part} {problem.prior} {problem.delay_s} {problem.free}".encode())
    h.update(problem.vehicle.model_dump_json().encode())
    for r in problem.records:
        h.update(" ".join(r.outputs).encode())
        for a in (r.time_s, r.inputs, r.measured):
            h.update(np.ascontiguousarray(a).tobytes())
    return h.hexdigest()[:32]


def write_checkpoint(path: Path, digest: str, state: dict[str, Any]) -> None:
    """Write where a fit stands; arrays become lists.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    text = json.dumps({"digest": digest, **state}, default=lambda a: a.tolist())
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        raise InputError(str(path), "", f"cannot be written ({error})", "give another place") from error


def read_checkpoint(path: Path, digest: str) -> dict[str, Any] | None:
    """Return where the fit of this digest stood; None if it never ran.

    Raises
    ------
    InputError
        If the file is damaged or belongs to another fit.
    """
    if not path.exists():
        return None
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
        found = state["digest"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(str(path), "", "is no checkpoint of a fit", "delete it to start anew") from error
    if found != digest:
        raise InputError(
            str(path), "", "belongs to a fit of other records, parameters or method", "delete it to start anew"
        )  # fmt: skip
    return dict(state)
