"""Live readings of a device. In: an address, ``tcp://host:port?channels=...&rate=100``, or a TOML file that describes the stream.
Out: a ``Record`` of a stretch of time, in the device's units and axes (frame s), with rows of NaN where readings are missing.

``transports`` are ways for bytes and SOURCES, a row for each kind of address; ``decoder`` makes rows of numbers of bytes; ``clock``
lays the device's clock on the host's, from packets that come late and never early; ``recorder`` is the one ring: a thread reads,
any other asks for what came between two moments. ``hands`` is a simulated device to practise with.

Device time is in s from the first reading; dwells are asked for by the host's monotonic clock, and a reading counts for one only
where it was certainly taken after its start. A garbled reading is counted and left out, a silent device is an error. Open
``recorder`` first; a new kind of source is a function from an ``Address`` and a row in ``transports.SOURCES``.
"""
