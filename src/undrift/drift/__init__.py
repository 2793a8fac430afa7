"""From thermal sessions and a Calibration to the tables of that Calibration.

    fit           fit_drift: the procedure, and which tables cross-validation selects
    observe       sessions made ready; means over blocks of rest and over dwells at a rate, one row each
    temperature   the thermometer's readings checked and smoothed; its lag estimated and subtracted
    offset        offset(T): means per visit and temperature, a smooth curve through them, hysteresis, warm-up, sessions
    rates         M(T), and the dynamic drift e(w, T) that remains
    accel         accelerometers: offset(T) and M(T) from poses
    verdict       whether the tables can be trusted, and whether sessions and calibration belong to one device

Input: ``Session`` values of kind thermal, readings (N, 3) in the device's unit and frame b, temperatures (N,) in degC. Offsets and
their uncertainties keep the device's unit; rates are rad/s, rows of means (n, 3). Output: ``DriftFit``, a Calibration with
``DriftTables``, the data they were fitted to, and a Verdict. Tables are absolute and linear between nodes; correction/correct.py
looks them up. Open fit first, then offset.
"""
