"""Parameter variations of a campaign: vehicle parameters drawn around the values of a vehicle file or a fit.

A :class:`ParameterVariation` is linear: ``values = nominal_values + spread_matrix @ z``. The components of ``z`` are
independent, uniform within -1..1 or normal with unit variance. This form covers a spread in percent, a range and the
covariance of an identification; the search for the worst case varies ``z``.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError, suggest_name
from mufly.quantities.quantity_grammar import parse_quantity
from mufly.vehicle import Parameter, Vehicle, list_parameters, load_vehicle

_Array = NDArray[np.float64]

ALL_PARAMETERS_NAME = "parameters"
"""Name of all parameters of the flight model: everything but the mass budget, the range ring and the sensors."""

STANDARD_SET_NAME = "standard"
"""Name of the set of errors in ``standard.toml`` beside this file."""

_EXCLUDED_PREFIXES = ("mass_budget.", "range_ring.", "sensors.")
_SYNTAX_HELP = (
    "NAME=10%, NAME=50:300%, NAME=+-2g, NAME=90:100g, NAME=normal:3%, NAME=std, standard, "
    "or a file of `mufly identify flight`"
)
_SPREAD_PATTERN = re.compile(r"(?P<normal>normal:)?(?P<sides>\+-|±)?(?P<number>[0-9.eE+-]+) *(?P<unit>[^0-9: ].*)?")
_RANGE_PATTERN = re.compile(r"(?P<low>[0-9.eE+-]+) *: *(?P<high>[0-9.eE+-]+) *(?P<unit>.*)")


@dataclass(frozen=True, eq=False)
class ParameterVariation:
    """Parameters that vary together, as linear functions of random variables ``z``.

    Attributes
    ----------
    request_text : str
        The user's text.
    keys : tuple of str
        Keys of the ``n`` parameters.
    distribution : {"uniform", "normal"}
        Distribution of each component of ``z``: within -1..1, or of unit variance.
    nominal_values : (n,) array
        Values at ``z`` = 0 (SI units).
    spread_matrix : (n, m) array
        Change of each value with each component of ``z`` (SI units).
    note : str
        Remark for the user; may be empty.
    """

    request_text: str
    keys: tuple[str, ...]
    distribution: Literal["uniform", "normal"]
    nominal_values: _Array
    spread_matrix: _Array
    note: str = ""

    @property
    def variable_count(self) -> int:
        """Number of random variables ``z`` of the variation."""
        return self.spread_matrix.shape[1]

    def parameter_values(self, z: _Array) -> dict[str, float]:
        """Return the parameters (SI) at ``z`` (m,)."""
        return dict(zip(self.keys, (self.nominal_values + self.spread_matrix @ z).tolist(), strict=True))

    def draw_normalised_variables(self, rng: np.random.Generator) -> _Array:
        """Return random variables ``z`` (m,) of the variation's distribution."""
        return (
            rng.uniform(-1.0, 1.0, self.variable_count)
            if self.distribution == "uniform"
            else rng.standard_normal(self.variable_count)
        )

    def without_keys(self, keys: Iterable[str]) -> ParameterVariation:
        """Return the variation without the parameters ``keys``."""
        kept = [k for k, key in enumerate(self.keys) if key not in set(keys)]
        factor = self.spread_matrix[kept]
        used = np.flatnonzero(np.any(factor != 0.0, axis=0)) if self.distribution == "uniform" else slice(None)
        return replace(
            self,
            keys=tuple(self.keys[k] for k in kept),
            nominal_values=self.nominal_values[kept],
            spread_matrix=factor[:, used],
        )

    def to_json(self) -> list[Any]:
        """Return all that determines the drawn values, in JSON types."""
        return [list(self.keys), self.distribution, self.nominal_values.tolist(), self.spread_matrix.tolist()]


def parse_variations(texts: Sequence[str], vehicle: Vehicle) -> tuple[ParameterVariation, ...]:
    """Return the variations of texts such as ``"parameters=10%"``.

    Parameters
    ----------
    texts : sequence of str
        ``NAME`` is ``parameters``, a table (``rotors``), a key (``body.mass``) or a symbol (``m``). ``10%`` and
        ``+-2g`` draw uniformly around the vehicle's value, ``90:100g`` uniformly in between, ``50:300%`` uniformly
        between these shares of the vehicle's value; equal ends give a fixed value. ``normal:3%`` and ``normal:2g`` draw
        normally with this standard deviation, ``std`` with the one in the vehicle file. A file is the output of
        ``mufly identify flight --json`` (with the covariance) or a vehicle file (with standard deviations).
        ``standard`` is the set of ``standard.toml``. A text with fewer parameters takes precedence.
    vehicle : Vehicle
        Vehicle with the nominal values.

    Raises
    ------
    InputError
        If a text has none of these forms, or two texts draw the same parameter.
    """
    found: list[ParameterVariation] = []
    for text in texts:
        new = _parse_vary_option(text, vehicle)
        for k, other in enumerate(found):
            shared = [key for key in new.keys if key in other.keys]
            if not shared:
                continue
            if len(new.keys) == len(other.keys):
                raise ArgumentError("vary", text, f"{shared[0]} is varied by {other.request_text!r}", "vary it once")
            if len(new.keys) < len(other.keys):
                found[k] = other.without_keys(shared)
            else:
                new = new.without_keys(shared)
        found.append(new)
    return tuple(v for v in found if v.keys)


def _parse_vary_option(text: str, vehicle: Vehicle) -> ParameterVariation:
    if text.strip() == STANDARD_SET_NAME:
        return _standard_variation(vehicle)
    is_file = "=" not in text and Path(text).suffix.lower() in (".json", ".toml")
    return _read_variation_file(text, vehicle) if is_file else _parse_assignment(text, vehicle)


def _standard_variation(vehicle: Vehicle) -> ParameterVariation:
    """Return the standard set of variations: independent uniform parameters, without those of absent sensors."""
    content = files(__package__).joinpath(f"{STANDARD_SET_NAME}.toml").read_text(encoding="utf-8")
    values = {p.key: p.value for p in list_parameters(vehicle)}
    parts = []
    for line in tomllib.loads(content)["vary"]:
        key = line.partition("=")[0]
        if key in values and (values[key] != 0.0 or "%" not in line):
            parts.append(_parse_assignment(line, vehicle))
    return ParameterVariation(
        STANDARD_SET_NAME,
        tuple(key for part in parts for key in part.keys),
        "uniform",
        np.concatenate([part.nominal_values for part in parts]),
        np.diag([float(part.spread_matrix[0, 0]) for part in parts]),
    )


_NAMES_HELP = "use `parameters`, a table, or a key or symbol that `mufly vehicle show` lists"


def _parameter_names(known: Sequence[Parameter]) -> list[str]:
    return list(dict.fromkeys([*(p.key for p in known), *(p.symbol for p in known if len(p.symbol) > 2)]))


def _select_parameters(name: str, text: str, vehicle: Vehicle) -> list[Parameter]:
    numbers = [p for p in list_parameters(vehicle) if isinstance(p.value, float)]
    if name == ALL_PARAMETERS_NAME:
        return [p for p in numbers if not p.key.startswith(_EXCLUDED_PREFIXES)]
    chosen = [p for p in numbers if p.key == name or p.key.startswith(f"{name}.")]
    chosen = chosen or [p for p in numbers if p.symbol == name]
    if not chosen:
        raise ArgumentError(
            "vary", text, f"{name!r} is not a parameter of {vehicle.name}",
            suggest_name(name, _parameter_names(numbers), _NAMES_HELP),
        )  # fmt: skip
    return chosen


def _parse_assignment(text: str, vehicle: Vehicle) -> ParameterVariation:
    name, equals, how = (part.strip() for part in text.partition("="))
    if not equals or not how:
        remedy = (
            suggest_name(name, [STANDARD_SET_NAME], f"write {_SYNTAX_HELP}") if not equals else f"write {_SYNTAX_HELP}"
        )
        raise ArgumentError("vary", text, "names no parameter or no variation", remedy)
    chosen = _select_parameters(name, text, vehicle)
    keys = tuple(p.key for p in chosen)
    if how == "std":
        stated = [p for p in chosen if p.std is not None]
        if not stated:
            raise ArgumentError(
                "vary", text, "no standard deviation is stated in the vehicle file", "give one: normal:3%"
            )
        missing = len(chosen) - len(stated)
        note = f"{missing} of {len(chosen)} parameters are not varied: no standard deviation" if missing else ""
        return replace(_independent_variation(text, stated, [float(p.std or 0.0) for p in stated], "normal"), note=note)
    if match := _RANGE_PATTERN.fullmatch(how):
        return _range_variation(text, how, match, chosen)
    match = _SPREAD_PATTERN.fullmatch(how)
    if match is None:
        raise ArgumentError("vary", text, f"{how!r} is not a variation", f"write {_SYNTAX_HELP}")
    number, unit = _parse_number(match["number"], text), (match["unit"] or "").strip()
    if not number > 0.0:
        raise ArgumentError("vary", text, f"{number:g} is not a variation", "give a number above 0")
    if unit == "%":
        if number >= 100.0 and match["normal"] is None:
            raise ArgumentError("vary", text, f"a spread of {number:g} % includes zero", "give less than 100 %")
        chosen = _drop_zero_parameters(chosen, text)
        widths = number / 100.0 * np.abs([p.value for p in chosen])
    elif match["normal"] or match["sides"]:
        widths = np.full(len(keys), _to_si_amount(match["number"], unit, chosen, text))
    else:
        raise ArgumentError(
            "vary", text, f"{how!r} could mean a value or a spread", "write +-2g or normal:2g for a spread"
        )
    return _independent_variation(text, chosen, widths.tolist(), "normal" if match["normal"] else "uniform")


def _range_variation(text: str, how: str, match: re.Match[str], chosen: Sequence[Parameter]) -> ParameterVariation:
    """Return a variation of parameters between two values, or between two percentages of their values in the
    vehicle.
    """
    is_share = match["unit"].strip() == "%"
    if is_share:
        low, high = (_parse_number(match[k], text) / 100.0 for k in ("low", "high"))
        chosen = _drop_zero_parameters(chosen, text)
        if low < 0.0:
            raise ArgumentError(
                "vary", text, f"{100 * low:g} % of a value changes its sign", "give shares of 0 % or more"
            )
    else:
        low, high = (_to_si_amount(match[k], match["unit"], chosen, text) for k in ("low", "high"))
    if not low <= high:
        raise ArgumentError(
            "vary", text, f"the range {how} contains no value", "write LOW:HIGH with LOW not above HIGH"
        )
    scale = np.array([p.value if is_share else 1.0 for p in chosen])
    half = 0.5 * (high - low) * np.abs(scale)
    spread = np.diag(half) if high > low else np.zeros((len(chosen), 0))
    return ParameterVariation(text, tuple(p.key for p in chosen), "uniform", 0.5 * (high + low) * scale, spread)


def _drop_zero_parameters(chosen: Sequence[Parameter], text: str) -> list[Parameter]:
    """Return the parameters other than 0, because a percentage of 0 is always 0."""
    kept = [p for p in chosen if p.value != 0.0]
    if not kept:
        raise ArgumentError(
            "vary", text, "a parameter of value 0 has no percentage", "write +-AMOUNT or LOW:HIGH with a unit"
        )
    return kept


def _independent_variation(
    text: str, chosen: Sequence[Parameter], widths: Sequence[float], shape: Literal["uniform", "normal"]
) -> ParameterVariation:
    centre = np.array([p.value for p in chosen])
    return ParameterVariation(text, tuple(p.key for p in chosen), shape, centre, np.diag(np.array(widths)))


def _parse_number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ArgumentError("vary", where, f"{text!r} is not a number", f"write {_SYNTAX_HELP}") from None


def _to_si_amount(number: str, unit: str, chosen: Sequence[Parameter], text: str) -> float:
    """Convert a number with a unit to the common SI unit of the chosen parameters."""
    own = {p.unit for p in chosen}
    if len(own) > 1:
        raise ArgumentError("vary", text, f"its {len(chosen)} parameters have no unit in common", "vary them in %")
    try:
        return parse_quantity("", f"{number} {unit}", own.pop(), bare=False)
    except InputError as error:
        raise ArgumentError("vary", text, error.problem, f"{error.remedy}, or %") from None


def _read_variation_file(text: str, vehicle: Vehicle) -> ParameterVariation:
    path = Path(text)
    if path.suffix.lower() == ".toml":
        stated = [p for p in list_parameters(load_vehicle(path)) if p.std and isinstance(p.value, float)]
        if not stated:
            raise ArgumentError(
                "vary", text, "states no standard deviation", "write it with `mufly identify flight --out`"
            )
        return _independent_variation(text, stated, [float(p.std or 0.0) for p in stated], "normal")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        rows, correlation = content["parameters"], np.array(content["correlation"], dtype=np.float64)
        fitted = [(str(r["key"]), r["value"], r["std"], bool(r["at_bound"])) for r in rows]
        if correlation.shape != (len(fitted), len(fitted)):
            raise ValueError(f"correlation of {correlation.shape} for {len(fitted)} parameters")
    except OSError as error:
        raise ArgumentError("vary", text, f"cannot be read ({error.strerror})", "give an existing file") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ArgumentError(
            "vary",
            text,
            f"is not a result of an identification ({error})",
            "write one with `mufly identify flight --json`",
        ) from None
    known = {p.key for p in list_parameters(vehicle)}
    use = [k for k, (key, value, std, _) in enumerate(fitted) if key in known and value is not None and std is not None]
    if not use:
        raise ArgumentError("vary", text, f"contains no parameter of {vehicle.name}", "identify some of its parameters")
    held = [key for key, _, _, at_bound in (fitted[k] for k in use) if at_bound]
    left = [fitted[k][0] for k in range(len(fitted)) if k not in use and fitted[k][0]]
    std = np.array([0.0 if at_bound else float(s) for _, _, s, at_bound in (fitted[k] for k in use)])
    size, vectors = np.linalg.eigh(np.nan_to_num(correlation[np.ix_(use, use)]))
    factor = std[:, None] * vectors * np.sqrt(np.maximum(size, 0.0))
    told = [f"{', '.join(held)} at a bound of the fit: kept at the fitted value"] if held else []
    told += [f"{', '.join(left)} not determined by the data: not varied"] if left else []
    centre = np.array([float(fitted[k][1]) for k in use])
    return ParameterVariation(text, tuple(fitted[k][0] for k in use), "normal", centre, factor, "; ".join(told))
