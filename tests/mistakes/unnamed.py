"""Mistakes that are not named, or cannot be: route, sound input, what the person did, what becomes of it, and why.

Each other mistake is named. A row whose mistake becomes named, or comes out otherwise, fails its test: mend the row then.
"""

NO_SENSITIVITY = (
    "readings are counts of an unknown sensitivity, turned about the vertical: any angle, rate or time fits"
)
ANY_UNIT = "drift reads the unit of the readings off the calibration, and says that the offset differs from it"

UNNAMED = {
    ("correct", "correct", "states deg/s of a gyroscope that writes counts, 16.4 per deg/s"): (
        "refused",
        "the refusal names deg/s for rad/s, which is the nearest unit",
    ),
    ("correct", "correct_by_table", "records at 4 degC and states degC of a temperature in degF"): (
        "warned",
        "39 degC is a temperature of a device; the offset left at rest speaks against the calibration",
    ),
    ("orient", "orient", "states deg/s of a gyroscope that writes mdeg/s"): (
        "refused",
        "the reading beyond any gyroscope's is refused first, and the unit is said to be checked",
    ),
    ("orient", "orient", "maps the temperature as accelerometer z"): (
        "refused",
        "by its size at rest: the unit is asked for",
    ),
    ("orient", "orient", "turns slowly in the rest at the start"): (
        "warned",
        "a turn about the vertical at a steady rate is an offset to gyroscopes; the drift to expect is stated",
    ),
    ("orient", "orient", "names a stretch of motion as the rest"): (
        "warned",
        "the drift to expect is stated, 1,700 deg",
    ),
    ("validate", "validate", "writes the reference's quaternions as x-y-z-w"): (
        "refused",
        "of this motion the inverse explains the poses as well",
    ),
    ("validate", "validate", "gives the reference of another body segment"): (
        "warned",
        "by the share of the rates that no mounting explains",
    ),
    ("validate", "validate_fit", "has a logger that writes acceleration with the opposite sign, as iOS does"): (
        "refused",
        "with a fit from the same recordings, two reversed gyroscope axes explain the poses as well",
    ),
    ("calibrate", "free_poses", "states rad/s of a gyroscope that writes deg/s"): (
        "refused",
        "noise 57 times as large leaves no rest to look at",
    ),
    ("calibrate", "free_poses", "declares 50 samples a second of a file with 100"): (
        "refused",
        "by the scale factor of 2; a range set to half is the same",
    ),
    ("calibrate", "free_poses", "maps the temperature as accelerometer z"): (
        "refused",
        "by its size at rest: the unit is asked for",
    ),
    ("calibrate", "free_poses", "calibrates from the recordings of two devices"): (
        "refused",
        "by the mean rate at rest, said to be a slow turn",
    ),
    ("calibrate", "turns_by_hand", "states the latitude in radians"): (
        "silent",
        "0.9 deg is a latitude too: 0.4 % of gravity",
    ),
    ("calibrate", "labelled_turns", "states 180 deg of full turns"): ("silent", NO_SENSITIVITY),
    ("calibrate", "labelled_turns", "tips a face while it rests"): (
        "warned",
        "by the tilt of the faces, whatever made it",
    ),
    ("calibrate", "turns_by_hand", "declares 50 samples a second of a file with 100"): ("silent", NO_SENSITIVITY),
    ("calibrate", "turns_by_hand", "ends the recording within a turn"): ("warned", "the turn that is missing is named"),
    ("calibrate", "labelled_turns", "lays the same face twice"): (
        "warned",
        "by the sensor's axis, 90 deg off that of the case",
    ),
    ("calibrate", "rate_table", "states twice the rates, for a gear of 2"): ("silent", NO_SENSITIVITY),
    ("calibrate", "rate_table", "has exchanged accelerometer columns x and y"): (
        "refused",
        "a left-handed triad: an exchange or one reversed axis",
    ),
    ("calibrate", "rate_table", "has negated acceleration"): ("refused", "by the faces, which are then all swapped"),
    ("drift", "soaks", "takes two devices for one"): (
        "silent",
        "offsets of either lie within what a switch-on or a temperature shifts; no serial numbers are stated",
    ),
    ("drift", "soaks", "states degC of a temperature in degF"): ("warned", "as too hot but for a chamber"),
    ("drift", "soaks", "states degC of a temperature in K"): (
        "refused",
        "by the largest temperature that a file may hold",
    ),
    ("drift", "stated_soaks", "exchanges two set-points"): (
        "silent",
        "no thermometer was recorded, and a table may bend",
    ),
    ("drift", "soaks", "states rad/s of a gyroscope that writes deg/s"): ("warned", ANY_UNIT),
    ("drift", "soaks", "states deg/s of a gyroscope that writes rad/s"): ("warned", ANY_UNIT),
    ("drift", "ramp", "records one temperature alone"): (
        "warned",
        "by the uncertainty that lag and hysteresis are left out of",
    ),
    ("drift", "soaks", "turns the device slowly in a soak"): (
        "silent",
        "a turn at 0.2 deg/s about the vertical is an offset to gyroscopes, and unseen by accelerometers",
    ),
    ("info", "described", "states m/s2 of an accelerometer that writes g"): (
        "warned",
        "by its factor, 9.96 times too small",
    ),
    ("python calibrate", "calibrate", "declares 50 samples a second of a file with 100"): (
        "refused",
        "by the scale factor of 2; a range set to half is the same",
    ),
}
