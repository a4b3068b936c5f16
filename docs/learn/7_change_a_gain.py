# %% [markdown]
# # 7. Change a gain and fly
#
# Five minutes. The position loop has one gain: the velocity that it requests per metre of position error. You change
# it, read the margins of the loop, and fly in the same wind.

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
# `seed` gives every flight the same gusts, so the gain is the only difference.

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
        f"phase margin {controller.cascade.phase_margin_deg:.0f} deg, {data.attrs['outcome']}"
    )
axes.set(xlabel="time (s)", ylabel="distance from the reference (cm)")
axes.legend(title="position gain")
figure.tight_layout()
figure.savefig(folder / "gains.png")

# %% [markdown]
# A higher gain halves the error and costs phase margin: 0.3 1/s leaves 66 degrees, 1.6 1/s leaves 42 degrees. The
# default, 1.0 1/s, lies between.
#
# ## The same on the page and in a mission
#
# On the page of `mufly fly`, the tab *Parameters* changes `CTL_POS_GAIN` in flight. Over MAVLink the parameter has
# the same name. [Tune a gain](../how-to/tune-a-gain.md) shows these ways.

# %%
print("pictures:", *sorted(str(p) for p in folder.glob("*.png")))
plt.show()
