"""Tools for all stages: values as files, options and clocks.

``codec``
    Stores frozen dataclasses: ``@stored`` marks the class, ``read`` and ``write`` convert it from and to JSON or TOML.
``options``
    The fields of a dataclass are the options of a command.
``spoken``
    Names of arguments in messages, which the command line shows as options.
``clock``
    The time of rigs and simulated benches: real, accelerated or virtual.

A file has the keys of its fields. ``Key`` sets another path (``units.gyro``), another unit (deg/s in the file, rad/s in
the value), or makes a key optional. Numbers read back to the last bit. NaN is stored as null and infinity as "inf",
because JSON has neither. Unknown keys, missing keys and values of another type are errors. The message names the key,
the expected and the actual value, and the remedy. ``complete`` of ``@stored`` receives the tree of a file and returns
it with implied keys added.

Open ``codec`` first. Its docstring has a worked example. Sensors and frames do not occur here, and units only as
factors to SI. pydantic checks the types. It is imported when the first file is read, so that ``import undrift`` and
``--help`` stay quick.
"""
