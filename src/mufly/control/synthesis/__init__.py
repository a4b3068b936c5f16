"""Synthesis of controllers: H-infinity, H2, LQG and INDI, their weights, and the table of methods."""
