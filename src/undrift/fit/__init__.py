"""What all fits share: weighted least squares with covariance, and smoothing."""
