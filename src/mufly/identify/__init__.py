"""What are its parameters? Fits to bench and flight data, with uncertainty and validation."""

from mufly.identify.result import Estimate, Fit, RecordFit

__all__ = ["Estimate", "Fit", "RecordFit"]
