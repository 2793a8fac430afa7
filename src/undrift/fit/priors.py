"""Physical priors: sizes of error sources that the readings of a session cannot determine.

Each is a standard deviation. "Assumed" marks a size without a published source, chosen from available recordings. A session or an
option overrides a size if the comment names it.
"""

from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

MILLI_G = 1e-3 * STANDARD_GRAVITY  # m/s2

# ---- offsets within a session

# flicker of the accelerometers' offset, m/s2 (consumer parts: bias instability of 0.02 to 0.1 mg). Assumed.
ACCEL_FLICKER = 0.05 * MILLI_G

# flicker of the gyroscopes' offset, rad/s (consumer parts: bias instability of 3 to 15 deg/h). Assumed.
GYRO_FLICKER = 8.0 / 3600.0 * RADIAN_PER_DEGREE

# angle random walk of the gyroscopes, rad/sqrt(s) (consumer parts: 0.003 to 0.01 deg/sqrt(s)). Assumed.
GYRO_NOISE = 0.006 * RADIAN_PER_DEGREE

# g-sensitivity of the gyroscopes, rad/s per m/s2 (data sheets of consumer parts: 0.1 deg/s/g, MPU-6050).
G_SENSITIVITY = 0.1 * RADIAN_PER_DEGREE / STANDARD_GRAVITY

# lag of a thermometer behind the sensors, s, without a ramp: seconds on the same chip, 80 s for a separate LM335. Assumed.
THERMOMETER_LAG = 60.0

# ---- matrix

# relative scale factor that was not measured: trimmed in the factory (data sheets state 1 to 3 %), and for counts. Assumed.
SCALE_FACTOR = 0.03
SCALE_FACTOR_IN_COUNTS = 0.2

# largest difference from the nominal scale factor in data sheets, relative. Beyond this, a finding asks for the unit.
SCALE_LIMIT = 0.05

# largest zero-g offset in data sheets of consumer parts, m/s2 (MPU-6050: 80 mg). Above this limit, a fit to motion gets a finding.
OFFSET_LIMIT = 0.8

# cross-axis term before a calibration, relative: data sheets of MPU-6050 and ICM-20948 state 2 %, taken as two standard deviations.
CROSS_AXIS = 0.01

# ---- rate tables

# tilt of a device on a rate table before gravity measures it, rad, about each axis across the table axis: loose. Assumed.
TABLE_MOUNTING = 1.0 * RADIAN_PER_DEGREE

# distance of the accelerometers from the axis of a rate table, m: half the plate of a small table. Assumed.
TABLE_ARM = 0.1

# start of a dwell in which the rate of a table settles, s: four time constants of 0.5 s. Assumed. Option: settle_s.
SETTLE_S = 2.0

# ---- optics and other references of orientation

# tilt of a reference's level, rad, about each horizontal axis: cameras are levelled with a frame on the floor. Assumed.
REFERENCE_LEVEL = 2e-3

# ---- limits of a verdict: marginal above the first, bad above the second

# drift of the rest offsets over a session, rad/s: effect of 1 K on a consumer part, half of which is the error of the mean.
# A steady drift of this size is a source of error of gyroscope fits. Fits estimate the excess of a larger drift as a walk.
REST_DRIFT = 0.05 * RADIAN_PER_DEGREE

# drift of the gyroscopes' offset, deg/s: 0.1 within a minute causes an error of 3 deg after this minute, and no warm-up reaches 2.
DRIFT_DPS = (0.1, 2.0)

# standard uncertainty of the scale, per cent: 0.5 is 2 deg in a full turn, and 5 is as poor as in data sheets.
UNCERTAIN_PERCENT = (0.5, 5.0)
