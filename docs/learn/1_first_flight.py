# %% [markdown]
# # 1. A first flight, and what the numbers mean
#
# Ten minutes. You fly a simulated helicopter of 95 g, read its recording, and see what wind and honest sensors
# change. Every cell below is Python that you can paste; the same flight from a terminal is `mufly fly --headless`.

# %%
import matplotlib.pyplot as plt

import mufly
from mufly import control, dynamics, flight

vehicle = mufly.load_vehicle("mufly-1.1")
print(vehicle.description)

# %% [markdown]
# ## What has to be so in hover
#
# Two rotors, one above the other, turn against each other. In hover their thrusts carry the weight and the downwash
# that presses on the fuselage, and their torques cancel. `trim` solves for that.

# %%
hover = dynamics.trim(vehicle)
upper, lower = hover.rotor_speed * 60.0 / (2.0 * 3.14159265)
print(f"motor inputs {hover.input[0]:.3f} (upper), {hover.input[1]:.3f} (lower)")
print(f"rotor speeds {upper:.0f} and {lower:.0f} rpm")

# %% [markdown]
# The lower rotor works in the wash of the upper one, the upper one drags a stabiliser bar along: that is why the two
# speeds differ.
#
# ## A controller, and a mission
#
# `control.design` makes H-infinity controllers from the linearised model; `fly` flies a mission on the full,
# nonlinear one. The demonstration is the dissertation's: take off, four waypoints, land.

# %%
controller = control.design(vehicle)
recording = flight.fly(vehicle, "demonstration", controller=controller)
print(recording.attrs["outcome"], f"after {float(recording.time[-1]):.0f} s")

# %% [markdown]
# What `fly` returns is a labelled table (an xarray data set): truth, measurement, reference and actuators on one
# clock. Axes are north, east and **down**, so a height of 2 m is D = -2.

# %%
position = recording.truth_position
figure, (plan, height) = plt.subplots(1, 2, figsize=(9, 3.6))
plan.plot(position.sel(axis="E"), position.sel(axis="N"))
plan.set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title="seen from above")
height.plot(recording.time, -position.sel(axis="D"), label="true")
height.plot(recording.time, -recording.reference_position.sel(axis="D"), "--", label="asked for")
height.set(xlabel="time (s)", ylabel="height (m)", title="height")
height.legend()
figure.tight_layout()

# %% [markdown]
# ## The numbers of a flight
#
# The summary judges the flight by the truth, not by what the helicopter believed.

# %%
summary = flight.summarise(recording)
for name, value in flight.summary_rows(summary):
    print(f"{name:34s} {value}")

# %% [markdown]
# ## Wind
#
# Half a metre a second of wind and gusts of 0.3 m/s. `seed` makes the gusts the same again; another seed gives other
# gusts.

# %%
windy = flight.fly(vehicle, "demonstration", controller=controller, wind=(0.5, 0.0, 0.0), gust=0.3, seed=1)


def off(data):
    """Distance from where it was asked to be, over the time in the air (m)."""
    gap = data.truth_position - data.reference_position
    return (gap**2).sum("axis") ** 0.5


figure, axes = plt.subplots(figsize=(9, 3))
for name, data in (("calm", recording), ("wind", windy)):
    axes.plot(data.time, 100.0 * off(data), label=name)
axes.set(xlabel="time (s)", ylabel="away from the reference (cm)")
axes.legend()
figure.tight_layout()
print(
    f"calm {100 * float(off(recording).max()):.1f} cm at worst, wind {100 * float(off(windy).max()):.1f} cm"
)

# %% [markdown]
# ## Honest sensors
#
# So far the controllers knew the truth. `sensors="fitted"` gives them what the vehicle's own sensors say, through a
# filter: accelerometers that rotors shake, a sonar, position fixes that come late. That is what `mufly fly` does
# unless told otherwise.

# %%
felt = flight.fly(
    vehicle, "demonstration", controller=controller, wind=(0.5, 0.0, 0.0), gust=0.3, seed=1, sensors="fitted"
)
error = felt.estimated_position - felt.truth_position
figure, axes = plt.subplots(figsize=(9, 3))
for axis in "NED":
    axes.plot(felt.time, 100.0 * error.sel(axis=axis), label=axis)
axes.set(xlabel="time (s)", ylabel="believed minus true (cm)")
axes.legend()
figure.tight_layout()
print(felt.attrs["outcome"])

# %% [markdown]
# ## Try
#
# * Give it `wind=(2.0, 0.0, 0.0)`. What does the summary say of air beyond the model?
# * `flight.fly(vehicle, "box-on-leg", ...)`: a crate stands on the way, seen by eight beams.
# * Watch it: `mufly fly` in a terminal opens the ground station.
#
# What the numbers rest on, and where they fall short: [validation](../validation.md).
