"""Tools for all stages: files of values, options and clocks.

``codec``
    Files of values: a ``FileTable`` is a table of a TOML file, and ``@stored`` marks a dataclass of a JSON file.
``options``
    The fields of a dataclass are the options of a command.
``spoken``
    Names of arguments in messages. The command line shows them as options.
``clock``
    The time of rigs and simulated benches: real, accelerated or virtual.

A file has the keys of its class, in the units of the file. Numbers are read back without loss. NaN is stored as null and
infinity as "inf", because JSON has neither. Unknown keys, missing keys and values of another type are errors. The message
names the key, the expected and the actual value, and the remedy.

Open ``codec`` first. Its docstring contains a worked example. Sensors and frames do not occur here. pydantic checks the types,
and it builds its validators when the first file of a class is read.
"""
