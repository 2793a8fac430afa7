"""Twin: the device model fitted to a real device, and its accuracy on a motion that was not used in the fit.

Input: raw recordings of a device, which begin at rest, each with an orientation reference (poses of the same body). Output: a
``Twin``, in which every parameter has its standard error or the reason why these recordings do not identify it.
``held_out`` computes the errors of its simulated readings on other recordings.

    accel      a recording and the ideal motion of its reference, with a fit of accelerometers, lever arm and delay to force
    fit        all parameters: gyroscopes by windows (calibration.reference), noise at rest, ADC
    held_out   errors of the twin over windows of a motion that was not used in the fit

Frames: s sensor, b body of the reference, n level with z up. A matrix M converts readings to b. Units are rad/s, m/s2, s and m, and
time is axis 0. Open fit first, then held_out.
"""
