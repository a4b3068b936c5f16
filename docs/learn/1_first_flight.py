# %% [markdown]
# # 1. A first flight and its numbers
#
# Ten minutes. You fly a simulated helicopter of 95 g, read its recording, and see the effect of wind and of real
# sensors. Every cell is Python that you can paste. The same flight from a terminal is `mufly fly --headless`.

# %%
from pathlib import Path

import matplotlib.pyplot as plt

import mufly
from mufly import control, dynamics, flight

vehicle = mufly.load_vehicle("mufly-1.1")
print(repr(vehicle))
folder = Path("lesson-1")  # for pictures
folder.mkdir(exist_ok=True)

# %% [markdown]
# ## Hover
#
# Two rotors on one axis turn in opposite directions. In hover their thrusts carry the weight and the drag of the
# downwash on the fuselage, and their torques cancel. `find_trim` solves for the motor inputs.

# %%
hover = dynamics.find_trim(vehicle)
upper, lower = hover.rotor_speed * 60.0 / (2.0 * 3.14159265)
print(f"motor inputs {hover.input[0]:.3f} (upper), {hover.input[1]:.3f} (lower)")
print(f"rotor speeds {upper:.0f} and {lower:.0f} rpm")

# %% [markdown]
# The lower rotor works in the downwash of the upper rotor, and the upper rotor drives a stabiliser bar. Therefore the
# two speeds differ.
#
# ## Controller and mission
#
# `design_flight_controller` makes H-infinity controllers from the linearised model. `fly_mission` flies a mission on
# the nonlinear model. The demonstration mission is the dissertation's: take off, four waypoints, land.

# %%
controller = control.design_flight_controller(vehicle)
recording = flight.fly_mission(vehicle, "demonstration", controller=controller)
print(recording.attrs["outcome"], f"after {float(recording.time[-1]):.0f} s")

# %% [markdown]
# `fly_mission` returns a labelled table (an xarray data set): truth, measurement, reference and actuators on one
# clock. The axes are north, east and **down**: a height of 2 m is D = -2.

# %%
position, asked = recording.truth_position, recording.reference_position
figure, (plan, height) = plt.subplots(1, 2, figsize=(9, 3.6))
plan.plot(position.sel(axis="E"), position.sel(axis="N"), label="true")
plan.plot(asked.sel(axis="E"), asked.sel(axis="N"), "--", label="asked for")
plan.legend()
plan.set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title="seen from above")
height.plot(recording.time, -position.sel(axis="D"), label="true")
height.plot(recording.time, -asked.sel(axis="D"), "--", label="asked for")
height.set(xlabel="time (s)", ylabel="height (m)", title="height")
height.legend()
figure.tight_layout()
figure.savefig(folder / "way.png")

# %% [markdown]
# ## The numbers of a flight
#
# The summary judges the flight by the true state, not by the estimated one.

# %%
summary = flight.summarise_flight(recording)
for name, value in flight.summary_rows(summary):
    print(f"{name:34s} {value}")

# %% [markdown]
# ## Wind
#
# The wind is 1.8 m/s from a constant direction with gusts of 0.3 m/s (standard deviation). The same `seed` gives the
# same gusts. Wind pushes sideways, so the plot shows the distance from the reference in the horizontal plane.

# %%
windy = flight.fly_mission(vehicle, "demonstration", controller=controller, wind=(1.8, 0.0, 0.0), gust=0.3, seed=1)


def sideways(data):
    """Distance from the reference in the horizontal plane (m)."""
    gap = (data.truth_position - data.reference_position).sel(axis=["N", "E"])
    return (gap**2).sum("axis") ** 0.5


figure, axes = plt.subplots(figsize=(9, 3))
for name, data in (("wind", windy), ("calm", recording)):
    off = 100.0 * sideways(data)
    axes.plot(data.time, off, label=name)
    print(f"{name}: {float(off.max()):.1f} cm at worst, {float((off**2).mean()) ** 0.5:.2f} cm on average (rms)")
axes.set(xlabel="time (s)", ylabel="away from the reference (cm)")
axes.legend()
figure.tight_layout()
figure.savefig(folder / "wind.png")

# %% [markdown]
# Wind makes the greatest distance five times as large: 5.1 cm instead of 1.0 cm. It occurs at take-off, where the
# controller has not yet compensated the wind. The greatest position error of the summary, 15 cm, hides this effect:
# it is the lag in height at take-off, which is the same with and without wind.

# %% [markdown]
# ## Real sensors
#
# The controllers used the true state in these flights. With `sensors="fitted"` they use estimates from the vehicle's
# own sensors: accelerometers shaken by the rotors, a sonar, and position fixes that arrive late. `mufly fly` uses
# fitted sensors by default.

# %%
felt = flight.fly_mission(
    vehicle, "demonstration", controller=controller, wind=(1.8, 0.0, 0.0), gust=0.3, seed=1, sensors="fitted"
)
error = felt.estimated_position - felt.truth_position
figure, axes = plt.subplots(figsize=(9, 3))
for axis in "NED":
    axes.plot(felt.time, 100.0 * error.sel(axis=axis), label=axis)
axes.set(xlabel="time (s)", ylabel="estimated minus true (cm)")
axes.legend(title="axis")
figure.tight_layout()
figure.savefig(folder / "estimate.png")
print(felt.attrs["outcome"])

# %% [markdown]
# Run as a script (`python 1_first_flight.py`), the lesson shows its pictures in windows. They are also files in
# `lesson-1`.

# %%
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))
plt.show()

# %% [markdown]
# ## Try
#
# * Fly with `wind=(4.0, 0.0, 0.0)`. Which line of the summary reports air speeds beyond the model?
# * Fly `flight.fly_mission(vehicle, "box-on-leg", ...)`: eight range beams detect a crate on the path.
# * Watch a flight: `mufly fly` opens the ground station.
#
# The errors of the model and their sources: [Accuracy](../accuracy.md).
