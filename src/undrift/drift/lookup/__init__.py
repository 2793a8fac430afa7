"""Tables in use: made ready for the kernels, what they are looked up with, and where they do not cover a record."""
