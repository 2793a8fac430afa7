"""A rig that does not exist: a motion controller with its servo loop, behind a real socket."""
