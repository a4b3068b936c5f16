"""Betaflight flies the model: its simulator link, command line, messages, pilot and settings."""
