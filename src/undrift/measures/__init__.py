"""Measures of motor tasks from one worn device, each with the uncertainty that the instrument adds.

    worn          readings, mounting and their uncertainties; from them the course of the segment: pitch, rates, accelerations
    tasks         which function measures which task; what a task returns: values, events
    rising        sit-to-stand, five times sit-to-stand
    standing      sway of quiet stance
    stepping      rising a step, or stairs
    up_and_go     timed up and go: phases and turns
    walking       steps, strides and their spread
    uncertainty   from what is uncertain of the readings to what is uncertain of a measure, and the smallest change between visits

In go a corrected ``Record`` and a ``BodyMounting``; inside, time is in s, angles are rad, rates rad/s, accelerations m/s2. The
segment's axes a point forward, left and up when the wearer stands upright; forward lean is positive. Values leave under names
that end in their unit, as the field names them: ``peak_trunk_pitch_deg``. Events are those of BIDS: onset and duration in s since
the first sample, and a type. Open rising first.
"""
