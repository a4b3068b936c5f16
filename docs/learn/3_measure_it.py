# %% [markdown]
# # 3. Measure a rotor
#
# This lesson takes fifteen minutes. A test bench has errors of its own: load cells drift as they warm up, the pitch
# differs each time that blades are mounted, and motors heat up. You plan a measurement series, run it on a simulated
# bench, and compare the result with the true loads of the simulation. On a real bench `mufly bench run plan.toml --rig
# bench.toml` runs the plan.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mufly.bench import analyse_series, make_series_plan, read_measurements, run_series, write_series_results
from mufly.bench.rig.simulated_rig import SimulatedRig
from mufly.bench.series.series_record import SeriesRecord
from mufly.rotor import fit_rotor, load_rotor, predict_interval, replace_rotor

folder = Path(tempfile.mkdtemp(prefix="lesson-3-"))
print("the series and its pictures go to", folder)

# %% [markdown]
# ## Plan
#
# Every pitch is mounted twice in random order, so that a drift of the bench does not look like an effect of the pitch.
# A reference rotor is mounted in between. If its thrust changes, the bench has changed.

# %%
plan = make_series_plan(
    "lesson", ["naca0012-r60-c20"], [10, 12, 14, 16], [4000, 5000, 6000], reference="naca4412-r60-c20",
    reference_pitch_deg=14, repetitions=2, seed=1,
)  # fmt: skip
print(
    f"{plan.point_count} points in {plan.estimate_duration_s() / 60:.0f} minutes; blades are mounted "
    f"{len(plan.mounting)} times"
)

# %%
bench = SimulatedRig(seed=5)


def truth(step):
    """Return the true loads at the actual speeds and exactly the planned pitch, which only a simulation knows."""
    speeds = {axis: bench.speed[axis] for axis in plan.mounting[step.mounting_index].driven_rotors}
    return bench.true_loads(speeds, as_mounted=False)


record = run_series(plan, bench, SeriesRecord(folder), truth=truth)

# %% [markdown]
# ## Analysis
#
# The analysis removes the drift of the load cells, averages, and computes a 95 % interval for each setting (rotor,
# pitch, speed). Lines with `!` name measurements that look wrong.

# %%
series = analyse_series(record)
for note in series.notes:
    print("*", note)
for doubt in series.doubts:
    print("!", doubt)

# %%
picture = series.plot()
picture.savefig(folder / "series.png")
picture

# %% [markdown]
# ## Comparison with the truth
#
# The simulation contains the true loads. About 95 of 100 intervals of 95 % should include them.

# %%
held = [abs(s.thrust.value - s.truth["thrust"]) <= s.thrust.expanded for s in series.settings if s.truth]
print(f"{sum(held)} of {len(held)} intervals of thrust contain the true thrust")

# %% [markdown]
# ## Use for a prediction
#
# A rotor file names the airfoil of the blade, but a printed blade may have another shape. Assume that the file wrongly
# names NACA 2412, while the measured blade is NACA 0012. Half of the measured points are fitted. The other half shows
# whether the fit improves the prediction.

# %%
files = write_series_results(series, folder / "results")
print([f.name for f in files])
measured = read_measurements(next(f for f in files if f.name.startswith("naca0012") and "points" not in f.name))
rotor = replace_rotor(load_rotor("naca0012-r60-c20"), {"name": "mine", "blade.airfoils": ("naca2412",)})
points = np.arange(measured.thrust_N.size)
found, rest = fit_rotor(rotor, measured.select_points(points[0::2])), measured.select_points(points[1::2])
for name, one in (("before", rotor), ("after", found.rotor)):
    band = predict_interval(one, pitch_rad=rest.pitch_rad, speed_rad_s=rest.speed_rad_s, air=rest.air)
    off = np.abs(band.thrust_N / rest.thrust_N - 1.0)
    width = (band.thrust_high_N - band.thrust_low_N) / 2.0 / band.thrust_N
    print(f"{name}: thrust off by {100 * off.mean():.1f} % on average, interval of 90 % +-{100 * np.mean(width):.0f} %")
for candidate in found.section_fit.candidates:
    if candidate.probability > 0.02:
        turned = np.degrees(candidate.change[0])
        print(
            f"  {candidate.airfoils[0]}, pitch offset {turned:+.1f} deg, probability {100 * candidate.probability:.0f}%"
        )
picture = found.plot()
picture.savefig(folder / "fit.png")
picture

# %% [markdown]
# After the fit the prediction agrees with the measurement, also at the points that the fit did not use. The airfoil
# remains ambiguous: a cambered blade mounted two degrees lower gives the same lift as a symmetric blade, and thrust and
# torque do not distinguish them. The fit therefore keeps several airfoils with their probabilities. A measured pitch or
# airfoil removes the ambiguity.

# %%
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))
plt.show()

# %% [markdown]
# ## Try
#
# * Add faults to the bench: `SimulatedRig(seed=5, faults=SimulatedFaults(...))` from `mufly.bench.rig.simulated_rig`
#   simulates a reference blade whose pitch was changed, or a load cell that saturates. Does the analysis report them?
# * Compare the series with blade element theory: `compare_with_theory(series)` from `mufly.bench`.
# * [Uncertainty of bench measurements](../explanation/bench.md) explains corrections and intervals.
