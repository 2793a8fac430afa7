"""Speed, as ratios within one run against a named rival or the machine's own limit: ``python -m benchmarks``."""
