"""Export of the flight software as C: the sources, and tables with the numbers of a vehicle and a mission."""
