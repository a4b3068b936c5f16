"""Studies: the ranking of 247 airfoils, sweeps of growing size, gear ratio curves, an optimisation.

    python benchmarks/bench_studies.py

Target: 247 airfoils over 15 pitch settings with the gear adapted to 0.4 N in under 10 s on two cores, polars included;
time linear in the number of cases.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mufly.drive import find_gear_optima, load_drive, make_coefficient_load, sweep_gear_ratio
from mufly.rotor import load_rotor
from mufly.study import (
    StudySetup,
    list_thesis_airfoils,
    optimise_rotor,
    parse_design_limit,
    rank_airfoils,
    sweep_parameters,
)

PITCH = [float(p) for p in np.radians(np.arange(6.0, 20.1, 1.0))]


def seconds(task: Callable[[], object]) -> float:
    """Time of one run (s)."""
    start = time.perf_counter()
    task()
    return time.perf_counter() - start


def main() -> None:
    """Print the numbers."""
    os.environ["MUFLY_CACHE"] = "off"  # polars are computed, not read
    setup = StudySetup(
        load_rotor("naca4412-r60-c20"),
        load_drive("mufly"),
        {"thrust": 0.4, "gear": "adapted"},
        with_outside_share=False,
    )
    first = seconds(lambda: sweep_parameters(setup, {"pitch": PITCH}))
    print(f"15 pitch settings, the very first call of this process     {first:8.2f} s")
    names = list_thesis_airfoils()
    whole = seconds(lambda: rank_airfoils(setup, names, PITCH))
    print(f"247 airfoils x 15 pitch settings, polars computed (< 10 s) {whole:8.2f} s")
    again = seconds(lambda: rank_airfoils(setup, names, PITCH))
    print(f"the same again in this process                             {again:8.2f} s")
    for n in (10, 100, 1000):
        vary = {"radius": np.linspace(0.05, 0.08, n).tolist(), "pitch": PITCH}
        spent = seconds(lambda vary=vary: sweep_parameters(setup, vary))
        each = spent / 15 / n * 1e3
        print(f"sweep of {15 * n:6d} cases, {n:4d} rotors                       {spent:8.2f} s  {each:.3f} ms a case")
    flagged = replace(setup, with_outside_share=True)
    vary = {"radius": np.linspace(0.05, 0.08, 100).tolist(), "pitch": PITCH}
    spent = seconds(lambda: sweep_parameters(flagged, vary))
    print(f"1500 cases with the share beyond the polars                {spent:8.2f} s")
    load = make_coefficient_load(0.0138, 0.0025, radius_m=0.0875)
    assert setup.drive is not None
    drive = setup.drive
    spent = seconds(lambda: sweep_gear_ratio(drive, load, np.linspace(0.5, 8.0, 1000)))
    print(f"gear curve of 1000 ratios, constant coefficients           {spent * 1e3:8.2f} ms")
    spent = seconds(lambda: find_gear_optima(drive, load, thrust_N=0.6))
    print(f"its optima                                                 {spent * 1e3:8.2f} ms")
    free = ["chord", "twist", "taper", "radius", "airfoil", "gear"]
    limits = [parse_design_limit("thickness_mm>=0.8"), parse_design_limit("radius<=60mm")]
    start = replace(setup, fixed_parameters={"thrust": 0.4})
    spent = seconds(lambda: optimise_rotor(start, "endurance", free, limits=limits, airfoils=names))
    print(f"optimisation of six things, 247 airfoils to choose from    {spent:8.2f} s")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    main()
