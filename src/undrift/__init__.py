"""undrift: calibrate a wearable inertial sensor, compensate its thermal drift, and prove the benefit in degrees.

Data flow from left to right, with one file or folder per stage::

    record -> segments -> calibration -> drift -> correction -> orientation -> validation -> report

Frames: s sensor axes, b device case, m optical body, n level (z up). ``q_nb`` is scalar first and maps b to n. At rest, the
accelerometer axis that points up reads +g. Inside the package, values are in rad/s, m/s2, s and degC. Raw readings keep the
device's unit, which is stored with them. Time is axis 0: (N,), (N, 3), (N, 4). NaN always means a gap.

    corrected = matrix @ (raw - offset)            ``correction/correct.py`` is the only implementation

Stages are functions on values: ``correct(record, calibration)``. Commands (``undrift.commands``) are functions on files,
and return the report that the command line shows.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
