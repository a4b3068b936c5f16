"""Calibration of a camera: its lens from a chessboard, its mount and delay from a motion by hand."""
