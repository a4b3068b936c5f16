"""The station's page: NiceGUI for buttons and fields, drawings fed by a stream of frames.

The page uses only the data types of :mod:`mufly.station.signal_history`. NiceGUI is imported by the submodules, not
here, so that commands without a page start fast.
"""
