"""What every stage may use and what no stage decides: values as files, options, summaries, the clock.

``codec``
    A frozen dataclass is its own file: ``@stored`` marks the class, ``read`` and ``write`` carry it from and to JSON or TOML.
``options``
    The fields of a dataclass are the options of a command.
``summary``
    What a command has to say, once: the terminal, a page, JSON and a notebook show it.
``clock``
    The time of rigs and simulated benches: the host's, faster, or virtual.

A file has the keys of its fields; ``Key`` states another place (``units.gyro``), another unit (deg/s in the file, rad/s in the
value), or that a key may be left out. Numbers read back to the last bit. NaN is null; infinity, which JSON does not know, is "inf".
An unknown key, a missing key and a value of another type are errors that name the key, what was wanted, what came and what to do.
``complete`` of ``@stored`` takes the tree of a file and returns it with what it implies.

Open ``codec`` first; its docstring has a worked example. Nothing here knows a sensor, a frame or a unit but by its factor to SI.
pydantic checks the types; it is imported when the first file is read, so that ``import undrift`` and ``--help`` stay quick.
"""
