"""Simulated devices, motions and benches with known truth, with which undrift is tested.

Input: a device (``device.presets``, or a device.json), a motion (``motion``) and a random generator, which is always an argument.
Output: a ``Record``, ``Session`` or ``Reference``, as a user would have, together with the truth and the contribution of each
effect.

``device``      Forward equations from motion to reading, effect by effect, and kinds of devices by name.
``motion``      Bench sessions and daily tasks in closed form, without numerical differentiation, and their camera data.
``sessions``    Devices in motion: calibration sessions and trials. ``thermal`` does the same over temperature and hours.
``table_sessions``   Sessions dwell by dwell on a bench with errors, for studies of thousands of sessions.
``servo``       Motor and control loop of a rate table.

A device that is read in real time (``SimulatedDevice``) is part of the simulated bench of `rig` and of the hand-held device of
`live`.

Rates are in rad/s, forces in m/s2 and temperatures in degC. Frame b is the case, and n is level with z up. Quaternions turn b to n
and are scalar first. Readings are in the unit of the device's data sheet. The forward equations are written only here. Nothing is
imported from fits, correction, orientation or validation, because a common sign error would otherwise remain undetected. Each
effect draws from its own named stream. Open ``device/effects`` first, then ``device/simulate``.
"""
