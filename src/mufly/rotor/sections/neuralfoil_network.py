"""Evaluation of NeuralFoil's network for many airfoils, angles and Reynolds numbers at once.

NeuralFoil (P. Sharpe, R. J. Hansman, arXiv 2503.16323, 2025; MIT licence) is a network trained on some eight million
XFOIL runs. Its input is the section as 18 numbers (Kulfan, Journal of Aircraft 45, 2008), with psi = x/c::

    y_upper = sqrt(psi) (1 - psi) sum_i u_i B_i(psi) + w psi (1 - psi)^8.5 + psi t/2,    B_i: Bernstein, degree 7
    y_lower = the same with l_i and - psi t/2

fitted here by least squares, and seven numbers for the flow: sin 2a, cos a, sin^2 a, (ln Re - 12.5)/3.5, (n_crit -
9)/4.5 and the two forced transitions. The network is evaluated for the section and for its mirror image, and the two
results are averaged, so that a symmetric section has exactly zero lift at zero angle.

The package's own function takes one airfoil per call, computes 198 outputs in double precision and needs two seconds to
import. Only four of those outputs are needed, and the first layer splits into a part of the section and a part of the
flow. This module therefore reads the package's weights and evaluates them in single precision, one airfoil per thread.
It is about ten times as fast; a test compares it with the package.

Range. The training set drew Re from a log-normal distribution, 10^(5.5 +- 1.5), n_crit evenly from 0 to 18, and angles
between -10 and 10 degrees with a spread of 2.5 + 2.5 degrees, limited to converged XFOIL runs. Re 2e3 lies 1.5 standard
deviations below the mean and n_crit 0.1 at the edge, both within the set; beyond 15 degrees there are few samples,
beyond 20 almost none. Results are used between -20 and 20 degrees. They are valid where the network's confidence stays
above one half without a gap from zero lift outwards; the rest is extended
(:func:`mufly.rotor.sections.polar_table.extend_polar_to_full_circle`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import comb
from threadpoolctl import threadpool_limits

from mufly.errors import InputError, MuflyError
from mufly.rotor.sections.airfoil import Airfoil
from mufly.rotor.sections.section_data import EnginePolars

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

NEURALFOIL_MODELS = ("small", "medium", "large", "xlarge", "xxlarge", "xxxlarge")
MIN_CONFIDENCE = 0.5
MAX_ALPHA_DEG = 20.0
_ALPHA_GRID_RAD = np.deg2rad(np.arange(-MAX_ALPHA_DEG, MAX_ALPHA_DEG + 0.5, 1.0))
_WEIGHTS_PER_SIDE = 8
_UPPER_SIDE_INPUTS, _LOWER_SIDE_INPUTS, _NOSE_INPUT, _SECTION_SHAPE_INPUT_COUNT = slice(0, 8), slice(8, 16), 16, 18
"""Weights of the sides and of the nose among the numbers of a section, the last of which is the tail's thickness."""
_CL_OUTPUT, _LOG_CD_OUTPUT, _CM_OUTPUT = 1, 2, 3  # outputs of the network, behind its confidence
_OUTPUT_COLUMNS = slice(0, 4)  # confidence, lift, drag, moment
_MAX_KULFAN_FIT_ERROR_CHORDS = 0.01  # of chord
_MAX_GURNEY_HEIGHT_CHORDS = 0.02
"""Height (of chord) up to which lift agrees with XFOIL within 0.05 (docs/log/2026-11-28-polars.md)."""
_BATCH_SIZE = 8192  # activations of one layer fit in the cache of a processor core


@cache
def _find_neuralfoil_folder() -> Path:
    found = find_spec("neuralfoil")  # looked up, not imported: that takes two seconds
    if found is None or found.origin is None:
        raise MuflyError("NeuralFoil is not installed; pip install neuralfoil, or use engine 'xfoil' or 'table'")
    return Path(found.origin).parent / "nn_weights_and_biases"


@cache
def _load_network(model: str) -> tuple[list[tuple[Floats, Floats]], Floats, Floats]:
    """Load the layers (weight, bias), and mean and inverse covariance of the training inputs."""
    if model not in NEURALFOIL_MODELS:
        raise InputError("polar", "model", f"{model!r} is unknown", f"use one of: {', '.join(NEURALFOIL_MODELS)}")
    file = _find_neuralfoil_folder() / f"nn-{model}.npz"
    try:
        data = dict(np.load(file))
        spread = dict(np.load(_find_neuralfoil_folder() / "scaled_input_distribution.npz"))
    except OSError as error:
        raise MuflyError(f"NeuralFoil's weights cannot be read ({error}); reinstall neuralfoil") from error
    numbers = sorted({int(key.split(".")[1]) for key in data})
    layers = [(data[f"net.{i}.weight"].astype(np.float32), data[f"net.{i}.bias"].astype(np.float32)) for i in numbers]
    weight, bias = layers[-1]
    layers[-1] = (weight[_OUTPUT_COLUMNS], bias[_OUTPUT_COLUMNS])
    mean = spread["mean_inputs_scaled"].astype(np.float32)
    return layers, mean, spread["inv_cov_inputs_scaled"].astype(np.float32)


def neuralfoil_version() -> str:
    """Return the version of the installed package ``neuralfoil``."""
    _find_neuralfoil_folder()
    return version("neuralfoil")


def fit_kulfan_parameters(airfoil: Airfoil) -> tuple[Array, float, float, float]:
    """Fit Kulfan's 18 parameters to a contour; return them with rotation, chord and greatest error of the fit.

    The chord line for the fit runs from the point farthest from the tail to the middle of the tail.

    Returns
    -------
    parameters : (18,) array
        Upper weights, lower weights, nose weight, tail thickness.
    rotation_rad : float
        Angle from the fit's chord line to the contour's x axis, to be added to the angle of attack.
    chord : float
        Length of the fit's chord line over the contour's chord.
    worst : float
        Greatest error in y of the fit, over chord.
    """
    xy = airfoil.coordinates
    tail = 0.5 * (xy[0] + xy[-1])
    nose = int(np.argmax(np.linalg.norm(xy - tail, axis=1)))
    line = tail - xy[nose]
    chord, tilt = float(np.hypot(*line)), math.atan2(line[1], line[0])
    c, s = math.cos(tilt), math.sin(tilt)
    x, y = ((xy - xy[nose]) @ np.array([[c, -s], [s, c]]) / chord).T
    x = np.clip(x, 0.0, 1.0)
    upper = np.arange(len(x)) <= nose
    i = np.arange(_WEIGHTS_PER_SIDE)
    degree = _WEIGHTS_PER_SIDE - 1
    bernstein = comb(degree, i) * x[:, None] ** i * (1 - x[:, None]) ** (degree - i)
    shape = np.sqrt(x)[:, None] * (1 - x)[:, None] * bernstein
    columns = np.column_stack(
        (
            np.where(upper[:, None], shape, 0.0),
            np.where(upper[:, None], 0.0, shape),
            x * (1 - x) ** (_WEIGHTS_PER_SIDE + 0.5),
            np.where(upper, x / 2, -x / 2),
        )
    )
    found = np.linalg.lstsq(columns, y, rcond=None)[0]
    if found[-1] < 0:  # the tail thickness is not negative
        found = np.append(np.linalg.lstsq(columns[:, :-1], y, rcond=None)[0], 0.0)
    return found, -tilt, chord, float(np.max(np.abs(columns @ found - y)))


def require_kulfan_fit(airfoil: Airfoil) -> tuple[Array, float, float, float]:
    """Fit a contour as :func:`fit_kulfan_parameters` does, or raise InputError if 18 numbers cannot describe it."""
    if airfoil.gurney > _MAX_GURNEY_HEIGHT_CHORDS:
        problem = f"NeuralFoil's smooth contour cannot carry a Gurney flap of {100 * airfoil.gurney:g} %"
        raise InputError(airfoil.name, "", problem, "use engine 'xfoil', or a flap up to 2 %")
    *_, error = found = fit_kulfan_parameters(airfoil)
    if error > _MAX_KULFAN_FIT_ERROR_CHORDS:
        problem = f"NeuralFoil's smooth contour misses this one by {100 * error:.1f} % of chord"
        raise InputError(airfoil.name, "", problem, "use engine 'xfoil' or a table")
    return found


def _swish_in_place(z: Floats) -> Floats:
    """Apply z / (1 + exp(-z)) in place."""
    e = np.negative(z)
    np.minimum(e, np.float32(80.0), out=e)
    np.exp(e, out=e)
    e += np.float32(1.0)
    z /= e
    return z


def _forward_pass(first: Floats, layers: list[tuple[Floats, Floats]]) -> Floats:
    """Evaluate the network from the sums of its first layer (cases, width); return its outputs (cases, 4)."""
    z = first
    for weight, bias in layers:
        z = _swish_in_place(z) @ weight.T
        z += bias
    return z


def _squared_mahalanobis(x: Floats, mean: Floats, inverse: Floats) -> Floats:
    d = x - mean
    return np.einsum("ij,ij->i", d @ inverse, d)


def _mirrored_sections(sections: Floats) -> Floats:
    flipped = sections.copy()
    flipped[:, _UPPER_SIDE_INPUTS], flipped[:, _LOWER_SIDE_INPUTS] = (
        -sections[:, _LOWER_SIDE_INPUTS],
        -sections[:, _UPPER_SIDE_INPUTS],
    )
    flipped[:, _NOSE_INPUT] = -sections[:, _NOSE_INPUT]
    return flipped


def _mirrored_flows(flows: Floats) -> Floats:
    flipped = flows.copy()
    flipped[:, 0] = -flows[:, 0]
    flipped[:, -2], flipped[:, -1] = flows[:, -1], flows[:, -2]  # where the sides turn turbulent
    return flipped


def _evaluate_network(section: Floats, flows: Floats, model: str) -> Array:
    """Compute confidence (before its sigmoid), CL, ln CD and CM, (n, 4), of a section (18,) in flows (n, 7)."""
    layers, mean, inverse = _load_network(model)
    (weight, bias), rest = layers[0], layers[1:]
    out = np.zeros((len(flows), 4))
    for part in np.array_split(np.arange(len(flows)), max(1, math.ceil(len(flows) / _BATCH_SIZE))):
        for sign in (1.0, -1.0):
            one, flow = section[None, :], flows[part]
            if sign < 0:
                one, flow = _mirrored_sections(one), _mirrored_flows(flow)
            y = _forward_pass(
                flow @ weight[:, _SECTION_SHAPE_INPUT_COUNT:].T
                + (one @ weight[:, :_SECTION_SHAPE_INPUT_COUNT].T + bias),
                rest,
            ).astype(np.float64)
            inputs = np.concatenate((np.repeat(one, len(flow), axis=0), flow), axis=1)
            y[:, 0] -= _squared_mahalanobis(inputs, mean, inverse) / (2 * len(mean))
            y[:, [_CL_OUTPUT, _CM_OUTPUT]] *= sign
            out[part] += 0.5 * y
    out[:, _CL_OUTPUT] /= 2
    out[:, _LOG_CD_OUTPUT] = (out[:, _LOG_CD_OUTPUT] - 2) * 2
    out[:, _CM_OUTPUT] /= 20
    return out


def compute_neuralfoil_polars(
    airfoils: Sequence[Airfoil],
    reynolds: ArrayLike,
    *,
    n_crit: float = 0.1,
    xtr: tuple[float, float] = (1.0, 1.0),
    model: str = "xlarge",
) -> list[EnginePolars]:
    """Compute polars of many airfoils.

    Parameters
    ----------
    airfoils : sequence of Airfoil
        Sections.
    reynolds : (nr,) array_like
        Chord Reynolds numbers.
    n_crit : float
        Amplification exponent at transition; 0.1 suits a vibrating rotor in its own wake (thesis, Table 3.1).
    xtr : (float, float)
        Forced transition on upper and lower side, x/c; 1 leaves transition free.
    model : str
        One of ``NEURALFOIL_MODELS``, by size.

    Returns
    -------
    list of EnginePolars
        One for each airfoil, from -20 to 20 degrees in steps of one; valid where the network is confident.

    Raises
    ------
    InputError
        If the network's 18 numbers cannot describe a contour (for instance a high Gurney flap).
    """
    re = np.atleast_1d(np.asarray(reynolds, dtype=np.float64))
    source = f"NeuralFoil {neuralfoil_version()} {model}, n_crit {n_crit:g}, transition at {xtr[0]:g}, {xtr[1]:g}"
    _load_network(model)

    # Products this small are slower on several BLAS threads than on one; the airfoils are distributed instead.
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(lambda airfoil: _compute_engine_polars(airfoil, re, n_crit, xtr, model, source), airfoils))


def _compute_engine_polars(
    airfoil: Airfoil, re: Array, n_crit: float, xtr: tuple[float, float], model: str, source: str
) -> EnginePolars:
    parameters, rotation, chord, _ = require_kulfan_fit(airfoil)
    section = parameters.astype(np.float32)
    section[-1] *= 50
    a, log_re = (v.ravel() for v in np.meshgrid(_ALPHA_GRID_RAD + rotation, np.log(re * chord)))
    rest = [np.full_like(a, v) for v in ((n_crit - 9) / 4.5, *xtr)]
    flows = np.column_stack((np.sin(2 * a), np.cos(a), np.sin(a) ** 2, (log_re - 12.5) / 3.5, *rest))
    y = _evaluate_network(section, flows.astype(np.float32), model).reshape(re.size, _ALPHA_GRID_RAD.size, 4)
    # The fit's chord differs from the contour's by a fraction of a per cent; the coefficients are scaled accordingly.
    cl, cd, cm = y[..., _CL_OUTPUT] * chord, np.exp(y[..., _LOG_CD_OUTPUT]) * chord, y[..., _CM_OUTPUT] * chord**2
    return EnginePolars(
        airfoil.name,
        _ALPHA_GRID_RAD.copy(),
        re.copy(),
        cl,
        cd,
        cm,
        np.ones(cl.shape, dtype=np.bool_),
        _mark_confident_points(y[..., 0], cl),
        source,
        n_crit,
        airfoil.thickness_ratio,
        airfoil.camber,
    )


def _mark_confident_points(logit: Array, cl: Array) -> NDArray[np.bool_]:
    """Return a mask (Reynolds numbers, angles) of the points around zero lift, up to the first of low confidence."""
    good = logit > math.log(MIN_CONFIDENCE / (1 - MIN_CONFIDENCE))
    trusted = np.zeros_like(good)
    for row, (g, lift) in enumerate(zip(good, cl, strict=True)):
        middle = int(np.argmin(np.abs(lift)))
        trusted[row, middle] = True
        for step in (1, -1):
            i = middle + step
            while 0 <= i < g.size and g[i]:
                trusted[row, i] = True
                i += step
    return trusted
