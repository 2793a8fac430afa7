"""The command line: views that call stages and compute nothing. Every number shown is a field of a result."""
