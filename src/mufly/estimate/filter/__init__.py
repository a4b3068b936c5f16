"""The Kalman filter as compiled functions: records, strapdown equations, U-D factors, fusion and sensor checks."""
