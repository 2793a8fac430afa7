"""Mistakes that are not named, or cannot be: route, sound input, what the person did, what becomes of it, and why.

Each other mistake is named. A row whose mistake becomes named, or comes out otherwise, fails its test: mend the row then.
"""

NO_SENSITIVITY = (
    "readings are counts of an unknown sensitivity, turned about the vertical: any angle, rate or time fits; stated for the "
    "record is that the scale comes from the stated turns only, with the range that it means"
)

STEADY_TRUNK = (
    "a trunk that walks turns by a few degrees, and its acceleration has their rhythm: which column is which gravity does not "
    "show; stated for the record are the sides of the device that point forward and up, which a person sees"
)

UNNAMED = {
    ("mount", "mount", "maps the accelerometer columns x and y exchanged"): ("warned", STEADY_TRUNK),
    ("mount", "mount", "maps the gyroscope columns y and z exchanged"): ("warned", STEADY_TRUNK),
    ("mount", "mount", "has a logger that writes acceleration with the opposite sign, as iOS does"): (
        "noted",
        STEADY_TRUNK,
    ),
    ("mount", "mount", "states rad/s of a gyroscope that writes deg/s"): (
        "warned",
        "nothing is found: rates of 57 times the size look like neither posture nor walking",
    ),
    ("mount", "mount", "declares 50 samples a second of a file with 100"): (
        "warned",
        "slow steps are those of a patient; the error is within what is stated",
    ),
    ("correct", "correct_by_table", "records at 4 degC and states degC of a temperature in degF"): (
        "warned",
        "39 degC is a temperature of a device, and 4 degC is outside the table; the offset left at rest speaks against both",
    ),
    ("calibrate", "labelled_turns", "leaves a face out"): (
        "harmless",
        "five faces and the scatter about them give the right result",
    ),
    ("calibrate", "rate_table", "states twice the rates, for a gear of 2"): ("noted", NO_SENSITIVITY),
}
