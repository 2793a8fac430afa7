"""Run calibration protocols on a rate table without an operator, with any supported controller.

Input: a protocol (``undrift.programme``: faces, rates, temperatures) and the addresses of a table, a device and, for a heated run,
a chamber. Output: a folder with one recording per dwell and ``session.toml``, which `calibrate` and `drift` read. The turn rate of
a dwell is the rate measured with the encoder, not the commanded rate. Modules:

``rig``         Interface of every table, its limits, the achieved rate.
``run``         Runs a programme dwell by dwell. ``judge`` accepts or rejects each dwell, and ``folder`` writes it to the disk.
``galil``, ``grbl``, ``manual``   Controllers, which use ``link``. ``chamber`` decides when air and board of a chamber are steady.
``simulated``   Simulated bench without hardware: table, chamber, device and operator.
``lock``        Allows one run per table and stops it on signals. ``check`` is the acceptance test of a servo table.

Angles are in rad and rates in rad/s, about the table's own axis, +z up. A device is read in its own axes (frame s) and units. Times
are from the table's clock (base/clock.py), either the host's clock or the clock of a simulated bench. Only messages and files use
deg, deg/s and degC. Numbers are rounded as the controller rounds them before they are sent, and are then read back. At the end of
every run, the table is at rest and its motor is off. Otherwise the message contains NOT CONFIRMED. No estimator is imported. Open
``run`` first. A new controller needs a file like ``grbl`` and a row in ``rig.CONTROLLERS``.
"""
