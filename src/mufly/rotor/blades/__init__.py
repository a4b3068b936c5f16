"""Blades: families, files, solids, and the geometry measured on real ones."""
