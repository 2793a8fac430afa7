"""Fit the tables of a Calibration to thermal sessions.

    fit           fit_drift: the procedure
    observe       preparation of sessions, means over blocks of rest and over dwells at a rate, one row each
    temperature   checks and smoothing of the thermometer's readings, estimate and subtraction of its lag
    offset        offset(T): means per visit and temperature, a smooth curve through them, hysteresis, warm-up, sessions
    rates         M(T), and the dynamic drift e(w, T) that remains
    accel         accelerometers: offset(T) and M(T) from poses
    verdict       quality of the tables, and whether sessions and calibration belong to the same device

Input: ``Session`` values of kind thermal, with readings (N, 3) in the device's unit and frame b, and temperatures (N,) in degC.
Offsets and their uncertainties keep the device's unit. Rates are in rad/s, with one row (n, 3) per mean.
Output: ``DriftFit``, a Calibration with ``DriftTables``, the data of the fit, and a Verdict. Tables are absolute and linear between
nodes. correction/correct.py applies them. Open fit first, then offset.
"""
