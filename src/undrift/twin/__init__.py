"""Twin: the device model fitted to a real device, and how well it speaks for it on a motion that it has not seen.

In: raw recordings of one device with an orientation reference (poses of the same body), each begun at rest. Out: a ``Twin``, every
parameter with its standard error or the finding that says why these recordings do not identify it; errors of its simulated readings
on recordings that it was not fitted to.

    accel      a recording and the ideal motion of its reference; accelerometers, lever arm and delay by specific force
    fit        all parameters: gyroscopes by windows (calibration.reference), noise at rest, ADC
    held_out   the twin simulated on a motion that it has not seen: errors over windows

Frames: s sensor, b body of the reference, n level with z up; a matrix M takes readings to b. Units: rad/s, m/s2, s, m; time is
axis 0. Open fit first, then held_out.
"""
