"""Bridges: other people's autopilots fly the simulated vehicle.

The plant, its wind, its sensors with their faults, its battery and the recording are those of
:class:`mufly.flight.Flight` (:mod:`mufly.bridges.autopilot_plant`). PX4 exchanges MAVLink messages in lockstep
(:mod:`mufly.bridges.px4_link`), and ArduPilot packets of its JSON interface (:mod:`mufly.bridges.ardupilot_link`).
Gains, margins and parameter files for both come from the linear model of the vehicle file
(:mod:`mufly.bridges.autopilot_gains`).
"""

__all__: list[str] = []
