# %% [markdown]
# # 3. Measure it, and believe it
#
# Fifteen minutes. A prediction is an opinion until a bench has been asked, and a bench tells the truth only to those
# who know how it errs: cells drift as they warm up, blades never sit twice at the same pitch, motors heat up and
# change. Here the bench is simulated, so that in the end you can look behind the curtain. With a real one the same
# plan runs on `--rig rig.toml`; `mufly bench --help` has the commands.

# %%
import tempfile
from pathlib import Path

import numpy as np

from mufly.bench import analyse_series, make_plan, read_measurements, run_series, write_series_results
from mufly.bench.rig.simulated_rig import SimulatedRig
from mufly.bench.series.series_record import SeriesRecord
from mufly.rotor import fit_rotor, load_rotor, predict_interval, replace_rotor

folder = Path(tempfile.mkdtemp(prefix="lesson-3-"))
print("the series and its pictures go to", folder)

# %% [markdown]
# ## A plan
#
# Every pitch is mounted twice, in random order, so that a drift does not look like an effect of the pitch. Between
# them the same reference blade comes back again and again: what changes of *its* thrust is the bench's doing.

# %%
plan = make_plan(
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
    """What only a simulation knows: the loads at the speeds that ran, had the blades stood exactly at their pitch."""
    speeds = {axis: bench.speed[axis] for axis in plan.mounting[step.mounting_index].turning_sides}
    return bench.true_loads(speeds, as_mounted=False)


record = run_series(plan, bench, SeriesRecord(folder), truth=truth)

# %% [markdown]
# ## What the series says
#
# The analysis takes the drift of the cells out, averages, and states for each setting how sure it is. It also says
# what it does not trust.

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
# ## Behind the curtain
#
# A simulated bench knows what was true. Of a hundred intervals of 95 % some ninety-five should hold it.

# %%
held = [abs(s.thrust.value - s.truth["thrust"]) <= s.thrust.expanded for s in series.settings if s.truth]
print(f"{sum(held)} of {len(held)} intervals of thrust hold the truth")

# %% [markdown]
# ## What it is worth to a prediction
#
# A rotor file names the section; nobody knows whether the printed blade has it. Suppose that it is wrong: it says NACA
# 2412, and what was printed, and measured above, is NACA 0012. Half of the points are fitted; the other half says
# whether the fit has learnt anything. (`rest.air` is the air in which was measured; the file of the results has it.)

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
for candidate in found.fit.candidates:
    if candidate.probability > 0.02:
        turned = np.degrees(candidate.change[0])
        print(f"  {candidate.airfoils[0]} turned by {turned:+.1f} deg: {100 * candidate.probability:.0f} %")
picture = found.plot()
picture.savefig(folder / "fit.png")
picture

# %% [markdown]
# The prediction is right afterwards, also at the points that the fit did not see. But look at the sections: a cambered
# blade that is mounted two degrees lower lifts as a straight one does, and no thrust or torque tells the two apart. The
# fit keeps both, with their probabilities. Measure the pitch of the blade, or its section, and the doubt is gone.

# %%
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))

# %% [markdown]
# ## Try
#
# * Break the bench: `SimulatedRig(seed=5, faults=SimulatedFaults(...))` from `mufly.bench.rig.simulated_rig`,
#   with a reference blade that was moved, or a cell that saturates. Does the series notice?
# * `compare_with_theory(series)` sets it beside blade element theory.
# * What is corrected, and how intervals are made: [test benches](../explanation/bench.md).
