"""Edit one term of the model, one constant of the polars and one gain in a copy, and see who notices.

Every consumer of what was edited has to answer differently in a new process, and everything else the same, with the
compiled functions of the run before still on disk: nothing is deleted. Prints a line for each consumer and exits with 1
if one of them runs stale code. Takes some minutes, nearly all of it compiling: ``python benchmarks/edited_source.py``.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import mufly

SOURCE = Path(mufly.__file__).resolve().parent
# What is edited: file, old text, new text, and what of the probe has to change with it.
EDITS = {
    "a term of the model (thrust + 2 %)": (
        "dynamics/equations_of_motion.py", "fz = fz_up + fz_dw - p.drag_z", "fz = 1.02 * (fz_up + fz_dw) - p.drag_z",
        ("trim", "linear model", "step", "batch", "design", "flight", "excitation plan"),
    ),
    "a constant of the polars (aspect ratio beyond stall)": (
        "rotor/polar_table.py", "ASPECT_RATIO = 5.0", "ASPECT_RATIO = 20.0",
        ("blade elements", "blade elements, many", "pair", "wake", "map", "study"),
    ),
    "a gain (reference model of heave, 9 to 8 rad/s)": (
        "control/weighting_schemes.py", "reference_model=TransferFunction((9.0,), (1.0, 9.0))",
        "reference_model=TransferFunction((8.0,), (1.0, 8.0))", ("design", "flight"),
    ),
}  # fmt: skip

PROBE = """
import json, math
import numpy as np
import mufly
from mufly.rotor import Air, Condition, System, coax_map, hover, hover_batch, load_rotor, prepare, solve
from mufly.rotor.wake import WakeSettings
from mufly.study import Setup, sweep

def of(values):
    return float(np.abs(np.nan_to_num(np.asarray(values, dtype=float))).sum())

vehicle = mufly.load_vehicle("mufly-1.1")
trim = mufly.dynamics.find_trim(vehicle)
linear = mufly.dynamics.linearise_vehicle(vehicle)
controller = mufly.control.design_flight_controller(vehicle)
state = mufly.dynamics.initial_state(position=(0.0, 0.0, -2.0), rotor_speed=trim.rotor_speed)
flown = mufly.dynamics.simulate_open_loop(vehicle, state, [0.7, 0.7, 0.1, 0.0], duration_s=0.5)
states = np.stack([state, state])
from mufly.dynamics import model_parameters
from mufly.dynamics.simulation import advance_batch
p = np.array([model_parameters(vehicle)] * 2)
advance_batch(states, np.full((2, 4), 0.6), np.zeros((2, 3)), p, 1e-3, 200)
flight = mufly.flight.fly_mission(vehicle, "demonstration", controller=controller)
plan = mufly.identify.design_excitation(vehicle, ["cQ_up", "Izz"], "yaw", kinds=("doublet",))
steep = 0.75
rotor = prepare(load_rotor("naca0012-r60-c20"))
at = Condition((steep, steep), (600.0, 640.0))
coarse = WakeSettings(model="prescribed", step_deg=30.0, turns=2.0, far_turns=4.0, tolerance=0.02)
print(json.dumps({
    "trim": of(trim.motor_input),
    "linear model": of(linear.heave_yaw.A) + of(linear.heave_yaw.B),
    "step": of(flown.truth_position),
    "batch": of(states),
    "design": of(np.frombuffer(np.asarray(controller.heave_yaw_gains).tobytes())),
    "flight": of(flight.truth_position),
    "excitation plan": of([v for c in plan.candidates for v in c.relative_std]),
    "blade elements": hover(rotor, pitch_rad=steep, speed_rad_s=600.0).thrust_N,
    "blade elements, many": of(hover_batch(rotor, pitch_rad=[steep, 0.8], speed_rad_s=600.0).thrust_N),
    "pair": solve(System.coaxial(rotor, rotor, spacing_m=0.02), at).thrust_N,
    "wake": solve(System.single(rotor), Condition(steep, 600.0), "wake", settings=coarse).thrust_N,
    "map": of(coax_map(rotor, rotor, spacing_m=0.02, upper_pitch_rad=steep, lower_pitch_rad=steep,
                       mean_speed_rad_s=[600.0], ratio=[0.9, 1.1], climb_ratio=[0.0, 0.02]).tables().cT_upper),
    "study": of(sweep(Setup(load_rotor("naca0012-r60-c20"), fixed={"speed": 600.0}), {"pitch": [steep]}).thrust_N),
}))
"""


def probe(package: Path) -> dict[str, float]:
    """Run the probe on the copy, in a new process."""
    env = {**os.environ, "PYTHONPATH": str(package), "NUMBA_CACHE_DIR": str(package / "cache")}
    done = subprocess.run([sys.executable, "-c", PROBE], env=env, capture_output=True, text=True, cwd=package)
    if done.returncode:
        raise SystemExit(done.stderr[-3000:])
    return json.loads(done.stdout.splitlines()[-1])


def main() -> int:
    """Edit, run, compare, put back."""
    stale = 0
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder)
        shutil.copytree(SOURCE, package / "mufly", ignore=shutil.ignore_patterns("__pycache__"))
        before = probe(package)
        for what, (name, old, new, consumers) in EDITS.items():
            file = package / "mufly" / name
            text = file.read_text(encoding="utf-8")
            if text.count(old) != 1:
                raise SystemExit(f"{name}: {old!r} stands there {text.count(old)} times")
            file.write_text(text.replace(old, new), encoding="utf-8")
            after = probe(package)
            file.write_text(text, encoding="utf-8")
            sys.stdout.write(f"{what}\n")
            for key, value in after.items():
                wanted, changed = key in consumers, value != before[key]
                word = "changes" if changed else "is as before"
                fault = "" if wanted == changed else "  STALE" if wanted else "  (not listed as a consumer)"
                stale += wanted and not changed
                sys.stdout.write(f"  {key:<22} {word} ({before[key]:.9g} -> {value:.9g}){fault}\n")
        again = probe(package)
        if again != before:
            sys.stdout.write("put back, but the answers are not those of before\n")
            stale += 1
    return 1 if stale else 0


if __name__ == "__main__":
    raise SystemExit(main())
