"""A rate table that calibrates a device by itself: from a protocol to readings on the disk, whatever controller stands behind it.

In: a protocol (``undrift.programme``: faces, rates, temperatures), the addresses of a table, a device and, if it is warmed, a
chamber. Out: a folder with a recording for each dwell and ``session.toml``, which `calibrate` and `drift` read. The rate of a
dwell is the one that the encoder shows, not the one that was asked for.

``rig``         what every table can do, its limits, the rate achieved
``galil``, ``grbl``, ``manual``   controllers behind ``link``; ``chamber``: when air and board of a chamber stand still
``run``         a programme on a rig, dwell by dwell; ``judge`` says which dwells are kept, ``folder`` brings them to the disk
``simulated``   a bench without hardware: table, chamber, device and operator, in simulated time
``lock``        one run for one table, and a run that signals end at rest; ``check``: acceptance of a table with a servo

Angles are rad and rates rad/s about the table's own axis, +z up; a device is read in its own axes (frame s) and units. Times are
those of the table's clock (base/clock.py): the host's, or that of a simulated bench. deg, deg/s and
degC appear in messages and files alone. Numbers are rounded as the controller rounds them, before a byte is sent, and read back.
Whatever ends a run, the table is at rest and its motor off, or the message says NOT CONFIRMED. No estimator is imported.
Open ``run`` first; a new controller is a file like ``grbl`` and a row in ``rig.CONTROLLERS``.
"""
