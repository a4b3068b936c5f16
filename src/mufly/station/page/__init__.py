"""The station's page: NiceGUI for buttons and fields, drawings fed by a stream of frames.

The page draws :mod:`mufly.station.signal_history` and histories only. NiceGUI is imported by the submodules, not here,
so that commands without a page start fast.
"""
