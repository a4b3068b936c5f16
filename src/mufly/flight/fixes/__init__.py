"""Sources of position fixes in a flight: a camera with SLAM, and fixes received over a link."""
