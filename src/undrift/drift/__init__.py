"""Thermal drift, left to right: temperature -> observe -> fit -> tables in a Calibration (procedure.py) -> lookup in use."""
