"""Read a device live.

Input: an address, ``tcp://host:port?channels=...&rate=100``, or a TOML file that describes the stream. Output: a ``Record`` of a
stretch of time, in the device's units and axes (frame s), with rows of NaN for missing readings.

``transports`` opens ports and contains SOURCES, with one row per kind of address. ``decoder`` converts bytes to rows of numbers.
``clock`` fits the device's clock to the host's, from packets that arrive late but never early. ``recorder`` stores the readings: a
thread reads the device, and other threads ask for the readings between two times. ``hands`` is a simulated device for practice.

Device time is in s from the first reading. Dwells are requested in the host's monotonic clock. A reading belongs to a dwell only if
it was certainly taken after the start of the dwell. A corrupted reading is counted and omitted. A silent device raises an error.
Open ``recorder`` first. A new kind of source needs a function from an ``Address`` and a row in ``transports.SOURCES``.
"""
