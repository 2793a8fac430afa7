"""twin: the device model fitted to a real device, and how well it speaks for it on a motion that it has not seen."""
