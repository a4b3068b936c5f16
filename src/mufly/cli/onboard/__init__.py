"""``mufly sensors`` and ``mufly firmware``: sensors and on-board code of a vehicle."""
