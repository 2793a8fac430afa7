"""The Earth as an inertial sensor feels it: local gravity and the rotation rate."""

import math

from undrift.errors import InputError

EARTH_RATE = 7.292115e-5  # rad/s, WGS 84
_LOWEST, _HIGHEST = -5000.0, 100e3  # m: the deepest mine; where aircraft and the series in height end


def gravity_at(latitude_deg: float, height_m: float = 0.0) -> float:
    """Return local gravity on and near the ellipsoid.

    Somigliana's formula with the free-air correction to second order in height, WGS 84 [1]_::

        g0 = 9.7803253359 (1 + 0.00193185265241 s) / sqrt(1 - 0.00669437999014 s),   s = sin^2(latitude)
        g  = g0 (1 - 2/a (1 + f + m - 2 f s) h + 3 h^2 / a^2)

    Parameters
    ----------
    latitude_deg : float
        Geodetic latitude, deg.
    height_m : float
        Height above the ellipsoid, m. Height above sea level is within 100 m of it: 0.0003 m/s2.

    Returns
    -------
    float
        Gravity, m/s2.

    Raises
    ------
    InputError
        A latitude or a height that is not one.

    References
    ----------
    .. [1] NIMA TR8350.2, "World Geodetic System 1984", 3rd ed., 2000, eqs. 4-1 and 4-3.
    """
    if not -90.0 <= latitude_deg <= 90.0:
        raise InputError(f"latitude_deg: wanted -90 to 90 deg, got {latitude_deg:g}; south is negative")
    if not _LOWEST <= height_m <= _HIGHEST:
        raise InputError(
            f"height_m: wanted {_LOWEST:.0f} to {_HIGHEST:.0f} m above the ellipsoid, got {height_m:g}; give it in metres"
        )
    a, f, m = 6378137.0, 1.0 / 298.257223563, 0.00344978650684
    s = math.sin(math.radians(latitude_deg)) ** 2
    g0 = 9.7803253359 * (1.0 + 0.00193185265241 * s) / math.sqrt(1.0 - 0.00669437999014 * s)
    h = height_m
    return g0 * (1.0 - 2.0 / a * (1.0 + f + m - 2.0 * f * s) * h + 3.0 * h * h / (a * a))
