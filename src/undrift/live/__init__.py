"""Live readings of a device: where they come from, on which clock, and how they reach whoever asks.

In: an address, ``tcp://host:port?channels=count,gyro_x,...&rate=100``, or a TOML file that describes the stream.
Out: a ``Record`` of a stretch of time, in the device's units and axes (frame s), with rows of NaN where readings are missing.

``transports``  ways for bytes (TCP, UDP, serial, LSL, Bluetooth) and SOURCES: one row for each kind of address
``decoder``     bytes to rows of numbers, as lines or as frames, with checksums; what a counter says was lost
``clock``       the device's clock on the host's, from packets that come late and never early
``recorder``    the one ring: a thread reads, any other asks for what came between two moments
``daq``         sensors on a data-acquisition board, in volts

Two clocks are at work: device time in s from the first reading, which is the time of a record, and the host's monotonic clock, by
which dwells are asked for. A reading counts for a dwell only where it was certainly taken after its start. A garbled reading is
counted and left out, a silent device is an error. Raw units are those that the address states (count, v, dps, g ...); nothing is
scaled but the thermometer, and the volts of a sensor that a `daq` address names.

Open ``recorder`` first; a new kind of source is a function from an ``Address`` and a row in ``transports.SOURCES``.
"""
