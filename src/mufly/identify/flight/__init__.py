"""Vehicle parameters from recorded flights: problem, simulation, fit, excitation plan, demonstration."""
