"""Physical priors: sizes of error sources that the readings of a session cannot show.

Each is one standard deviation. "Assumed" marks a size without a published source; it was chosen from recordings at hand.
"""

from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

MILLI_G = 1e-3 * STANDARD_GRAVITY  # m/s2

# flicker of the accelerometers' offset within a session, m/s2; bias instability of consumer parts is 0.02 to 0.1 mg. Assumed.
ACCEL_FLICKER = 0.05 * MILLI_G

# flicker of the gyroscopes' offset within a session, rad/s; bias instability of consumer parts is 3 to 15 deg/h. Assumed.
GYRO_FLICKER = 8.0 / 3600.0 * RADIAN_PER_DEGREE

# g-sensitivity of the gyroscopes, rad/s per m/s2; data sheets of consumer parts state 0.1 deg/s/g (MPU-6050).
G_SENSITIVITY = 0.1 * RADIAN_PER_DEGREE / STANDARD_GRAVITY

# scale factor that was not measured, relative: trimmed in the factory (data sheets state 1 to 3 %), and of counts. Assumed.
SCALE_FACTOR = 0.03
SCALE_FACTOR_IN_COUNTS = 0.2

# mounting of a device on a rate table before gravity measures it, rad, about each axis across the table's: loose. Assumed.
TABLE_MOUNTING = 1.0 * RADIAN_PER_DEGREE

# distance of the accelerometers from the axis of a rate table, m: half the plate of a small table. Assumed.
TABLE_ARM = 0.1

# start of a dwell in which the rate of a table settles, s: four time constants of 0.5 s. Assumed.
SETTLE_S = 2.0

# cross-axis term of a gyroscope as read, relative: data sheets of MPU-6050 and ICM-20948 state 2 %, two standard deviations.
GYRO_CROSS_AXIS = 0.01
