"""Validation of a calibration on real motion: orientation errors in degrees against an orientation reference.

    trial              one recording against its reference: lag, strapdown from rest, errors
    align              rotation between device and reference, and check that both use the same conventions
    levels             levels of correction over trials, people and tasks
    agreement          several recordings: means, leave-one-out, agreement of methods and differences against a margin
    expected           errors expected from a calibration's uncertainty
    table_worth        expected angle error with and without tables over temperature

Input: a ``Record`` and a ``Reference``, each on its own clock, and optionally a Calibration. Internally, rates are in rad/s, angles
in rad, and quaternions (N, 4) turn body to level, scalar first. Output: ``Trial`` and ``Validation`` with results in degrees and
errors per sample in rad. Open trial first.
"""
