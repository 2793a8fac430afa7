"""A rig that does not exist: a motion controller with its servo loop, behind a real socket.

Nothing here is shared with the drivers: the emulated card reads the language with a parser of its own and moves by equations of
its own.
"""
