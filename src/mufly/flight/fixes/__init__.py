"""Sources of position fixes in a flight: the camera with its pictures, and fixes that come by a link."""
