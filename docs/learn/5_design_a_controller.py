# %% [markdown]
# # 5. Design a controller and break it
#
# Fifteen minutes. A design is trusted once you know what it takes to break it. You look at its loops, then add what
# the design did not know of: delay, another battery, another vehicle.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mufly import control, flight
from mufly.control.plots import draw_loop
from mufly.firmware import GenericFirmwareSoftware
from mufly.flight.monte_carlo import Campaign, WorkerPool, parse_variations, run_campaign, summarise_outcome
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

vehicle = load_vehicle("mufly-1.1")
controller = control.design_flight_controller(vehicle)
folder = Path("lesson-5")  # for pictures
folder.mkdir(exist_ok=True)
print(controller)

# %% [markdown]
# Two numbers to know by heart. **Sensitivity peak**: by how much the loop makes a disturbance worse at its worst
# frequency; 6 dB (a factor of two) is where one begins to worry. **Delay margin**: how much later a measurement may
# come before it oscillates.

# %% [markdown]
# ## Slower and slower
#
# The same weights, sampled less often. What the margin says, and what a flight says.

# %%
rates = (400.0, 200.0, 100.0, 70.0)
designs = {rate: control.design_flight_controller(vehicle, rate_Hz=rate) for rate in rates}
figure, axes = plt.subplots(figsize=(9, 3))
for rate, made in designs.items():
    loop = made.roll_pitch.sampled_loop
    data = flight.fly_mission(vehicle, "demonstration", controller=made, wind=(0.5, 0.0, 0.0), gust=0.5, seed=4)
    tilt = np.degrees(data.truth_attitude.sel(angle="roll"))
    axes.plot(
        data.time,
        tilt,
        lw=0.8,
        label=f"{rate:.0f} Hz: S {loop.sensitivity_peak_dB:.1f} dB, {data.attrs['outcome']}",
    )
axes.set(xlabel="time (s)", ylabel="roll (deg)")
axes.legend(fontsize=8)
figure.tight_layout()
figure.savefig(folder / "rates.png")

# %% [markdown]
# And the loop of the design that it flies: gain over frequency, and how much disturbances and noise are worse for it.

# %%
picture = draw_loop(controller.roll_pitch)
picture.savefig(folder / "loop.png")
picture

# %% [markdown]
# ## Another vehicle than it thinks
#
# Every parameter is off by up to 10 %, each for itself, and the wind blows. The controller stays the nominal one.
# Forty flights say more than one, and Wilson's interval says how much more.

# %%
mission = load_mission("demonstration")
campaign = Campaign.create_checked(
    vehicle, mission, variations=parse_variations(["parameters=10%"], vehicle), wind=0.5, gust=0.3, sensors="ideal",
    quickly=GenericFirmwareSoftware,
)  # fmt: skip
with WorkerPool(1) as crew:
    outcome = summarise_outcome(run_campaign(campaign, 40, crew=crew), campaign.tolerance_m)
print(outcome.describe_success())
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))
plt.show()

# %% [markdown]
# ## Try
#
# * `parameters=30%`: which failures appear first? `mufly monte-carlo` flies them again with a full recording.
# * `--search 300` looks for the worst case instead of drawing: it finds what a thousand random flights do not.
# * The theory: [control](../explanation/control.md); what campaigns count: [many flights](../reference/monte-carlo.md).
