"""ArduPilot flies the model: its simulator link and its parameters."""
