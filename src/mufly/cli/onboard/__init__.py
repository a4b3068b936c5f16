"""``mufly sensors`` and ``mufly firmware``: what a vehicle carries, and the code that runs on it."""
