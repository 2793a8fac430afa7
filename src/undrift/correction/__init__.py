"""Apply a Calibration to raw readings: the only place where a calibration is applied.

    correct       correct, correct_checked and the stream Corrector: the model in eight steps
    plan          constants of these steps, computed once for correction, stream and exports, and cells of the tables
    coverage      samples with temperature, rate or readings beyond the calibration
    consistency   check that the record comes from the device of the calibration
    rest          mean rate at a rest, and uncertainty of the specific force there
    motion        offset of the gyroscopes from gravity in motion

Input: a ``Record`` as the device wrote it, (N, 3) in its unit and frame b, with temperatures (N,) in degC if there are tables.
Output: a ``Record`` in rad/s and m/s2, frame b, with NaN for gaps. ``Corrected`` adds masks, findings and the state for the next
chunk. Kernels are in kernels/correct.py. Open correct first.
"""
