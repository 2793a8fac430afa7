"""An emulated GRBL board: its language, planner and reports."""
