"""Meshes of a blade's sector: hub and tips, section meshes, stacked sections, and files in OpenFOAM's format."""
