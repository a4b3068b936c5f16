"""Commands and options of rotors: CFD, measurements, benchmark, forward flight, structure."""
