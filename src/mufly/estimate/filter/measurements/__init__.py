"""Update of the filter by the measurement of each sensor, and checks of the sensors."""
