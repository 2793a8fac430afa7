"""From a session to a Calibration: one file a procedure, from what a session shows to a fit with covariance, budget and verdict.

In: a ``Session``, raw recordings (N, 3) in the unit of the device, with stills and turns as stated in it, else found; or records
with an orientation reference each. Out: a ``Calibration``: a TriadModel for each triad, the ADC's rounding, verdict, provenance.

    session                      stills, faces, turns and temperature of a session; what every fit returns
    calibrate                    the fits that a session allows, in turn
    six_face, moves              accelerometers against gravity: on faces, in free poses (norm: |M (u - o)| = g)
    rate_table, known_rotation   gyroscopes against rates (dwells: what the table did) and angles; moves: between rests
    reference, reference_accel   both against the poses of a reference
    creep, codes                 what moves within a session; what rounding to codes does
    noise                        of a device at rest, by Allan variance
    quality, plausibility        are rests still and turns steady; answers that cannot be
    triads                       do gyroscopes and accelerometers agree on one motion
    pieces                       what recordings contain, and why it was or was not used
    settings                     settings of a fit

The method is alike in all: means over rests and turns, the errors of these means by source, least squares that weighs by them, and
a verdict whose findings name what was not observable. Results are SI, rad/s and m/s2, in axes of the case b:
corrected = M (raw - o) - G accel, its covariance by parameter as in ``model.TriadModel``. Open calibrate first, then six_face.
"""
