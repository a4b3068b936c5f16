# %% [markdown]
# # 4. From a flight log to a vehicle file
#
# Fifteen minutes. Benches say what a motor and a rotor do; inertias, linkages and what rotors do to each other in
# flight come from flights. Here the "real" helicopter is a simulation whose truth is known, so that you can see
# whether the answer, **and its error bar**, are right. With your own: `mufly identify flight LOG... --vehicle
# mufly-1.1 --free ...`.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mufly.identify import apply_estimates, choose_free_parameters, fit_flight_records
from mufly.identify.flight.identification_demo import RADIO_DELAY_S, fly_demo_flights
from mufly.vehicle import format_vehicle_toml, list_parameters, load_vehicle, replace_parameters

folder = Path("lesson-4")  # for pictures and the vehicle file
folder.mkdir(exist_ok=True)
truth = load_vehicle("mufly-1.1")
flights, held_out = fly_demo_flights(truth, seed=3, seconds=8.0)
print([record.name for record in flights], "and, never to be fitted,", held_out[0].name)

# %% [markdown]
# ## Look before you fit
#
# A flight shows a parameter only where that parameter matters. The yaw flight shakes one motor with a chirp; the roll
# flight shakes the roll set-point.

# %%
roll = next(r for r in flights if r.name.endswith("roll"))
figure, (given, answer) = plt.subplots(2, 1, figsize=(9, 4), sharex=True)
given.plot(roll.time_s, roll.inputs[:, 3], label="input of servo 2")
given.set(ylabel="servo 2 (1)")
answer.plot(roll.time_s, np.degrees(roll.measured[:, roll.outputs.index("roll")]), label="measured roll angle")
answer.set(ylabel="roll (deg)", xlabel="time (s)")
given.legend()
answer.legend()
figure.tight_layout()
figure.savefig(folder / "record.png")

# %% [markdown]
# ## Forget, and find again
#
# Five numbers are taken to be wrong by half: two torque coefficients, two linkages, and the inertia about the
# vertical axis.

# %%
symbols = ("cQ_up", "cQ_dw", "Izz", "l_up", "l_dw")
rows = {r.symbol: r for r in list_parameters(truth)}
wrong = dict(zip(symbols, (0.5, 1.5, 1.5, 1.5, 0.5), strict=True))
start = replace_parameters(truth, {rows[s].key: rows[s].value * wrong[s] for s in symbols}, source="estimated")
free = choose_free_parameters(start, symbols, flights[0].outputs)
fit = fit_flight_records(start, free, flights, held_out=held_out, delay_s=RADIO_DELAY_S, held_exact=True)
print(fit.message)

# %%
print(f"{'':8s}{'truth':>12s}{'start':>12s}{'found':>12s}   95 % interval")
for e in fit.estimates:
    true = rows[e.symbol].value
    miss = "" if e.low <= true <= e.high else " (misses!)"
    print(f"{e.symbol:8s}{true:12.4g}{e.start:12.4g}{e.value:12.4g}   {e.low:.4g} to {e.high:.4g}{miss}")

# %% [markdown]
# An interval of 95 % may miss one time in twenty. Should it miss more often, something is wrong with the model or the
# records, and the report says what looks odd.
#
# ## Does it predict?
#
# The only test that counts is a flight that the fit has not seen.

# %%
unseen = fit.records[-1]
figure, axes = plt.subplots(figsize=(9, 3))
k = unseen.outputs.index("roll")
axes.plot(unseen.time_s, np.degrees(unseen.measured[:, k]), ".", ms=2, label="measured")
axes.plot(unseen.time_s, np.degrees(unseen.predicted[:, k]), label="predicted, open loop")
axes.set(xlabel="time (s)", ylabel="roll (deg)", title=unseen.name)
axes.legend()
figure.tight_layout()
figure.savefig(folder / "unseen.png")

# %% [markdown]
# ## The vehicle file
#
# What was found replaces the start values, with its interval and source `identified`. The new file is flown like any
# other: `mufly fly --vehicle lesson-4/identified.toml`.

# %%
found = apply_estimates(start, fit.estimates, "lesson 4")
(folder / "identified.toml").write_text(format_vehicle_toml(found), encoding="utf-8")
print("written:", *sorted(str(p) for p in folder.iterdir()))
plt.show()

# %% [markdown]
# ## Try
#
# * `fly_demo_flights(truth, wind=0.5, gust=0.3)`: which intervals grow?
# * Free `Jrot_up` and `Jrot_dw` as well. `mufly identify plan` says beforehand which flight would show them.
# * What is assumed: [identification](../explanation/identification.md).
