"""Who watches? The ground station: what it knows of a vehicle, what it asks of it, and its page."""
