"""Tuning tables: how they are read at run time."""
