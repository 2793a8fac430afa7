"""The lead over uneven steps against a plain numpy twin."""

import numpy as np
from scipy.integrate import solve_ivp

from undrift.kernels.calibrate import lead


def twin(temp, time, lag, smooth):
    """Integrate z' = (x - z) / smooth with x straight between samples."""
    z = [temp[0]]
    for k in range(1, len(temp)):
        slope = (temp[k] - temp[k - 1]) / (time[k] - time[k - 1])

        def rate(t, z, k=k, slope=slope):
            return (temp[k - 1] + slope * (t - time[k - 1]) - z) / smooth

        z.append(solve_ivp(rate, (time[k - 1], time[k]), [z[-1]], rtol=1e-11, atol=1e-12, method="DOP853").y[0, -1])
    z = np.array(z)
    return z + lag / smooth * (temp - z)


def test_the_lead_equals_the_numpy_twin_over_uneven_steps():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.choice((0.01, 0.3, 2.8, 40.0), 60))  # from far below to far above the time constant
    temp = 20.0 + np.cumsum(rng.normal(0.0, 0.3, 60))
    out, state = np.empty(60), np.full(4, np.nan)
    lead(temp, time, out, 30.0, 4.0, state)
    wanted = twin(temp, time, 30.0, 4.0)
    assert np.abs(out - wanted).max() < 1e-8  # the integrator's tolerance times lag / smooth
    assert state[0] == time[-1]
    assert state[1] == temp[-1]
    assert state[3] == out[-1]
