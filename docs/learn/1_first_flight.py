# %% [markdown]
# # 1. A first flight and its numbers
#
# This lesson takes ten minutes. You fly a simulated helicopter of 95 g, read its recording, and see the effect of wind
# and of sensor errors. Every cell is Python that you can paste. `mufly fly --headless` flies the mission in a terminal.

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
# downwash on the fuselage, and their torques cancel. `find_trim` computes the motor inputs (0 to 1) of this state.

# %%
hover = dynamics.find_trim(vehicle)
upper, lower = hover.rotor_speed * 60.0 / (2.0 * 3.14159265)
print(f"motor inputs {hover.input[0]:.3f} (upper), {hover.input[1]:.3f} (lower)")
print(f"rotor speeds {upper:.0f} and {lower:.0f} rpm")

# %% [markdown]
# The two speeds differ because the lower rotor works in the downwash of the upper rotor, and the upper rotor also
# drives a stabiliser bar.
#
# ## Controller and mission
#
# `design_flight_controller` designs H-infinity controllers for the linearised model. `fly_mission` simulates a mission
# with the nonlinear model. The mission `demonstration` is that of the dissertation: take off, fly to four waypoints,
# land.

# %%
controller = control.design_flight_controller(vehicle)
recording = flight.fly_mission(vehicle, "demonstration", controller=controller)
print(recording.attrs["outcome"], f"after {float(recording.time[-1]):.0f} s")

# %% [markdown]
# `fly_mission` returns an xarray data set with the true state, measurements, references and actuator inputs over time.
# The axes are north, east and **down** (N, E, D): a height of 2 m is D = -2.

# %%
position, reference = recording.truth_position, recording.reference_position
figure, (plan, height) = plt.subplots(1, 2, figsize=(9, 3.6))
plan.plot(position.sel(axis="E"), position.sel(axis="N"), label="true")
plan.plot(reference.sel(axis="E"), reference.sel(axis="N"), "--", label="reference")
plan.legend()
plan.set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title="seen from above")
height.plot(recording.time, -position.sel(axis="D"), label="true")
height.plot(recording.time, -reference.sel(axis="D"), "--", label="reference")
height.set(xlabel="time (s)", ylabel="height (m)", title="height")
height.legend()
figure.tight_layout()
figure.savefig(folder / "way.png")

# %% [markdown]
# ## The numbers of a flight
#
# The summary uses the true state of the simulation, not the estimate of the flight software.

# %%
summary = flight.summarise_flight(recording)
for name, value in flight.summary_rows(summary):
    print(f"{name:34s} {value}")

# %% [markdown]
# ## Wind
#
# The wind blows north at 1.8 m/s, with gusts of 0.3 m/s (standard deviation). The same `seed` gives the same gusts.
# Wind pushes the helicopter sideways, so the plot shows the horizontal distance from the reference position.

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
# With wind the greatest horizontal distance is 5.1 cm instead of 1.0 cm. It occurs at take-off, before the controller
# has compensated the wind. The summary's greatest position error, 15 cm, does not show this effect: it is the lag in
# height at take-off, which is the same with and without wind.

# %% [markdown]
# ## Sensors with errors
#
# In these flights the controllers received the true state. With `sensors="fitted"` they receive the estimate of a
# Kalman filter, which reads the simulated sensors of the vehicle file: vibrating accelerometers, a sonar, and external
# position measurements that arrive 0.2 s late. `mufly fly` uses these sensors by default.

# %%
sensed = flight.fly_mission(
    vehicle, "demonstration", controller=controller, wind=(1.8, 0.0, 0.0), gust=0.3, seed=1, sensors="fitted"
)
error = sensed.estimated_position - sensed.truth_position
figure, axes = plt.subplots(figsize=(9, 3))
for axis in "NED":
    axes.plot(sensed.time, 100.0 * error.sel(axis=axis), label=axis)
axes.set(xlabel="time (s)", ylabel="estimated minus true (cm)")
axes.legend(title="axis")
figure.tight_layout()
figure.savefig(folder / "estimate.png")
print(sensed.attrs["outcome"])

# %% [markdown]
# If you run the lesson as a script (`python 1_first_flight.py`), windows show its pictures. The folder `lesson-1`
# also contains them.

# %%
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))
plt.show()

# %% [markdown]
# ## Try
#
# * Fly with `wind=(4.0, 0.0, 0.0)`. Which line of the summary reports air speeds beyond the model's range?
# * Fly `flight.fly_mission(vehicle, "box-on-leg", ...)`: eight range beams detect a crate on the path.
# * Watch a flight: `mufly fly` opens the ground station.
#
# [Accuracy](../accuracy.md) lists the measured errors of the model.
