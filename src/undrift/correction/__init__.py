"""Correction: a calibration applied to a record or a stream, and where it does not cover them."""
