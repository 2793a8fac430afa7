"""An emulated Galil card: its language, numbers, programs and what it tells."""
