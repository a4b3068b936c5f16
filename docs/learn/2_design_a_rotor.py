# %% [markdown]
# # 2. Design a rotor for your motor
#
# Fifteen minutes. A blade is good or bad only together with the motor, gear and battery that turn it. You look at one
# blade, let its speed settle on a motor, sweep shapes, and let the machine search. From a terminal: `mufly rotor
# --help`, `mufly drive --help`.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mufly.drive import find_operating_point, load_drive, make_blade_load
from mufly.rotor import blade_picture, load_rotor, prepare_blading, solve_rotor
from mufly.study import (
    StudySetup,
    optimise_rotor,
    parse_limit,
    parse_settings,
    sweep_parameters,
    sweep_picture,
)

rotor = load_rotor("naca4412-r60-c20")
drive = load_drive("mufly")
print(rotor.description)
print(drive.name, "gear", float(drive.gear.ratio))
folder = Path("lesson-2")  # for pictures
folder.mkdir(exist_ok=True)

# %% [markdown]
# ## One blade, one point
#
# Blade element momentum theory cuts the blade into rings. In each, the lift of the section and the momentum that it
# gives to the air have to agree. Sections this small are not those of textbooks: at Re 30 000 drag is several times
# larger, and a boundary layer that separates early decides everything. The polars come from NeuralFoil, at the
# Reynolds number of each ring.

# %%
point = solve_rotor(rotor, pitch_rad=np.radians(14.0), speed_rad_s=6000 * np.pi / 30)
print(f"thrust {1e3 * point.thrust_N:.0f} mN, torque {1e3 * point.torque_Nm:.2f} mN m, power {point.power_W:.2f} W")
print(f"figure of merit {point.figure_of_merit:.2f}: an ideal rotor of this size would need that share of the power")

# %% [markdown]
# ## Where motor and blade meet
#
# The motor's torque falls with its speed, the blade's grows with the square of it: they settle where both are equal.

# %%
duty = np.linspace(0.4, 1.0, 13)
figure, (thrust, efficiency) = plt.subplots(1, 2, figsize=(9, 3.4))
for pitch_deg in (10, 14, 18):
    load = make_blade_load(prepare_blading(rotor), pitch_rad=np.radians(pitch_deg))
    met = find_operating_point(drive, load, duty=duty)
    thrust.plot(duty, 1e3 * met.thrust_N, label=f"{pitch_deg} deg")
    efficiency.plot(1e3 * met.thrust_N, met.thrust_per_power_N_W, label=f"{pitch_deg} deg")
thrust.set(xlabel="motor input (share of the voltage)", ylabel="thrust (mN)")
efficiency.set(xlabel="thrust (mN)", ylabel="thrust per electrical power (N/W)")
thrust.legend(title="pitch")
efficiency.legend(title="pitch")
figure.tight_layout()
figure.savefig(folder / "drive.png")

# %% [markdown]
# Read the right picture as a designer: at the thrust that you need (half the weight for each of two rotors), which
# curve is highest? And the left one: is there a reserve above it, to climb and to fight wind?
#
# ## Sweep
#
# Chord and pitch together, at 0.4 N, with the gear that suits each case.

# %%
setup = StudySetup(rotor, drive, {"thrust": 0.4, "gear": "adapted"})
data = sweep_parameters(setup, parse_settings(["chord=10:30:10mm", "pitch=6:20:1deg"]))
picture = sweep_picture(data, "thrust_per_power_N_W")
picture.savefig(folder / "sweep.png")
picture

# %% [markdown]
# Each chord has its own best pitch; the wider blade is better, and its best pitch higher. That is Fig. 3.28 of the
# dissertation.
#
# ## Search
#
# Now everything may change within limits: chord, twist, taper, gear and pitch. Blades thinner than 0.8 mm cannot be
# printed.

# %%
start = StudySetup(rotor, drive, {"thrust": 0.4})
best = optimise_rotor(
    start, "thrust-per-power", ("chord", "twist", "taper", "gear"),
    limits=[parse_limit("thickness_mm>=0.8"), parse_limit("chord<=30mm")], generations=15,
)  # fmt: skip
print(f"{best.before:.4f} N/W become {best.after:.4f}, at a pitch of {np.degrees(best.pitch_rad):.1f} deg")
for step in best.steps:
    print(f"  {step.parameter:8s} to {step.value:.3g} (SI): {100 * step.gain:+.1f} %")

# %%
picture = blade_picture(best.rotor)
picture.savefig(folder / "blade.png")
picture

# %% [markdown]
# An optimum sits where the model is most optimistic. So do not order blades yet: see what
# [validation](../validation.md) says of the theory (c_T within 11 % on average for rotors of unknown section), and
# measure one. That is the next lesson. Run as a script, the lesson shows its first picture in a window; all three are
# files in `lesson-2`.

# %%
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))
plt.show()

# %% [markdown]
# ## Try
#
# * Give the drive another motor: `mufly drive show mufly --toml > mine.toml`, change back-EMF and resistance,
#   `load_drive("mine.toml")`.
# * Repeat the sweep with `StudySetup(..., corrections=PLAIN)` from `mufly.rotor`: textbook theory, without the
#   corrections.
