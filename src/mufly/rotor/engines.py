"""From an airfoil to its polar table, through one of three engines.

``neuralfoil``
    Network trained on XFOIL (``neural``); the default, milliseconds a table.
``xfoil``
    M. Drela's panel and boundary-layer code where it is installed (``xfoil``); the cross-check, minutes a table.
``table``
    The user's numbers, from a CSV file (``section``).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.errors import InputError
from mufly.rotor import neural, xfoil
from mufly.rotor import section as cache
from mufly.rotor.airfoil import Airfoil, load_airfoil
from mufly.rotor.polar_table import ASPECT_RATIO, PolarTable, extend
from mufly.rotor.section import SectionData, read_polar_csv

Engine = Literal["neuralfoil", "xfoil", "table"]

REYNOLDS: NDArray[np.float64] = np.geomspace(2e3, 3e5, 21)  # a factor 1.28 apart


def polar(
    airfoil: str | Path | Airfoil,
    *,
    n_crit: float = 0.1,
    engine: Engine = "neuralfoil",
    reynolds: ArrayLike | None = None,
    xtr: tuple[float, float] = (1.0, 1.0),
    model: str = "xlarge",
    aspect_ratio: float = ASPECT_RATIO,
) -> PolarTable:
    """Return the section coefficients of an airfoil over the full circle.

    Parameters
    ----------
    airfoil : str, Path or Airfoil
        What :func:`mufly.rotor.load_airfoil` takes. A CSV file (columns alpha_deg, cl, cd, and if known cm and
        reynolds) is read as a table, whatever the engine.
    n_crit : float
        Amplification exponent at transition, 0 to 18. The default suits a vibrating rotor in its own wake
        (thesis, Table 3.1); 9 is a quiet wind tunnel. Without meaning for a table.
    engine : {'neuralfoil', 'xfoil', 'table'}
        See the module's docstring.
    reynolds : (nr,) array_like, optional
        Chord Reynolds numbers in geometric progression; the default covers 2e3 to 3e5.
    xtr : (float, float)
        Forced transition on upper and lower side, x/c; 1 leaves it free.
    model : str
        Size of NeuralFoil's network.
    aspect_ratio : float
        Span over chord of the blade, for the drag across the flow (see ``extend``).

    Raises
    ------
    InputError
        If the airfoil, an option or the file is wrong.
    MuflyError
        If the engine is not installed or found no answer.
    """
    given = airfoil.name if isinstance(airfoil, Airfoil) else str(airfoil)
    found = polars(
        [airfoil],
        n_crit=n_crit,
        engine=engine,
        reynolds=reynolds,
        xtr=xtr,
        model=model,
        aspect_ratio=aspect_ratio,
    )
    return found[given]


def polars(
    airfoils: Iterable[str | Path | Airfoil],
    *,
    n_crit: float = 0.1,
    engine: Engine = "neuralfoil",
    reynolds: ArrayLike | None = None,
    xtr: tuple[float, float] = (1.0, 1.0),
    model: str = "xlarge",
    aspect_ratio: float = ASPECT_RATIO,
    faults: dict[str, str] | None = None,
) -> dict[str, PolarTable]:
    """Return the tables of many airfoils, by the names they were asked for.

    Parameters
    ----------
    airfoils : iterable of str, Path or Airfoil
        As for :func:`polar`, which has the other parameters too.
    faults : dict, optional
        If given, an airfoil that fails is left out of the answer and its one-line message is entered here under its
        name. Otherwise the first failure is raised.
    """
    re = _checked(n_crit, engine, reynolds, xtr)
    tables: dict[str, SectionData] = {}
    todo: list[tuple[str, str, Airfoil]] = []
    for item in airfoils:
        name = item.name if isinstance(item, Airfoil) else str(item)
        try:
            if engine == "table" or (not isinstance(item, Airfoil) and name.lower().endswith(".csv")):
                tables[name] = read_polar_csv(name)
                continue
            section = item if isinstance(item, Airfoil) else load_airfoil(item)
            which = (
                (neural.neuralfoil_version(), model) if engine == "neuralfoil" else ("xfoil", xfoil.SETTINGS)
            )
            key = cache.key_of(section.digest(), engine, *which, float(n_crit), tuple(map(float, xtr)), re)
            known = cache.recall(key, section.name)
            if known is not None:
                tables[name] = known
            elif engine == "neuralfoil":
                neural.check_fit(section)
                todo.append((name, key, section))
            else:
                tables[name] = xfoil.xfoil(section, re, n_crit=n_crit, xtr=xtr)
                cache.store(key, tables[name])
        except InputError as error:
            if faults is None:
                raise
            faults[name] = str(error)
    if todo:
        computed = neural.neuralfoil([s for _, _, s in todo], re, n_crit=n_crit, xtr=xtr, model=model)
        for (name, key, _), data in zip(todo, computed, strict=True):
            tables[name] = data
            cache.store(key, data)
    return {name: extend(data, aspect_ratio=aspect_ratio) for name, data in tables.items()}


def _checked(
    n_crit: float, engine: str, reynolds: ArrayLike | None, xtr: tuple[float, float]
) -> NDArray[np.float64]:
    if engine not in ("neuralfoil", "xfoil", "table"):
        raise InputError("polar", "engine", f"{engine!r} is unknown", "use neuralfoil, xfoil or table")
    if not 0.0 <= n_crit <= 18.0:
        raise InputError("polar", "n_crit", f"{n_crit:g} is not possible", "give 0 (noisy) to 18 (glider)")
    if len(xtr) != 2 or not all(0.0 <= x <= 1.0 for x in xtr):
        raise InputError("polar", "xtr", f"{xtr} is not possible", "give two places x/c between 0 and 1")
    re = REYNOLDS if reynolds is None else np.atleast_1d(np.asarray(reynolds, dtype=np.float64))
    steps = np.diff(np.log(re)) if np.all(re > 0) else np.array([-1.0])
    if re.ndim != 1 or not np.all(np.isfinite(re)) or np.any(steps <= 0):
        raise InputError(
            "polar", "reynolds", "are not positive and rising", "give for example geomspace(2e3, 3e5, 21)"
        )
    if steps.size > 1 and not np.allclose(steps, steps.mean(), rtol=1e-6):
        raise InputError("polar", "reynolds", "are not in geometric progression", "use numpy.geomspace")
    return re
