# %% [markdown]
# # 2. Design a rotor for your motor
#
# This lesson takes fifteen minutes. The best blade depends on the motor, gear and battery that drive it. You compute
# one blade, find its speed on a motor, compare shapes, and run an optimisation. `mufly rotor --help` and `mufly drive
# --help` list the same functions as commands.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mufly.drive import find_operating_point, load_drive, make_blade_load
from mufly.rotor import draw_blade, load_rotor, prepare_blading, solve_rotor
from mufly.study import (
    StudySetup,
    draw_parameter_sweep,
    optimise_rotor,
    parse_design_limit,
    parse_parameter_settings,
    sweep_parameters,
)

rotor = load_rotor("naca4412-r60-c20")
drive = load_drive("mufly")
print(rotor.description)
print(drive.name, "gear", float(drive.gear.ratio))
folder = Path("lesson-2")  # for pictures
folder.mkdir(exist_ok=True)

# %% [markdown]
# ## One blade at one speed
#
# Blade element momentum theory divides the rotor disc into rings. In each ring the lift of the blade sections equals
# the change of the air's momentum. At a Reynolds number of 30 000 the drag of a section is several times larger than in
# textbooks, and the laminar boundary layer separates early. The neural network NeuralFoil gives lift and drag of the
# section at the Reynolds number of each ring.

# %%
point = solve_rotor(rotor, pitch_rad=np.radians(14.0), speed_rad_s=6000 * np.pi / 30)
print(f"thrust {1e3 * point.thrust_N:.0f} mN, torque {1e3 * point.torque_Nm:.2f} mN m, power {point.power_W:.2f} W")
print(f"figure of merit {point.figure_of_merit:.2f}: ideal power for this thrust and radius over the power needed")

# %% [markdown]
# ## Motor and blade
#
# The motor's torque falls with its speed; the rotor's torque grows with the square of the speed. At the operating point
# both are equal.

# %%
duty = np.linspace(0.4, 1.0, 13)
figure, (thrust, efficiency) = plt.subplots(1, 2, figsize=(9, 3.4))
for pitch_deg in (10, 14, 18):
    load = make_blade_load(prepare_blading(rotor), pitch_rad=np.radians(pitch_deg))
    point = find_operating_point(drive, load, duty=duty)
    thrust.plot(duty, 1e3 * point.thrust_N, label=f"{pitch_deg} deg")
    efficiency.plot(1e3 * point.thrust_N, point.thrust_per_power_N_W, label=f"{pitch_deg} deg")
thrust.set(xlabel="motor input (share of the voltage)", ylabel="thrust (mN)")
efficiency.set(xlabel="thrust (mN)", ylabel="thrust per electrical power (N/W)")
thrust.legend(title="pitch")
efficiency.legend(title="pitch")
figure.tight_layout()
figure.savefig(folder / "drive.png")

# %% [markdown]
# Each rotor carries about half of the weight, 0.47 N. The right plot shows which pitch gives that thrust with the least
# power. The left plot shows how much more thrust full input gives, for climb and wind.
#
# ## Sweep
#
# The sweep varies chord and pitch at a thrust of 0.4 N. For each case the gear ratio is adapted, so that full voltage
# gives exactly this thrust.

# %%
setup = StudySetup(rotor, drive, {"thrust": 0.4, "gear": "adapted"})
data = sweep_parameters(setup, parse_parameter_settings(["chord=10:30:10mm", "pitch=6:20:1deg"]))
picture = draw_parameter_sweep(data, "thrust_per_power_N_W")
picture.savefig(folder / "sweep.png")
picture

# %% [markdown]
# Each chord has its own best pitch. Wider blades are more efficient, and their best pitch is higher. The plot repeats
# Fig. 3.28 of the dissertation.
#
# ## Optimise
#
# The optimisation varies chord, twist, taper, gear and pitch within limits. Blades thinner than 0.8 mm cannot be
# printed.

# %%
start = StudySetup(rotor, drive, {"thrust": 0.4})
best = optimise_rotor(
    start, "thrust-per-power", ("chord", "twist", "taper", "gear"),
    limits=[parse_design_limit("thickness_mm>=0.8"), parse_design_limit("chord<=30mm")], generations=15,
)  # fmt: skip
print(f"{best.goal_before:.4f} N/W become {best.goal_after:.4f}, at a pitch of {np.degrees(best.pitch_rad):.1f} deg")
for step in best.steps:
    print(f"  {step.parameter:8s} to {step.value:.3g} (SI): {100 * step.gain:+.1f} %")

# %%
picture = draw_blade(best.rotor)
picture.savefig(folder / "blade.png")
picture

# %% [markdown]
# An optimiser also exploits errors of the model, so the true gain is smaller than the predicted one.
# [Accuracy](../accuracy.md) lists the errors of the theory. Measure a blade before you order more: the next lesson
# shows how. The folder `lesson-2` contains the pictures.

# %%
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))
plt.show()

# %% [markdown]
# ## Try
#
# * Use another motor: `mufly vehicle show mufly-1.1 --toml > mine.toml`, change back-EMF constant and resistance, and
#   load the file with `load_drive("mine.toml")`.
# * Repeat the sweep by textbook theory, without the corrections for short blades: `StudySetup(...,
#   corrections=TEXTBOOK_CORRECTIONS)`, a constant of `mufly.rotor`.
