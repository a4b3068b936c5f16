"""Export of flight software as C: sources, and the tables that a vehicle and a mission give."""
