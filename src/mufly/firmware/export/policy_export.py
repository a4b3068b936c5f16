"""Export a learned policy as C99 of fixed size, equal bit for bit to :mod:`mufly.flight.policy`.

``policy.c`` is written by hand and equal for all policies; ``policy_numbers.c`` and ``policy_numbers.h`` are generated.
Equality holds in double precision and without contraction (``-ffp-contract=off``). With ``-DMUFLY_FLOAT`` the code
computes in single precision, and actions differ by about 1e-6.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib import resources
from pathlib import Path

from mufly.errors import InputError
from mufly.firmware.export.source_export import SOURCE_FOLDER, escape_comment, to_hexadecimal
from mufly.flight.policy import LearnedPolicy
from mufly.version import __version__

_COPIED_SOURCES = (
    "policy/policy.c", "policy/policy.h", "real.c", "real.h", "flight/controllers.h", "control/cascade.h",
    "control/law.h", "control/schedule.h",
)  # fmt: skip


def export_policy(policy: LearnedPolicy, out: str | Path) -> list[Path]:
    """Write a learned policy as C99 code without heap.

    Parameters
    ----------
    policy : LearnedPolicy
    out : str or Path
        Folder; an earlier export in it is replaced.

    Returns
    -------
    list of Path
        Written files.

    Raises
    ------
    InputError
        If the folder holds other files.
    """
    folder = Path(out)
    if folder.exists() and (
        not folder.is_dir() or (any(folder.iterdir()) and not (folder / "policy/policy.c").exists())
    ):
        raise InputError("out", str(out), "contains files of another origin", "name a new or empty folder")
    folder.mkdir(parents=True, exist_ok=True)
    texts = render_policy_files(policy)
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return sorted(folder / name for name in texts)


def render_policy_files(policy: LearnedPolicy) -> dict[str, str]:
    """Return the text of each file of an exported policy by its path."""
    with resources.as_file(SOURCE_FOLDER) as sources:
        texts = {name: (sources / name).read_text(encoding="utf-8") for name in _COPIED_SOURCES}
    p = policy.packed_arrays
    sizes = {
        "LAYERS": len(policy.layers), "INPUTS": policy.input_count, "WIDEST": int(p.layer_sizes.max()),
        "WEIGHTS": p.weights.size, "BIASES": p.biases.size,
    }  # fmt: skip
    title = f"{escape_comment(policy.task)} of {escape_comment(policy.vehicle_name)}"
    head = f"/* The policy {title}, made by mufly {__version__}; do not edit. */"
    texts["policy/policy_numbers.h"] = "\n".join([
        head, "#ifndef MUFLY_POLICY_NUMBERS_H", "#define MUFLY_POLICY_NUMBERS_H", "",
        *(f"#define POLICY_{name} {n}" for name, n in sizes.items()), "", "#endif", "",
    ])  # fmt: skip
    reals = {
        "low[POLICY_INPUTS]": p.observation_low, "high[POLICY_INPUTS]": p.observation_high,
        "mean[POLICY_INPUTS]": p.observation_mean, "scale[POLICY_INPUTS]": p.observation_scale,
        "weights[POLICY_WEIGHTS]": p.weights, "biases[POLICY_BIASES]": p.biases,
        "trim[POLICY_ACTION_SIZE]": policy.trim_inputs,
    }  # fmt: skip
    numbers = {"limit": p.observation_limit, "nominal_voltage": policy.nominal_voltage_V, "period": policy.period_s}
    texts["policy/policy_numbers.c"] = "\n".join([
        head, '#include "policy/policy.h"', "",
        *_format_table("int32_t policy_sizes[POLICY_LAYERS + 1]", map(str, p.layer_sizes)),
        *_format_table("int32_t policy_activations[POLICY_LAYERS]", map(str, p.activations)),
        *(f"const real_t policy_{name} = {to_hexadecimal(float(x))};" for name, x in numbers.items()),
        *(line for name, row in reals.items()
          for line in _format_table(f"real_t policy_{name}", (to_hexadecimal(float(x)) for x in row))), "",
    ])  # fmt: skip
    return texts


def _format_table(declaration: str, numbers: Iterable[str]) -> list[str]:
    return [f"const {declaration} = {{", *(f"    {x}," for x in numbers), "};"]
