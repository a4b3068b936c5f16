"""A remote vehicle as the station knows it: telemetry, commands, transfers, and the pilot's sticks."""
