"""How often 95 % intervals of a linear fit hold the truth, with white and with coloured residuals.

    python benchmarks/identify_linear_coverage.py [SEEDS] [--record]

Roll and pitch rates of a coupled first-order model, 60 s at 25 Hz, steps of both sticks, noise of standard deviation
0.05 rad/s: white, or first-order with a pole at 0.9. Counts all
parameters (eight derivatives, two delays) of all seeds.
"""

import sys

import numpy as np
from figure_record import take_record_option
from scipy.signal import lfilter

from mufly.identify.flight_record import low_pass
from mufly.identify.linear.linear_fit import fit_linear_model
from mufly.identify.linear.linear_structure import simulate_linear_structure, structure_by_name

DT, SAMPLES = 0.04, 1500
TRUTH = {
    "L_p": -6.0, "L_q": 1.5, "L_lat": 18.0, "L_lon": -5.0, "M_q": -3.0, "M_p": 1.0, "M_lat": 3.0, "M_lon": 12.0,
    "tau_lat": 0.08, "tau_lon": 0.05,
}  # fmt: skip


def main() -> None:
    record = take_record_option(sys.argv)
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    structure = structure_by_name("first-order-coupled", ("lat", "lon"), ("p", "q"))
    truth = np.array([TRUTH[s] for s in structure.symbols])
    held = []
    for pole in (0.0, 0.9):
        corrected, plain = [], []
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            u = 0.1 * low_pass(np.repeat(rng.normal(size=(SAMPLES // 20, 2)), 20, axis=0), DT, 2.0)
            y, _ = simulate_linear_structure(structure, truth, u, DT)
            noise = lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], rng.normal(size=y.shape), axis=0)
            f = fit_linear_model(structure, u, y + 0.05 * noise, DT, starts=1)
            off = np.abs(f.values - truth)
            corrected.append(off < 1.96 * np.sqrt(np.diag(f.covariance)))
            plain.append(off < 1.96 * np.sqrt(np.diag(f.bound)))
        held.append(100 * np.mean(corrected))
        print(f"pole {pole}: corrected {100 * np.mean(corrected):.1f} %, plain bounds {100 * np.mean(plain):.1f} %")
    record("identify_linear", *held)


if __name__ == "__main__":
    main()
