"""Physical priors: sizes of error sources that the readings of a session cannot show.

Each is one standard deviation. "Assumed" marks a size without a published source; it was chosen from recordings at hand.
"""

from undrift.units import STANDARD_GRAVITY

MILLI_G = 1e-3 * STANDARD_GRAVITY  # m/s2

# flicker of the accelerometers' offset within a session, m/s2; bias instability of consumer parts is 0.02 to 0.1 mg. Assumed.
ACCEL_FLICKER = 0.05 * MILLI_G
