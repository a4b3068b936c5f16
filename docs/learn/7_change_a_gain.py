# %% [markdown]
# # 7. Change a gain and fly
#
# This lesson takes five minutes. The position controller has one gain: the velocity that it commands per metre of
# position error, in 1/s. You fly with three gains in the same wind and compare errors and stability margins.

# %%
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

from mufly import control, flight, load_vehicle

vehicle = load_vehicle("mufly-1.1")
folder = Path("lesson-7")  # for pictures
folder.mkdir(exist_ok=True)
settings = control.DesignSettings()
print(f"position gain by default: {settings.position_gain} 1/s")

# %% [markdown]
# ## Fly with three gains
#
# The same `seed` gives every flight the same gusts, so the flights differ only in the gain.

# %%
figure, axes = plt.subplots(figsize=(9, 3))
for gain in (0.3, 1.0, 1.6):
    controller = control.design_flight_controller(vehicle, settings=replace(settings, position_gain=gain))
    data = flight.fly_mission(vehicle, "demonstration", controller=controller, wind=(1.8, 0.0, 0.0), gust=0.3, seed=1)
    gap = (data.truth_position - data.reference_position).sel(axis=["N", "E"])
    distance_cm = 100.0 * (gap**2).sum("axis") ** 0.5
    axes.plot(data.time, distance_cm, label=f"{gain} 1/s")
    print(
        f"gain {gain} 1/s: {float((distance_cm**2).mean()) ** 0.5:.2f} cm rms, "
        f"phase margin {controller.cascade_loop.phase_margin_deg:.0f} deg, {data.attrs['outcome']}"
    )
axes.set(xlabel="time (s)", ylabel="distance from the reference (cm)")
axes.legend(title="position gain")
figure.tight_layout()
figure.savefig(folder / "gains.png")

# %% [markdown]
# From 0.3 to 1.6 1/s the error halves, and the phase margin falls from 66 to 42 degrees. The default, 1.0 1/s, lies
# between.
#
# ## Change the gain in flight
#
# The ground station's tab *Parameters* changes the gain in flight, as does any MAVLink program: the parameter is
# `CTL_POS_GAIN`. [Change a position gain](../how-to/tune-a-gain.md) describes the steps.

# %%
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))
plt.show()
