"""From a session to a Calibration: one file a procedure, from what a session shows to a fit with covariance, budget and verdict.

    observe                      stills, faces, turns and temperature of a session; what every fit returns
    calibrate                    the fits that a session allows, in turn; FITS lists them
    six_face, multi_position     accelerometers against gravity: on faces, in free poses (norm: |M (u - o)| = g)
    rate_table, known_rotation   gyroscopes against rates (dwells: what the table did) and angles; multi_position: moves
    reference, reference_accel   both against the poses of a reference
    creep, adc                   what moves within a session; what rounding to codes does
    noise                        of a device at rest, by Allan variance
    checks, pieces               answers that cannot be; what recordings hold and what was used of it

Readings (N, 3) keep the unit of the device; results are SI: rad/s, m/s2, axes of the case b. corrected = M (raw - o) - G accel, its
covariance by parameter as in ``model.TriadModel``. Open calibrate first, then six_face.
"""
