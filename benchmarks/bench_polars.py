"""Time polars: one airfoil, 247 at once, fresh and from the cache, and reading a table."""

import argparse
import os
import tempfile
import time

import numpy as np

argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()

with tempfile.TemporaryDirectory() as folder:
    os.environ["MUFLY_CACHE"] = folder
    from mufly.rotor import (
        compute_airfoil_polars,
        compute_polar,
        list_database_airfoils,
        load_airfoil,
        lookup_lift_drag,
    )
    from mufly.rotor.sections.polar_engines import DEFAULT_REYNOLDS

    def timed(what, function, repeat=1):
        times = []
        for _ in range(repeat):
            start = time.perf_counter()
            result = function()
            times.append(time.perf_counter() - start)
        print(f"{what:<60} {1e3 * min(times):9.2f} ms")
        return result

    timed("first polar, weights read", lambda: compute_polar("naca4412"))
    timed("one polar, new section", lambda: compute_polar("naca4411"))
    table = timed("one polar, from the cache", lambda: compute_polar("naca4412"), 5)
    names = list_database_airfoils()[::8][:247]
    sections = [load_airfoil(n) for n in names]
    cases = len(sections) * DEFAULT_REYNOLDS.size * 41
    timed(f"{len(sections)} airfoils, {cases} cases, fresh", lambda: compute_airfoil_polars(sections))
    timed(f"{len(sections)} airfoils, from the cache", lambda: compute_airfoil_polars(sections), 3)
    rng = np.random.default_rng(0)
    alpha, reynolds = rng.uniform(-0.2, 0.3, 1_000_000), np.exp(rng.uniform(8, 12, 1_000_000))
    lookup_lift_drag(table, 0.0, 1e4)
    timed("a million points read from a table", lambda: lookup_lift_drag(table, alpha, reynolds), 5)
