"""GRBL boards: a stepper axis by jogs and status reports."""
