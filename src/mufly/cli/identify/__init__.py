"""``mufly identify``: parameters from test benches, flights and linear models; the plan of flights that show them."""
