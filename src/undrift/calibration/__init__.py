"""Fit a Calibration to a Session: one file per procedure, each returning a fit with covariance, budget and verdict.

In: a ``Session`` of raw recordings (N, 3) in the unit of the device. Its stills and turns are used as given, or detected. Motion
calibrations need only recordings, with or without an orientation reference.
Out: a ``Calibration`` with a TriadModel for each triad, the rounding of the ADC, verdict and provenance.

    session                      stills, faces, turns and temperature of a session, and the result type of every fit
    calibrate                    choice among the fits that a session allows
    six_face, moves              accelerometers against gravity, on faces or in free poses (norm: |M (u - o)| = g)
    rate_table, known_rotation   gyroscopes against steady rates and known angles (table: true axes and rates of a dwell)
    reference, reference_accel   both triads against the poses of a reference
    in_motion, magnetometer      both triads and the magnetometer in free motion
    sources, codes               drift within a session, and rounding to codes
    noise                        Allan variance of a device at rest
    quality, plausibility        checks of rests and turns, and of implausible results
    triads                       agreement of gyroscopes and accelerometers on one motion
    settings                     settings of a fit

All procedures share one method. They compute means over rests and turns, and the errors of these means by source. Least squares
weights the means with these errors. The findings of the verdict name the parameters that were not observable.
Results are in SI units, rad/s and m/s2, in axes of the case b: corrected = M (raw - o) - G accel. The covariance follows the
parameters as in ``model.TriadModel``. Open calibrate first, then six_face.
"""
