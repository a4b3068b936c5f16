"""Static output feedback on published plants: mufly's tuning against HIFOO and hinfstruct.

    python benchmarks/published_plants.py              all plants, about a minute
    python benchmarks/published_plants.py AC7 HE1

The plants are those of COMPleib (F. Leibfritz, 2004), each from the publication that it names below. A plant is

    x' = A x + B1 w + B u,    z = C1 x + D12 u,    y = C x + D21 w

and the controller a constant gain ``u = K y`` that minimises the H-infinity norm from w to z. Where COMPleib states no
weights, B1 is the identity, and z holds the states with the inputs added to the last of them.

Published norms: HIFOO and hinfstruct as tabled by D. Arzelier, E. Gryazina, D. Peaucelle and B. Polyak, "Mixed
LMI/randomized methods for static output feedback control design", American Control Conference 2010, the better of the
two. The quotations are not checked against the paper; of two values the smaller one stands here. Norms of the two
programs apart, from a second source, are in ``APART``.

Starts: gains from a normal distribution, made stabilising by descent of the largest real part of the poles. The tuning
descends from the best of them.
"""

from __future__ import annotations

import argparse
import time
from typing import NamedTuple

import numpy as np

from mufly.control.linear_systems import state_space
from mufly.control.synthesis.hinf import PartitionedPlant
from mufly.control.tuning.fixed_order import NormGoal, stack_controller_matrices, tune_controller
from mufly.control.tuning.nonsmooth_bfgs import minimise_nonsmooth

TOLERANCE = 1.02
STARTS = 12
_LEAST_DECAY = 1e-3


class PublishedPlant(NamedTuple):
    """A plant of COMPleib, its source, and the better published norm of static output feedback."""

    source: str
    gamma: float
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    B1: np.ndarray
    C1: np.ndarray
    D12: np.ndarray
    D21: np.ndarray

    @property
    def partitioned(self) -> PartitionedPlant:
        """Plant of the tuning."""
        D11 = np.zeros((len(self.C1), self.B1.shape[1]))
        D22 = np.zeros((len(self.C), self.B.shape[1]))
        return PartitionedPlant(self.A, self.B1, self.B, self.C1, self.C, D11, self.D12, self.D21, D22)


def _rows(text: str) -> np.ndarray:
    return np.array([[float(v) for v in row.split()] for row in text.split(";")])


def _plant(
    source: str, gamma: float, A: str, B: str, C: str, B1: str = "", C1: str = "", D12: str = "", D21: str = "",
    scale: float = 1.0,
) -> PublishedPlant:  # fmt: skip
    """Return a plant from its matrices by rows; ``scale`` multiplies C1 and D12."""
    a, b, c = _rows(A), _rows(B), _rows(C)
    n, m = b.shape
    if not B1:
        return PublishedPlant(
            source, gamma, a, b, c, np.eye(n), np.eye(n), np.vstack([np.zeros((n - m, m)), np.eye(m)]),
            np.zeros((len(c), n)),
        )  # fmt: skip
    b1 = np.eye(n) if B1 == "identity" else _rows(B1)
    d21 = _rows(D21) if D21 else np.zeros((len(c), b1.shape[1]))
    return PublishedPlant(source, gamma, a, b, c, b1, scale * _rows(C1), scale * _rows(D12), d21)


_AIRCRAFT = (
    "0 0 1.132 0 -1; 0 -.0538 -.1712 0 .0705; 0 0 0 1 0; 0 .0485 0 -.8556 -1.013; 0 -.2909 0 1.0532 -.6859",
    "0 0 0; -.12 1 0; 0 0 0; 4.419 0 -1.665; 1.575 0 -.0732",
)
_TRANSPORT = "-.037 .0123 .00055 -1; 0 0 1 0; -6.37 0 -.23 .0618; 1.25 0 .016 -.0457"
_TRANSPORT_INPUTS = ".00084 .000236; 0 0; .08 .804; -.0862 -.0665"
_FOUR_STATES = "1 0 0 0; 0 1 0 0; 0 0 1 0; 0 0 0 1; 0 0 0 0; 0 0 0 0"
_TWO_INPUTS = "0 0; 0 0; 0 0; 0 0; 1 0; 0 1"
PLANTS = {
    "AC2": _plant(
        "aircraft; Hung and MacFarlane, Multivariable Feedback, 1982", 0.1115, *_AIRCRAFT,
        "1 0 0 0 0; 0 1 0 0 0; 0 0 1 0 0",
        ".03593 0 .01672; 0 .00989 0; 0 -.07548 0; 0 0 .05635; .00145 0 .06743",
        "0 1 0 0 0; 0 0 1 0 0; 0 0 0 0 0; 0 0 0 0 0; 0 0 0 0 0", "0 0 0; 0 0 0; 1 0 0; 0 1 0; 0 0 1", scale=0.5**0.5,
    ),
    "AC7": _plant(
        "transport aircraft; Gangsaas et al., IEEE Trans. Autom. Control 31, 1986", 0.0651,
        "-.06254 .01888 0 -.56141 -.02751 0 .06254 -.00123 0; .01089 -.9928 .99795 .00097 -.07057 0 -.01089 .06449 0;"
        ".07743 1.6754 -1.31111 -.0003 -4.2503 0 -.07743 -.10883 0; 0 0 1 0 0 0 0 0 0; 0 0 0 0 -20 20 0 0 0;"
        "0 0 0 0 0 -30 0 0 0; 0 0 0 0 0 0 -.88206 0 0; 0 0 0 0 0 0 0 -.88206 .00882; 0 0 0 0 0 0 0 -.00882 -.88206",
        "0; 0; 0; 0; 0; 30; 0; 0; 0",
        "-.00519 .47604 .00098 -.00031 .03378 0 .00519 -.03086 0; 0 0 1 0 0 0 0 0 0",
        "0 0 0 0; 0 0 0 0; 0 0 0 0; 0 0 0 0; 0 0 0 0; 0 0 0 0; 1.3282 0 0 0; 0 1.62671 0 0; 0 -68.75283 0 0",
        "-.00519 .47604 .00098 -.00031 .03378 0 .00519 -.03086 0", "1", "0 0 0 0; 0 0 0 1", scale=0.5**0.5,
    ),
    "AC8": _plant(
        "transport aircraft in cruise; as AC7", 2.005,
        "-.01365 .178 .00017 -.561 -.03726 0 .01365 -.01311 0; -.01516 -.752 1.001 .00127 -.06311 0 .01516 .05536 0;"
        ".00107 .07896 -.8725 0 -3.399 0 -.00107 -.00581 0; 0 0 1 0 0 0 0 0 0; 0 0 0 0 -20 10.72 0 0 0;"
        "0 0 0 0 0 -50 0 0 0; 0 0 0 0 0 0 -.4447 0 0; 0 0 0 0 0 0 0 -.4447 .0044; 0 0 0 0 0 0 0 -.0044 -.4447",
        "0; 0; 0; 0; 0; 50; 0; 0; 0",
        ".00646 .3203 -.03358 0 -.1032 0 -.00646 -.02358 0; 1 0 0 0 0 0 -1 0 0;"
        "-.01365 .178 .00017 -.561 -.03726 0 .01365 -.01311 0; 0 -13.58 0 13.58 0 0 0 0 0; 0 0 1 0 0 0 0 0 0",
        "0 0 0 1 0 0 0 0 0 0; 0 0 0 0 0 0 0 0 0 0; 0 0 0 0 0 0 0 0 0 0; 0 0 0 0 0 0 0 0 0 0; 0 0 0 0 0 0 0 0 0 0;"
        "0 0 0 0 50 0 0 0 0 0; .9431 0 0 0 0 0 0 0 0 0; 0 1.155 0 0 0 0 0 0 0 0; 0 -48.82 0 0 0 0 0 0 0 0",
        ".00646 .3203 -.03358 0 -.1032 0 -.00646 -.02358 0; 1 0 0 0 0 0 -1 0 0", "1; 1",
        "0 0 0 0 0 0 0 1 0 0; 0 0 0 0 0 1 0 0 0 0; 0 0 0 0 0 0 1 0 0 0; 0 0 0 0 0 0 0 0 0 1; 0 0 0 0 0 0 0 0 1 0",
        scale=0.5,
    ),
    "AC15": _plant(
        "supersonic transport at Mach 2.7; IEEE Trans. Autom. Control 19, 257, 1974", 15.1689, _TRANSPORT,
        _TRANSPORT_INPUTS, "0 1 0 0; 0 0 1 0; 0 0 0 1", "identity", _FOUR_STATES, _TWO_INPUTS,
    ),
    "AC16": _plant(
        "as AC15 with all states measured", 14.8569, _TRANSPORT, _TRANSPORT_INPUTS,
        "1 0 0 0; 0 1 0 0; 0 0 1 0; 0 0 0 1", "identity", _FOUR_STATES, _TWO_INPUTS,
    ),
    "AC17": _plant(
        "lateral axis of an L-1011; Galimidi and Barmish, IEEE Trans. Autom. Control 31, 410, 1986", 6.6124,
        "-2.98 .93 0 -.034; -.99 -.21 .035 -.0011; 0 0 0 1; .39 -5.555 0 -1.89", "-.032; 0; 0; -1.6",
        "0 0 1 0; 0 0 0 1",
    ),
    "HE1": _plant(
        "VTOL helicopter; Singh and Coelho, J. Dyn. Syst. Meas. Control 106, 203, 1984", 0.1538,
        "-.0366 .0271 .0188 -.4555; .0482 -1.01 .0024 -4.0208; .1002 .3681 -.707 1.42; 0 0 1 0",
        ".4422 .1761; 3.5446 -7.5922; -5.52 4.49; 0 0", "0 1 0 0",
        ".04678 0; .04572 .00988; .04369 .00111; -.02179 0", "2 0 0 0; 0 1 0 0", "1 0; 0 1", scale=0.5**0.5,
    ),
    "REA1": _plant(
        "chemical reactor; Hung and MacFarlane, 1982", 0.8661,
        "1.38 -.2077 6.715 -5.676; -.5814 -4.29 0 .675; 1.067 4.273 -6.654 5.893; .048 4.273 1.343 -2.104",
        "0 0; 5.679 0; 1.136 -3.146; 1.136 0", "1 0 1 -1; 0 1 0 0; 0 0 1 -1",
    ),
    "REA2": _plant(
        "as REA1 without the last measurement", 1.1492,
        "1.4 -.208 6.715 -5.676; -.581 -4.29 0 .675; 1.067 4.273 -6.654 5.893; .048 4.273 1.343 -2.104",
        "0 0; 5.679 0; 1.136 -3.146; 1.136 0", "1 0 1 -1; 0 1 0 0",
    ),
    "DIS2": _plant(
        "two control stations; Liu and Sreeram, J. Optim. Theory Appl. 93, 1997", 1.0548,
        "-4 2 1; 3 -2 5; -7 0 3", "1 0; 1 0; 0 1", "0 1 0; 0 0 1",
    ),
    "DIS3": _plant(
        "interconnected system; Saif and Guan, Automatica 28, 215, 1992", 1.0624,
        "-1 0 0 0 0 0; -1 1 1 0 0 0; 1 -2 -1 -1 1 1; 0 0 0 -1 0 0; -8 1 -1 -1 -2 0; 4 -.5 .5 0 0 -4",
        "0 1 0 0; 1 0 0 0; 1 1 0 0; 0 0 0 -1; 0 0 1 0; 0 0 0 1",
        "0 1 0 0 0 0; 0 0 1 0 0 0; 0 0 0 0 1 0; 0 0 0 0 0 1",
    ),
    "AGS": _plant(
        "automobile gas turbine; Hung and MacFarlane, 1982", 8.1732,
        "0 1 0 0 0 0 0 0 0 0 0 0; -.202 -1.15 0 0 0 0 0 0 0 0 0 0; 0 0 0 1 0 0 0 0 0 0 0 0; 0 0 0 0 1 0 0 0 0 0 0 0;"
        "0 0 -2.36 -13.6 -12.8 0 0 0 0 0 0 0; 0 0 0 0 0 0 1 0 0 0 0 0; 0 0 0 0 0 0 0 1 0 0 0 0;"
        "0 0 0 0 0 -1.62 -9.4 -9.15 0 0 0 0; 0 0 0 0 0 0 0 0 0 1 0 0; 0 0 0 0 0 0 0 0 0 0 1 0;"
        "0 0 0 0 0 0 0 0 0 0 0 1; 0 0 0 0 0 0 0 0 -188 -111.6 -116.4 -20.8",
        "0 0; 1.0439 4.1486; 0 0; 0 0; -1.794 2.6775; 0 0; 0 0; 1.0439 4.1486; 0 0; 0 0; 0 0; -1.794 2.6775",
        ".264 .806 -1.42 -15 0 0 0 0 0 0 0 0; 0 0 0 0 0 4.9 2.12 1.95 9.35 25.8 7.14 0",
    ),
}  # fmt: skip

APART = {"AC15": (15.2919, 15.2)}
"""Norms by HIFOO and by hinfstruct from the program of X. Guo, D. Keivan, G. Dullerud, P. Seiler and B. Hu, "Complexity
of derivative-free policy optimization for structured H-infinity control", NeurIPS 2023."""


def stabilising_gains(plant: PublishedPlant, count: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Return up to ``count`` static gains with stable loops, from random ones by descent of the spectral abscissa."""
    shape = plant.B.shape[1], len(plant.C)
    found: list[np.ndarray] = []

    def abscissa(x: np.ndarray) -> tuple[float, np.ndarray]:
        values, V = np.linalg.eig(plant.A + plant.B @ x.reshape(shape) @ plant.C)
        k = int(np.argmax(values.real))
        left = np.linalg.inv(V)[k]
        return float(values[k].real), np.outer(left @ plant.B, plant.C @ V[:, k]).real.ravel()

    for k in range(10 * count):
        x = rng.normal(size=shape[0] * shape[1]) * 10.0 ** rng.uniform(-2.0, 1.0)
        if abscissa(x)[0] > -_LEAST_DECAY:
            x = minimise_nonsmooth(abscissa, x, max_steps=200, enough=-10.0 * _LEAST_DECAY).x
        if abscissa(x)[0] < -_LEAST_DECAY:
            found.append(x.reshape(shape))
        if len(found) == count:
            break
        if k == 0 and abscissa(0.0 * x)[0] < -_LEAST_DECAY:
            found.append(1e-3 * x.reshape(shape))
    return found


def tuned_norm(plant: PublishedPlant, seed: int = 0) -> tuple[float, np.ndarray]:
    """Return the smallest norm found with a static gain, and the gain."""
    goal = NormGoal("norm", plant.partitioned, plant.gamma)
    inputs, outputs = ([f"{name}{i}" for i in range(n)] for name, n in (("y", len(plant.C)), ("u", plant.B.shape[1])))
    starts = [
        state_space(
            np.zeros((0, 0)), np.zeros((0, len(inputs))), np.zeros((len(outputs), 0)), K, inputs=inputs, outputs=outputs
        )
        for K in stabilising_gains(plant, STARTS, np.random.default_rng(seed))
    ]
    found = tune_controller([goal], starts, descents=6, max_steps=600, budget_s=20.0)
    return found.norms["norm"], stack_controller_matrices(found.controller)


def main() -> int:
    """Print the table; return 1 if a norm exceeds the published one by more than 2 %."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("plants", nargs="*", metavar="PLANT", help=f"of {', '.join(PLANTS)}; all by default")
    wanted = parser.parse_args().plants or list(PLANTS)
    worst = 0.0
    print("plant  states  gain     mufly  published  ratio  time s  HIFOO, hinfstruct  source")
    for name in wanted:
        began = time.process_time()
        plant = PLANTS[name]
        norm, _ = tuned_norm(plant)
        ratio = norm / plant.gamma
        apart = ", ".join(f"{g:g}" for g in APART.get(name, ())) or "-"
        worst = max(worst, ratio)
        print(
            f"{name:6} {len(plant.A):6d} {plant.B.shape[1]:3d}x{len(plant.C)} {norm:9.4f} {plant.gamma:10.4f} "
            f"{ratio:6.4f} {time.process_time() - began:7.1f}  {apart:17}  {plant.source}",
            flush=True,
        )
    print(f"worst ratio {worst:.4f}; target {TOLERANCE}")
    return int(worst > TOLERANCE)


if __name__ == "__main__":
    raise SystemExit(main())
