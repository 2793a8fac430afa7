"""Validation: what a calibration is worth in degrees, on real motion, against an orientation reference."""
