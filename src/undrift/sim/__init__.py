"""A device, a motion and a bench that do not exist: what undrift is tried on, with the truth beside it.

In: a device (``device.presets``, or a device.json), a motion (``motion``) and a generator of random numbers, which is always an
argument. Out: what a user would have, a ``Record``, ``Session`` or ``Reference``, and what nobody else has: the truth and what each
effect added to it.

``device``      what lies between motion and reading, effect by effect, as forward equations; kinds of devices by name
``motion``      bench sessions, tasks of daily life and what cameras see of them, in closed form: nothing is differentiated
``sessions``    a device in a motion: calibration sessions and trials; ``thermal`` the same over temperature, hours long
``table_sessions``, ``bench_errors``   sessions dwell by dwell on a bench that errs, for studies of thousands
``host``                             a host that stamps late
``servo``       motor and loop of a rate table

A device that is read as time goes on (``device.causal``) is on the simulated bench of `rig`, or in a person's hands in `live`.

Rates are rad/s, forces m/s2, temperatures degC; b is the case, n level with z up, quaternions turn b to n and are scalar first.
Readings are in the unit of the device's data sheet. The forward equations are written here and nowhere else: nothing is imported
from fits, correction, orientation or validation, so that a sign that is wrong in both cannot hide. Each effect draws from a stream
of its own name. Open ``device/effects`` first, then ``device/simulate``.
"""
