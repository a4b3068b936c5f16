"""What do the blade's sections do? Contours, the engines that compute their polars, and polars as tables."""
