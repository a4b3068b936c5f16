"""The mission state machine: states, phases, reference, requests and offboard set-points."""
