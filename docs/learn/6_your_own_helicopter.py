# %% [markdown]
# # 6. A helicopter of your own
#
# This lesson takes twenty minutes. You know the mass of a helicopter, its rotor radius and perhaps its motor.
# Similarity rules scale all other parameters from a known vehicle and mark them as guesses. You then replace guesses by
# measurements, one by one. The command for this is `mufly new my-helicopter`.

# %%
from pathlib import Path

import matplotlib.pyplot as plt

from mufly import control, dynamics, flight
from mufly.vehicle import format_vehicle_toml, list_parameters, load_vehicle, replace_parameters

known = load_vehicle("mufly-1.1")
mine = dynamics.scale_vehicle_by_similarity(known, "my-helicopter", mass_kg=0.120, radius_m=0.080, cells=2)
guesses = [row for row in list_parameters(mine) if row.note.startswith("guess:")]
print(f"{len(guesses)} of {len(list_parameters(mine))} numbers are guesses, such as")
for row in guesses[:4]:
    print(f"  {row.key:24s} {row.value:10.4g} {row.unit:8s} {row.note}")

# %% [markdown]
# ## Hover power and a first flight

# %%
for one in (known, mine):
    hover = dynamics.hover_performance(one)
    print(f"{one.name:16s} hovers on {hover.battery_power_W:5.1f} W at {hover.battery_current_A:.2f} A")
controller = control.design_flight_controller(mine)
recording = flight.fly_mission(mine, "demonstration", controller=controller)
print(recording.attrs["outcome"], recording.attrs["reason"])

# %% [markdown]
# ## The guess that matters most
#
# One parameter of the vehicle at a time is increased by 10 %, while the controller stays the same. The printed distance
# is the greatest deviation from the reference. Measure the parameters with the largest effect first.

# %%
reference = flight.summarise_flight(recording)
effect = {}
for key in (
    "body.mass",
    "rotors.upper.thrust_coefficient",
    "body.inertia_xx",
    "rotors.lower.torque_coefficient",
    "battery.capacity",
):
    value = {row.key: row.value for row in list_parameters(mine)}[key]
    other = replace_parameters(mine, {key: 1.1 * value}, source="estimated")
    data = flight.fly_mission(other, "demonstration", controller=controller, designed_for=mine)
    error = ((data.truth_position - data.reference_position) ** 2).sum("axis") ** 0.5
    effect[key] = (100.0 * float(error.max()), data.attrs["outcome"])
for key, (worst_cm, outcome) in effect.items():
    print(f"{key:34s} {worst_cm:5.1f} cm at worst, {outcome}")

# %% [markdown]
# ## The vehicle file
#
# The file states the source of every number. When you have weighed the helicopter, change the line of the mass: enter
# the value, `source = "measured"`, and the standard deviation of the scale as `std`. Later fits use it for their
# intervals. `mufly vehicle check lesson-6/vehicle.toml` checks every value, `mufly fly --vehicle lesson-6/vehicle.toml`
# flies the vehicle.

# %%
folder = Path("lesson-6")
folder.mkdir(exist_ok=True)
(folder / "vehicle.toml").write_text(format_vehicle_toml(mine), encoding="utf-8")
print("written:", (folder / "vehicle.toml").resolve())
print("\n".join(format_vehicle_toml(mine).splitlines()[:14]))

# %% [markdown]
# ## Flight with simulated sensor errors

# %%
sensed = flight.fly_mission(
    mine, "demonstration", controller=controller, sensors="fitted", wind=(0.3, 0.0, 0.0), gust=0.2, seed=2
)
figure, axes = plt.subplots(figsize=(5, 4))
axes.plot(sensed.truth_position.sel(axis="E"), sensed.truth_position.sel(axis="N"), label="true")
axes.plot(sensed.estimated_position.sel(axis="E"), sensed.estimated_position.sel(axis="N"), lw=0.8, label="estimated")
axes.set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title=sensed.attrs["outcome"])
axes.legend()
figure.tight_layout()
figure.savefig(folder / "way.png")
print("picture:", folder / "way.png")
plt.show()

# %% [markdown]
# ## Try
#
# * Give `scale_vehicle_by_similarity` your motor: `speed_constant_rad_Vs`, `resistance_ohm`. It refuses a motor
#   that cannot lift the vehicle and suggests another.
# * Fly in the ground station: `mufly new my-helicopter --mass 120 --radius 80`, then the command that it prints.
# * Export the flight software of the vehicle as C: `mufly firmware export --help`.
