"""Does the identification find the truth, and do its intervals say how well? Many noise seeds of the demonstration.

    python benchmarks/identify_seeds.py [--seeds 20] [--first 0] [--cma 0] [--moving] [--json]

For every seed twelve parameters start 50 % off. Printed: which converged, how often the truth is inside the 95 %
intervals, prediction error of the flight that the fit did not see over the sensors' noise, seconds. ``--cma N`` repeats
the first N seeds by CMA-ES and compares the costs; ``--moving`` begins the records in mid-flight.
"""

from __future__ import annotations

import argparse
import json
import os
import time

import numpy as np
from figure_record import RECORD_HELP, make_recorder

from mufly.identify import FitResult, run_identification_demo
from mufly.identify.flight.identification_demo import DEMO_FREE_SYMBOLS


def cost_of(fit: FitResult, judge: FitResult) -> float:
    """Half the sum of squares of a fit's residuals over the noise that another fit found."""
    pairs = zip(fit.records_with_role("fit"), judge.records_with_role("fit"), strict=True)
    return sum(0.5 * float(np.nansum((a.residual / b.noise_std) ** 2)) for a, b in pairs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--cma", type=int, default=0, help="repeat so many seeds by CMA-ES")
    parser.add_argument("--moving", action="store_true", help="records begin in mid-flight")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--record", action="store_true", help=RECORD_HELP)
    arguments = parser.parse_args()
    run_identification_demo(seed=10_000)  # compiles
    cpu_start = time.process_time()
    rows = []
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        demo = run_identification_demo(seed=seed, moving=arguments.moving)
        row = {
            "seed": seed,
            "converged": demo.fit.converged,
            "cost": demo.fit.cost,
            "inside": demo.truth_inside_interval(),
            "worst_error": max(abs(e.value / demo.truth[e.symbol] - 1) for e in demo.fit.estimates),
            "held_out": demo.held_out_over_noise,
            "seconds": demo.fit.seconds,
            "simulations": demo.fit.simulations,
            "message": demo.fit.message,
        }
        if seed - arguments.first < arguments.cma:
            other = run_identification_demo(seed=seed, method="cma", moving=arguments.moving)
            row["cma"] = {
                "cost_above_lm": cost_of(other.fit, demo.fit) - cost_of(demo.fit, demo.fit),
                "seconds": other.fit.seconds, "simulations": other.fit.simulations,
                "largest_difference_in_std": max(
                    abs(a.value - b.value) / b.std
                    for a, b in zip(other.fit.estimates, demo.fit.estimates, strict=True)
                ),
            }  # fmt: skip
        rows.append(row)
        if not arguments.json:
            print(
                f"seed {seed:3d}: {'converged' if row['converged'] else 'NOT converged'}, {sum(row['inside'].values())}"
                f" of {len(DEMO_FREE_SYMBOLS)} inside, worst {100 * row['worst_error']:.2f} %, held out "
                f"{row['held_out']:.3f}, "
                f"{row['seconds']:.1f} s, {row['simulations']} simulations, load {os.getloadavg()[0]:.1f}"
                + (f", CMA-ES {row['cma']}" if "cma" in row else ""),
                flush=True,
            )
    inside = np.array([[r["inside"][s] for s in DEMO_FREE_SYMBOLS] for r in rows])
    summary = {
        "seeds": len(rows),
        "converged": sum(r["converged"] for r in rows),
        "inside_share": float(inside.mean()),
        "inside_by_parameter": dict(zip(DEMO_FREE_SYMBOLS, inside.mean(axis=0).tolist(), strict=True)),
        "held_out_worst": max(r["held_out"] for r in rows),
        "seconds_median": float(np.median([r["seconds"] for r in rows])),
        "seconds_worst": max(r["seconds"] for r in rows),
        "processor_seconds_a_seed": (time.process_time() - cpu_start) / len(rows),
        "load_average": os.getloadavg()[0],
    }
    record = make_recorder(arguments.record)
    record("identify_converged", summary["converged"])
    record("identify_inside", 100 * summary["inside_share"])
    record("identify_held_out", summary["held_out_worst"])
    print(json.dumps({"summary": summary, "rows": rows} if arguments.json else summary, indent=2))


if __name__ == "__main__":
    main()
