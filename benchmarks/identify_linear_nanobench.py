"""Linear models of a quadrotor under feedback, two ways: output error on half a flight, equation error on whole ones.

    python benchmarks/identify_linear_nanobench.py FOLDER

FOLDER holds the four flights of nanobench (CSV, gzipped). Fitted: figure eight and slow trefoil; held out: circle and
medium trefoil, of which nothing is taken. Inputs are sums of the motors' commands over full scale; angles and rates are
turned to z down.
"""

import sys
from pathlib import Path

import numpy as np

from mufly.errors import InputError
from mufly.identify import EvenLogTable, identify_linear_model
from mufly.identify.linear.equation_model import (
    SCORES_EXPLANATION,
    equation_table,
    identify_equation_model,
    score_table,
)

FITTED, HELD = ("figure8", "pid_trefoil"), ("circle", "mellinger")


def read(path: Path) -> EvenLogTable:
    """The part of a flight in the air, on an even clock."""
    d = np.genfromtxt(path, delimiter=",", names=True)
    motor = np.column_stack([d[f"motor_motor_m{k}"] for k in (1, 2, 3, 4)]) / 65535.0
    air = np.flatnonzero((motor.mean(axis=1) > 0.3) & (d["pz"] > 0.15))
    t = d["t"] - d["t"][0]
    even = np.arange(t[air[0]], t[air[-1]], 0.01)
    signs = {"lat": (-1, -1, 1, 1), "lon": (1, -1, -1, 1), "ped": (-1, 1, -1, 1), "col": (1, 1, 1, 1)}
    found = {name: motor @ np.array(s) / 4.0 for name, s in signs.items()}
    found |= {"p": d["imu_gyro_x"], "q": -d["imu_gyro_y"], "r": -d["imu_gyro_z"]}
    return EvenLogTable(path.name, even, {k: np.interp(even, t, v) for k, v in found.items()})


def show(rows: tuple) -> None:
    for row in (rows[0], *rows[1]):
        print("  ".join(f"{c:>12}" for c in row))


def main() -> None:
    """Print both."""
    flights = {p.name: read(p) for p in sorted(Path(sys.argv[1]).glob("*.csv.gz"))}
    fitted, held = ([f for n, f in flights.items() if any(w in n for w in some)] for some in (FITTED, HELD))
    print("Output error, first-order, first half of each flight; simulated second half, per cent")
    for f in (*fitted, *held):
        try:
            r = identify_linear_model(
                f, {"lat": "lat", "lon": "lon"}, {"p": "p", "q": "q"}, model="first-order", starts=3
            )
            print(
                f.name,
                *(f"{o} {c.slow.fit_percent:.1f}" for o, c in zip("pq", r.checks["held out"], strict=True)),
            )
        except InputError as error:
            print(f.name, error)
    inputs, outputs = ({n: n for n in names} for names in (("lat", "lon", "ped", "col"), ("p", "q", "r")))
    for domain in ("frequency", "time"):
        for without in ((), ("L_p", "M_q", "N_r", "N_p", "N_q")):
            m = identify_equation_model(
                fitted, inputs, outputs, held_out=held, domain=domain, without=without, cut_hz=10.0
            )
            print(f"\nEquation error, {domain} domain" + (f", without {', '.join(without)}" if without else ""))
            show(equation_table(m))
            show(score_table(m))
    print(SCORES_EXPLANATION)


if __name__ == "__main__":
    main()
