"""Validation: what a calibration is worth in degrees, on real motion, against an orientation reference.

    trial              one recording against its reference: lag, mounting, strapdown from rest, errors
    levels             each level of correction over trials, people and tasks
    agreement          several recordings: means, leave-one-out; agreement of methods, differences against a margin
    expected           the errors that a calibration's uncertainty lets one expect
    reference_frames   do device and reference mean the same quaternions, verticals and signs
    table_worth        the angle error to expect with and without tables over temperature

In go a ``Record`` and a ``Reference``, each on its own clock, and a Calibration or none. Inside, rates are rad/s, angles rad,
quaternions (N, 4) body to level, scalar first; out come ``Trial`` and ``Validation`` with figures in degrees and errors sample by
sample in rad. Open trial first.
"""
