"""Rotors in forward flight and vertical descent beside measurements that the project does not hold.

    python benchmarks/validate_forward.py FOLDER [--record]

FOLDER has ``inflow/mu_015.csv`` and ``inflow/mu_023.csv`` (psi, r/R, mean, ...: induced inflow over the tip speed;
Elliott, Althoff and Sailey, NASA TM-100541 and TM-100542, 1988) and ``dynbem/`` with the tables of Castles and Gray
(NACA TN 2474, 1951) and of Wheatley and Hood (NACA TR 515, 1935), digitised in mcroomp/dynbem. Parts that are missing
are skipped. Nothing is fitted but the pitch setting of each table of TR 515, which the files do not hold.
"""

from __future__ import annotations

import argparse
import csv
import math
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from figure_record import RECORD_HELP, make_recorder
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import brentq, fsolve

from mufly.errors import MuflyError
from mufly.rotor import Air, make_rotor, prepare_blading
from mufly.rotor.forward import ForwardCondition, RigidFlapMode, solve_forward

INFLOW_RUNS = (("015", 28.50, -3.0), ("023", 43.86, -3.04))  # airspeed (m/s), angle of the tip path plane (deg)


def read_numbers(path: Path, count: int) -> np.ndarray:
    """Rows of a table whose first ``count`` cells are numbers; a leading flag is left out, a dash is nan."""
    rows = []
    for cells in list(csv.reader(path.open(encoding="utf-8")))[1:]:
        cells = cells[1:] if cells and not cells[0].strip() else cells
        try:
            rows.append([math.nan if c.strip() in ("", "-") else float(c) for c in cells[:count]])
        except ValueError:
            continue
    return np.array([r for r in rows if len(r) == count])


def compare_inflow(folder: Path, record: Callable[..., None]) -> None:
    """Induced inflow of a four-bladed rotor, trimmed to C_T 0.0064 without flapping; chord, twist, cut-out assumed."""
    radius, speed = 0.860552, 2113 * math.pi / 30
    tip = speed * radius
    rotor = make_rotor(
        name="r", radius_m=radius, chord_m=0.066, twist_rad=np.radians([0.0, -8.0]), airfoils="naca0012",
        r_over_R=(0.0, 1.0), blades=4, hub_cutout=0.24,
    )  # fmt: skip
    blading, flap = prepare_blading(rotor, n_crit=9.0), RigidFlapMode(1.0, 0.03)
    kept = []
    for name, airspeed, degrees in INFLOW_RUNS:
        data = read_numbers(folder / f"mu_{name}.csv", 3)
        data = data[np.isfinite(data).all(axis=1) & (data[:, 1] >= 0.2) & (data[:, 1] <= 1.0)]
        angle = math.radians(degrees)
        for model in ("annular", "pitt-peters", "uniform"):
            edgewise, axial = airspeed * math.cos(angle), -airspeed * math.sin(angle)

            def solve(x, edgewise=edgewise, axial=axial, model=model):
                c = ForwardCondition(x[0], speed, edgewise, axial, cyclic_rad=(x[1], x[2]))
                return solve_forward(blading, c, flap, inflow=model)

            def miss_trim(x, solve=solve):
                found = solve(x)
                return [found.c_T - 0.0064, 0.01 * found.flap_cos_rad, 0.01 * found.flap_sin_rad]

            disc = solve(fsolve(miss_trim, [0.2, 0.03, -0.04])).disc
            psi = np.append(disc.azimuth_rad, 2.0 * math.pi)
            field = np.vstack([disc.axial_induced_m_s, disc.axial_induced_m_s[:1]]) / tip
            at = RegularGridInterpolator((psi, disc.r_m / radius), field, bounds_error=False, fill_value=None)
            miss = at(np.column_stack((np.radians(data[:, 0]), data[:, 1]))) + data[:, 2]
            weighted = math.sqrt(np.average(miss**2, weights=data[:, 1]))
            if model == "annular":
                kept.append(weighted)
            print(
                f"inflow mu 0.{name[1:]} {model:12s} {len(data)} points: rms {weighted:.4f} over the disc's area, "
                f"{math.sqrt(np.mean(miss**2)):.4f} over the points; mean {np.mean(miss):+.4f}"
            )
    record("forward_inflow", *kept)


def compare_descent(folder: Path, record: Callable[..., None]) -> None:
    """Vertical descent of the 6 ft rotor (constant chord, no twist, NACA 0015, solidity 0.05), Tables I and V.

    The torque of the tables is that above zero lift. The pitch is the measured one, so that errors of thrust in hover
    stay in the descent. In hover at c_T 0.004 and 1200 rpm the runs give torques of 2.26 to 2.92e-4, the model 2.14e-4:
    no model is within 10 % of all. Above 2 v_h the authors reduce induced velocities of 1.0 to 1.6 v_h from thrust and
    from torque; momentum theory gives 0.5 to 1.0.
    """
    radius = 0.9144
    rotor = make_rotor(name="c", radius_m=radius, chord_m=0.0479, airfoils="naca0015", blades=3, hub_cutout=0.15)
    blading, flap = prepare_blading(rotor), RigidFlapMode(1.0, 0.05)
    groups: dict[str, list[tuple[float, float]]] = {}
    hovers: dict[tuple[float, float], list[float]] = {}
    changes: dict[str, list[float]] = {}
    failed = 0
    for path in sorted(folder.glob("Castles*table_i__run*")) + sorted(folder.glob("Castles*table_v__run*")):
        rpm = float(re.search(r"_(\d+)_rpm", path.name)[1])
        omega = rpm * math.pi / 30
        bare = solve_forward(blading, ForwardCondition(0.0, omega), flap).c_Q
        hover = "table_v__" in path.name
        own_hover = math.nan
        nominal = math.nan if hover else 1e-3 * int(re.search(r"ct_0_00(\d)", path.name)[1])
        for row in read_numbers(path, 3 if hover else 4):
            if hover:
                pitch, c_t, c_q, sink, share = row[0], row[1], row[2], 0.0, 0.0
                if pitch < 4.0:
                    continue
            else:
                sink, pitch, c_q, share = row
                c_t = nominal
                share = sink / math.sqrt(0.5 * c_t)
            try:
                got = solve_forward(
                    blading, ForwardCondition(math.radians(pitch), omega, climb_m_s=-sink * omega * radius), flap
                )
            except MuflyError:
                failed += 1
                continue
            name = (
                "hover"
                if share < 0.01
                else "0 to 0.5"
                if share < 0.5
                else "0.5 to 2 (ring)"
                if share < 2.0
                else "above 2"
            )
            torque_error = (got.c_Q - bare - c_q) / 3e-4
            groups.setdefault(name, []).append((got.c_T / c_t - 1.0, torque_error))
            if name == "hover":
                own_hover = torque_error
                if abs(1e3 * c_t - round(1e3 * c_t)) < 0.04 * 1e3 * c_t:
                    hovers.setdefault((round(1e3 * c_t), rpm), []).append(c_q)
            else:
                changes.setdefault(name, []).append(torque_error - own_hover)
    for name, errors in groups.items():
        thrust, torque = np.array(errors).T
        torque = torque[np.isfinite(torque)]
        print(
            f"descent {name:15s} of v_h, {thrust.size} points: thrust {np.mean(thrust):+.1%}, absolute "
            f"{np.mean(np.abs(thrust)):.1%}; torque over 3e-4 {np.mean(torque):+.1%}, absolute "
            f"{np.mean(np.abs(torque)):.1%}"
        )
    for name, change in changes.items():
        kept = np.array(change)[np.isfinite(change)]
        print(
            f"descent {name:15s} of v_h, {kept.size} points: torque less that of the run's own hover "
            f"{np.mean(kept):+.1%}, absolute {np.mean(np.abs(kept)):.1%}"
        )
    for (c_t, rpm), measured in sorted(hovers.items()):
        if len(measured) > 2:
            spread = f"{np.nanmin(measured):.2e} to {np.nanmax(measured):.2e}"
            print(f"descent: measured hover torque of the runs at c_T {1e-3 * c_t:.3f}, {rpm:.0f} rpm: {spread}")
    for name, key in (("0 to 0.5", "slow"), ("0.5 to 2 (ring)", "ring"), ("above 2", "windmill")):
        thrust, torque = np.array(groups[name]).T
        record(f"forward_descent_{key}", *(100.0 * np.nanmean(np.abs(e)) for e in (thrust, torque)))
    print(f"descent: {failed} points without a solution")


def compare_autogyro(folder: Path, record: Callable[..., None]) -> None:
    """Autogyro rotor PCA-2: radius 6.86 m, four blades, chord 0.559 m, Goettingen 429, free hinges.

    The pitch of each table is that at which the mean error of lift vanishes.
    """
    radius, density = 6.858, 1.225
    rotor = make_rotor(name="p", radius_m=radius, chord_m=0.5588, airfoils="goe429", blades=4, hub_cutout=0.15)
    blading, flap, air = prepare_blading(rotor, n_crit=4.0), RigidFlapMode(1.0, 564.0), Air(density)
    sizes = []
    for path in sorted(folder.glob("Wheatley*table*")):
        data = read_numbers(path, 6)
        data = data[(data[:, 0] >= 0.15) & (data[:, 0] <= 0.5)][::3]

        def errors(pitch: float, data=data) -> np.ndarray:
            out = []
            for mu, degrees, lift, drag, _, rpm in data:
                angle, omega = math.radians(degrees), rpm * math.pi / 30
                airspeed = mu * omega * radius / math.cos(angle)
                c = ForwardCondition(pitch, omega, airspeed * math.cos(angle), -airspeed * math.sin(angle), air=air)
                got = solve_forward(blading, c, flap)
                pressure = 0.5 * density * airspeed**2 * math.pi * radius**2
                along = got.thrust_N * math.cos(angle) - got.h_force_N * math.sin(angle)
                back = got.thrust_N * math.sin(angle) + got.h_force_N * math.cos(angle)
                out.append((along / pressure / lift - 1.0, back / pressure / drag - 1.0, got.c_Q))
            return np.array(out)

        pitch = brentq(lambda t: float(np.mean(errors(t)[:, 0])), -0.02, 0.09, xtol=1e-3)
        lift, drag, torque = errors(pitch).T
        sizes.append((100.0 * np.mean(np.abs(lift)), 100.0 * np.mean(np.abs(drag))))
        print(
            f"PCA-2 {path.stem[-9:]}, {len(data)} points at mu 0.15 to 0.5: pitch {math.degrees(pitch):.2f} deg; "
            f"absolute error of lift {np.mean(np.abs(lift)):.1%}, drag {np.mean(np.abs(drag)):.1%} (mean "
            f"{np.mean(drag):+.1%}); c_Q {np.mean(torque):+.1e}, measured 0"
        )
    record("forward_autogyro", *np.max(sizes, axis=0))


def main() -> None:
    """Compare all parts that the folder has."""
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--record", action="store_true", help=RECORD_HELP)
    options = parser.parse_args()
    record, folder = make_recorder(options.record), options.folder
    for part, compare in (("inflow", compare_inflow), ("dynbem", compare_descent), ("dynbem", compare_autogyro)):
        if (folder / part).is_dir():
            compare(folder / part, record)
        else:
            print(f"{folder / part} is missing: skipped")


if __name__ == "__main__":
    main()
