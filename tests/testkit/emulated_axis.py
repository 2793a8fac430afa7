"""What tests ask of an emulated axis."""

import numpy as np


def present(machine):
    """Return angle and rate of the axis of an emulated machine now, rad and rad/s."""
    if hasattr(machine, "card"):
        with machine.lock:
            machine.tick()
            _, angle, rate = machine.card.axis.history(0.0)
    else:
        angle, rate = machine.states(np.array([machine.clock.now()]))
    return float(angle[-1]), float(rate[-1])


def axis_angle(emulator):
    """Return the true angle of the axis now, rad."""
    return present(emulator.machine)[0]


def axis_rate(emulator):
    """Return the true turn rate of the axis now, rad/s."""
    return present(emulator.machine)[1]


def axis_state(emulator, time, *, mean_s=0.0):
    """Return the true angle and turn rate at a moment of the past, or now."""
    angle, rate = emulator.axis_states(np.array([time]), mean_s=mean_s)
    return float(angle[0]), float(rate[0])
