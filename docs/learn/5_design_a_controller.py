# %% [markdown]
# # 5. Design a controller and find its limits
#
# This lesson takes fifteen minutes. You design the controllers of a vehicle and look at their margins. Then you test
# two limits: lower sample rates, and vehicles whose parameters differ from those of the design.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mufly import control, flight
from mufly.control.analysis.plots import draw_loop
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
# Two numbers characterise each control loop. The **sensitivity peak** is the greatest amplification of a disturbance;
# 6 dB (a factor of two) is a common upper limit. The **delay margin** is the additional delay at which the loop becomes
# unstable.

# %% [markdown]
# ## Sample rate
#
# The controllers are designed with the same weights for four sample rates, and each design flies the same mission in
# the same gusts. The legend shows the sensitivity peak S of the roll-pitch loop and the outcome of the flight.

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
# The next plot shows, for the roll-pitch loop at 200 Hz, the open-loop gain and the amplification of disturbances and
# noise over frequency.

# %%
picture = draw_loop(controller.roll_pitch)
picture.savefig(folder / "loop.png")
picture

# %% [markdown]
# ## A vehicle with other parameters
#
# In each of forty flights every parameter of the vehicle differs by up to 10 % from the file, independently, and wind
# blows. The controllers are designed for the file's vehicle. The success rate has Wilson's 95 % interval.

# %%
mission = load_mission("demonstration")
campaign = Campaign.create_checked(
    vehicle, mission, variations=parse_variations(["parameters=10%"], vehicle), wind=0.5, gust=0.3, sensors="ideal",
    fast_controllers=GenericFirmwareSoftware,
)  # fmt: skip
with WorkerPool(1) as crew:
    outcome = summarise_outcome(run_campaign(campaign, 40, crew=crew), campaign.tolerance_m)
print(outcome.describe_success())
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))
plt.show()

# %% [markdown]
# ## Try
#
# * Use `parameters=30%`. Which failures appear first? `mufly monte-carlo` repeats failed flights with a full recording.
# * Search for the worst case instead of random draws: `mufly monte-carlo --search 300`.
# * [Control](../explanation/control.md) explains the theory, [Monte Carlo](../reference/monte-carlo.md) the criteria of
#   success.
