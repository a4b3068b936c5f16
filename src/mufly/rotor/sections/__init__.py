"""Blade sections: contours, engines that compute polars, and polar tables."""
