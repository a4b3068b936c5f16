"""What does one see? The station's page: NiceGUI for what is pressed and typed, drawings fed by a stream of frames.

The page draws :mod:`mufly.station.signal_history` and histories only. NiceGUI is imported by what is used, not here: a
command that shows no page must not wait for it.
"""
