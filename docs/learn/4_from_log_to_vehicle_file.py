# %% [markdown]
# # 4. From a flight log to a vehicle file
#
# This lesson takes fifteen minutes. A test bench measures motors and rotors. Inertias, the linkages of swash plate and
# stabiliser bar, and the interference of the rotors are identified from flight records. Here the records are simulated
# with known parameters, so you can check each estimate **and its interval**. For your own logs the command is `mufly
# identify flight LOG... --vehicle mufly-1.1 --free ...`.

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
print("records to fit:", [record.name for record in flights], "record to test the fit:", held_out[0].name)

# %% [markdown]
# ## The records
#
# A record identifies a parameter only if that parameter changes the measured motion. In the yaw flight the input of one
# motor is a chirp (a sine of rising frequency); in the roll flight the roll reference varies.

# %%
roll = next(r for r in flights if r.name.endswith("roll"))
figure, (given, answer) = plt.subplots(2, 1, figsize=(9, 4), sharex=True)
given.plot(roll.time_s, roll.inputs[:, 3], label="input of servo 2")
given.set(ylabel="servo 2 (1)")
answer.plot(roll.time_s, np.degrees(roll.measured[:, roll.output_names.index("roll")]), label="measured roll angle")
answer.set(ylabel="roll (deg)", xlabel="time (s)")
given.legend()
answer.legend()
figure.tight_layout()
figure.savefig(folder / "record.png")

# %% [markdown]
# ## Fit
#
# Five parameters start with an error of 50 %: the torque coefficients of both rotors (`cQ_up`, `cQ_dw`), the linkages
# of stabiliser bar and swash plate (`l_up`, `l_dw`), and the yaw inertia (`Izz`).

# %%
symbols = ("cQ_up", "cQ_dw", "Izz", "l_up", "l_dw")
rows = {r.symbol: r for r in list_parameters(truth)}
wrong = dict(zip(symbols, (0.5, 1.5, 1.5, 1.5, 0.5), strict=True))
start = replace_parameters(truth, {rows[s].key: rows[s].value * wrong[s] for s in symbols}, source="estimated")
free = choose_free_parameters(start, symbols, flights[0].output_names)
fit = fit_flight_records(start, free, flights, held_out=held_out, delay_s=RADIO_DELAY_S, held_exact=True)
print(fit.message)

# %%
print(f"{'':8s}{'truth':>12s}{'start':>12s}{'found':>12s}   95 % interval")
for e in fit.estimates:
    true = rows[e.symbol].value
    miss = "" if e.low <= true <= e.high else " (misses!)"
    print(f"{e.symbol:8s}{true:12.4g}{e.start:12.4g}{e.value:12.4g}   {e.low:.4g} to {e.high:.4g}{miss}")

# %% [markdown]
# An interval of 95 % misses the true value once in twenty cases. More frequent misses mean that the model or the
# records are wrong; with real data, where the truth is unknown, the report lists unusual residuals instead.
#
# ## Prediction
#
# The test uses a flight that the fit has not seen. The fitted model predicts its motion from the inputs alone.

# %%
unseen = fit.records[-1]
figure, axes = plt.subplots(figsize=(9, 3))
k = unseen.output_names.index("roll")
axes.plot(unseen.time_s, np.degrees(unseen.measured[:, k]), ".", ms=2, label="measured")
axes.plot(unseen.time_s, np.degrees(unseen.predicted[:, k]), label="predicted, open loop")
axes.set(xlabel="time (s)", ylabel="roll (deg)", title=unseen.name)
axes.legend()
figure.tight_layout()
figure.savefig(folder / "unseen.png")

# %% [markdown]
# ## The vehicle file
#
# In the vehicle file the estimates replace the start values, with their standard deviations and the source
# `identified`. `mufly fly --vehicle lesson-4/identified.toml` flies it.

# %%
found = apply_estimates(start, fit.estimates, "lesson 4")
(folder / "identified.toml").write_text(format_vehicle_toml(found), encoding="utf-8")
print("written:", *sorted(str(p) for p in folder.iterdir()))
plt.show()

# %% [markdown]
# ## Try
#
# * Fly the records in wind: `fly_demo_flights(truth, wind=0.5, gust=0.3)`. Which intervals grow?
# * Fit the rotor inertias `Jrot_up` and `Jrot_dw` as well. `mufly identify plan` computes which flight identifies them.
# * [Identification](../explanation/identification.md) explains the method and its assumptions.
