"""Commands, one file each: a function that turns options into a ``Report``.

A command reads its inputs, checks its output files before the work begins, calls the stages, writes the files and
returns its report. It prints and draws nothing. Parameters are the options of the command line, and the docstring is the
help. Settings that several commands share are dataclasses marked ``@options`` (``files.py``). Angles and rates of options
are in the units of their names. Open ``orient.py`` first, the shortest complete command.
"""
