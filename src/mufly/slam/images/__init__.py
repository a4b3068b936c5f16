"""Measurements on pictures of the floor: information of patches, direct alignment, checks of the camera."""
