"""PX4 flies the model: its simulator link, messages and airframe file."""
