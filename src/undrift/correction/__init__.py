"""Raw readings and a Calibration to rate and specific force: the only place where a calibration is applied.

    correct       correct, correct_checked and the stream Corrector: the model in six steps
    plan          the constants of these steps, derived once for correction, stream and exports; cells of the tables
    coverage      where temperature, rate or readings went beyond the calibration
    consistency   is it the device of the calibration
    rest          the mean rate left at a rest; what is uncertain of the specific force there

In goes a ``Record`` as the device wrote it, (N, 3) in its unit and frame b, and (N,) degC where there are tables. Out comes a
``Record`` in rad/s and m/s2, frame b, with NaN for gaps, and in ``Corrected`` the masks, findings and the state that the next
chunk needs. Kernels are in kernels/correct.py. Open correct first.
"""
