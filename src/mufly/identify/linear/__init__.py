"""Linear models from recorded flights: structure, frequency and time domain fits, checks."""
