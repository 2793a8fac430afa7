"""From thermal sessions and a Calibration to the tables of that Calibration, and from daily recordings to better ones.

    fit           fit_drift: the procedure, and which tables cross-validation selects
    observe       sessions made ready; means over blocks of rest and over dwells at a rate, one row each
    temperature   the thermometer's readings checked and smoothed; its lag estimated and subtracted
    offset        offset(T): means per visit and temperature, a smooth curve through them, hysteresis, warm-up, sessions
    rate_steps    M(T), and e(w, T) of what is left
    accel         accelerometers: offset(T) and M(T) from poses
    checks        what a fit is worth; do sessions and calibration belong to one device

In go ``Session`` values of kind thermal, readings (N, 3) in the device's unit and frame b, temperatures (N,) in degC. Offsets and
their uncertainties keep the device's unit; rates are rad/s, rows of means (n, 3). Out comes ``DriftFit``: a Calibration with
``DriftTables``, what they were fitted to, and a Verdict. Tables are absolute and linear between nodes; correction/correct.py looks
them up. Open fit first, then offset.
"""
