"""Do intervals hold the truth for other vehicles, when what is held is not exactly right either?

    python benchmarks/identify_vehicles.py [--vehicles 20] [--first 0] [--moving] [--held 0.02] [--exact] [--json FILE]

Each vehicle differs from mufly-1.1 by up to 40 % in every free parameter (twelve, the delay among them; evenly, up or
down), and in every held one by a draw from its own doubt, normal in ``ln value``: the ``std`` that the vehicle file
states, or that of its source (``PROVENANCE_DOUBT``, measured 2 %, datasheet 10 %, CAD 15 %, identified 5 %, estimated
20 %). A vehicle that the schema refuses, or that the pilot's support cannot hold (attitude beyond 35 degrees, 2 m of
height), is drawn again; how often is printed. The fit starts from mufly-1.1 itself. ``--exact`` leaves the doubt of
what is held out of the intervals, as they were before; ``--held`` states one relative deviation for all of it.
``--moving`` begins the records in mid-flight.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
from figure_record import RECORD_HELP, make_recorder

from mufly.errors import MuflyError
from mufly.identify import choose_free_parameters, fit_flight_records
from mufly.identify.flight.free_parameters import list_held_parameters
from mufly.identify.flight.identification_demo import (
    DEMO_FREE_SYMBOLS,
    RADIO_DELAY_S,
    fly_demo_flights,
    rms_over_true_noise,
)
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters

OFF = 0.4


def drawn(nominal, rng, seed, moving):
    """Return the true values of what is free of a vehicle that can be flown, its flights, and draws in vain."""
    rows = {r.symbol: r for r in list_parameters(nominal)}
    free = choose_free_parameters(nominal, [s for s in DEMO_FREE_SYMBOLS if s != "delay"], ("height", "yaw"))
    held = [h for h in list_held_parameters(nominal, free, 0.0, None) if h.key]
    for vain in range(200):
        values = {rows[f.symbol].key: f.start_value * rng.uniform(1 - OFF, 1 + OFF) for f in free}
        values |= {h.key: h.start_value * math.exp(h.prior_std * rng.standard_normal()) for h in held}
        try:
            vehicle = replace_parameters(nominal, values)
            flights, others = fly_demo_flights(vehicle, seed=seed, moving=moving)
        except MuflyError:
            continue
        if all(_held_up(r) for r in (*flights, *others)):
            return {f.symbol: values[f.key] for f in free}, flights, others, vain
    raise SystemExit("no vehicle in 200 could be flown")


def stated(vehicle, share):
    """Return the vehicle with this relative standard deviation stated for every scalar that is not zero."""
    tables = vehicle.model_dump(exclude_none=True)
    for row in list_parameters(vehicle):
        if isinstance(row.value, float):
            table = tables
            for part in row.key.split("."):
                table = table[part]
            table["std"] = share * abs(row.value)
    return Vehicle.model_validate(tables)


def _held_up(record) -> bool:
    of = dict(zip(record.outputs, record.measured.T, strict=True))
    tilt = max(np.abs(of["roll"]).max(), np.abs(of["pitch"]).max())
    return bool(np.isfinite(record.measured).all() and tilt < math.radians(35) and np.ptp(of["height"]) < 2.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--moving", action="store_true")
    parser.add_argument("--held", type=float, help="relative standard deviation of all that is held")
    parser.add_argument("--exact", action="store_true")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--record", action="store_true", help=RECORD_HELP)
    a = parser.parse_args()
    nominal, rows = load_vehicle("mufly-1.1"), []
    if a.held is not None:
        nominal = stated(nominal, a.held)
    for seed in range(a.first, a.first + a.vehicles):
        rng = np.random.default_rng([seed, 2])
        truth, flights, others, vain = drawn(nominal, rng, seed, a.moving)
        truth["delay"] = RADIO_DELAY_S
        free = choose_free_parameters(
            nominal,
            DEMO_FREE_SYMBOLS,
            flights[0].outputs,
            delay_s=RADIO_DELAY_S * rng.uniform(1 - OFF, 1 + OFF),
        )
        fit = fit_flight_records(nominal, free, flights, held_out=others, held_exact=a.exact)
        inside = {e.symbol: e.low <= truth[e.symbol] <= e.high for e in fit.estimates}
        sigmas = {e.symbol: (e.value - truth[e.symbol]) / e.std for e in fit.estimates}
        rows.append(
            {"seed": seed, "converged": fit.converged, "inside": inside, "sigmas": sigmas, "vain": vain,
             "held_out": rms_over_true_noise(fit.records[-1]), "message": fit.message, "truth": truth,
             "estimates": [asdict(e) for e in fit.estimates], "seconds": fit.seconds}
        )  # fmt: skip
        worst = max(sigmas, key=lambda s: abs(sigmas[s]))
        print(
            f"vehicle {seed:3d}: {'converged' if fit.converged else 'NOT converged'}, {sum(inside.values())} of "
            f"{len(inside)} inside, worst {worst} {sigmas[worst]:+.1f} sigma, held out {rows[-1]['held_out']:.2f}, "
            f"drawn anew {vain}, {fit.seconds:.0f} s; {fit.message[:160]}",
            flush=True,
        )
        if a.json is not None:
            a.json.write_text(json.dumps(rows, indent=1, default=float))
    table = np.array([[r["inside"][s] for s in DEMO_FREE_SYMBOLS] for r in rows])
    print(f"{table.sum()} of {table.size} inside, {100 * table.mean():.1f} %")
    make_recorder(a.record)("identify_vehicles", 100 * table.mean())
    print(f"{sum(r['converged'] for r in rows)} of {len(rows)} converged")
    print({s: round(float(v), 2) for s, v in zip(DEMO_FREE_SYMBOLS, table.mean(axis=0), strict=True)})


if __name__ == "__main__":
    main()
