"""Cramer-Rao bound of a camera's turn and focal length, by the motion of the demonstration.

    python benchmarks/camera_bound.py --seeds 3

The footprint of the camera moves by P(t) pixels, as N + i E: with the vehicle over the height, and with its tilt. A
camera that is turned by a, or whose focal length is wrong by the factor s, shows s e^(i a) P. The inertial unit gives
P up to a start (unknown), a velocity (5 cm/s) and the filter's tilt error delta, a Gauss-Markov process, which adds
-f delta + f g / h times its second integral. With the noise of a picture's place (pixels) this gives the covariance S
of y - P, and both a (rad) and s have the variance 1 / (P^H S^-1 P). A flight takes some 10 s of one core. Own
derivation.
"""

from __future__ import annotations

import argparse
import math

import numpy as np
from fly_on_estimates import GUST, WIND

from mufly.camera import load_camera
from mufly.dynamics import GRAVITY
from mufly.flight import fly_mission

TILT_SIGMA_RAD, TILT_TIME_S, VELOCITY_SIGMA_M_S = math.radians(0.16), 20.0, 0.05
SEEN_M, RATE_HZ = 0.3, 30.0


def bound_turn(path: np.ndarray, tilt: np.ndarray, heading: np.ndarray, focal_px: float, noise_px: float) -> float:
    """Return the bound of the turn (rad), equal to that of the relative focal length.

    Parameters
    ----------
    path : (n, 3) array
        N, E, D at the camera's rate (m).
    tilt : (n, 2) array
        Roll, pitch (rad).
    heading : (n,) array
        Heading (rad).
    focal_px : float
    noise_px : float
        Standard deviation of a picture's place (pixels).
    """
    n, dt, over_height = len(path), 1.0 / RATE_HZ, -focal_px / path[:, 2]
    moved = np.gradient(path[:, 0] + 1j * path[:, 1])
    footprint = np.cumsum(over_height * moved) + focal_px * np.exp(1j * heading) * (tilt[:, 1] - 1j * tilt[:, 0])
    sums = np.tril(np.ones((n, n))) * dt
    effect = focal_px * np.eye(n) - GRAVITY * over_height[:, None] * (sums @ sums)
    times = dt * np.arange(n)
    tilts = TILT_SIGMA_RAD**2 * np.exp(-np.abs(times[:, None] - times) / TILT_TIME_S)
    drift = VELOCITY_SIGMA_M_S * np.cumsum(over_height) * dt
    covariance = noise_px**2 * np.eye(n) + effect @ tilts @ effect.T + np.outer(drift, drift) + 1e4
    return 1.0 / math.sqrt(np.vdot(footprint, np.linalg.solve(covariance, footprint)).real)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--times", default="1,2,3,5,7,9,12,18", help="after the height of 0.3 m (s)")
    parser.add_argument("--noise", type=float, default=0.3, help="of a picture's place (pixels); by vibration 1 to 2")
    a = parser.parse_args()
    focal_px, times = float(load_camera("mufly-2.0").lens.focal_x), [float(x) for x in a.times.split(",")]
    bounds: list[list[float]] = []
    for seed in range(a.seeds):
        data = fly_mission("mufly-1.1", "demonstration", seed=seed, sensors="fitted", wind=WIND, gust=GUST)
        t, place, attitude = (data[name].values for name in ("time", "truth_position", "truth_attitude"))
        begin = t[int(np.argmax(-place[:, 2] > SEEN_M))]
        bounds.append([])
        for span in times:
            at = np.arange(begin, begin + span, 1.0 / RATE_HZ)
            path, angles = (
                np.stack([np.interp(at, t, c) for c in q.T], axis=1) for q in (place, np.unwrap(attitude, axis=0))
            )
            bounds[-1].append(bound_turn(path, angles[:, :2], angles[:, 2], focal_px, a.noise))
    for span, *each in zip(times, *bounds, strict=True):
        turns = " ".join(f"{math.degrees(b):.1f}" for b in each)
        print(f"{span:g} s: turn {turns} degrees, focal length {' '.join(f'{100 * b:.1f}' for b in each)} % (1 sigma)")


if __name__ == "__main__":
    main()
