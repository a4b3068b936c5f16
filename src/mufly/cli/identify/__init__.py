"""``mufly identify``: parameters from test benches, flights and linear models; plans of identification flights."""
