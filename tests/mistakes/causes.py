"""Words that name a cause. A text that only says that something is odd names none."""

_IS = r"(?:[ ,:]+(?:is|are|was|were|has|have|seems?|look|likely|to be|being|columns?|axes|axis|readings?|in|the|both|all))*[ ,:]+"
ACCEL, GYRO = r"acceler\w*", r"gyroscopes?"


def exchanged(triad: str, one: str, other: str) -> tuple[str, ...]:
    """Return what names two exchanged columns, in one clause with their sensor."""
    pair = rf"(?:{one}(?: and |/){other}|{other}(?: and |/){one})"
    return (
        rf"{triad}[^;:,]*?\b{pair}\b[^;:,]*?(?:exchanged|swapped|interchanged)",
        rf"(?:exchange|swap)\w* [^;:,]*{triad}[^;:,]*\b{pair}\b",
    )


def ring(triad: str) -> tuple[str, ...]:
    """Return what names columns that are exchanged in a ring; which triad cannot be seen, so that both may be named."""
    return (
        rf"columns x, y and z[^;]*exchanged in a ring[^;]*{triad}",
        rf"{triad}[^;]*x, y and z[^;]*exchanged in a ring",
    )


def reversed_(triad: str, axis: str) -> tuple[str, ...]:
    """Return what names a column of the wrong sign, in one clause with its sensor; "or accelerometer column z is" does."""
    return (
        rf"{triad} (?:columns? |axis )?{axis} (?:is|has|reads)(?: reversed| negated| the (?:opposite|wrong) sign| ?[;,.(]|$)",
        rf"{triad}[^;:,]*\b{axis}\b[^;:,]*(?:reversed|negated|opposite sign|wrong sign)",
    )


def unit(triad: str, true: str, stated: str) -> tuple[str, ...]:
    """Return what names a unit that is another than stated."""
    return (
        rf"{triad}{_IS}{true},? (?:and )?not {stated}",
        rf"{triad}[^;]*{true}[^;]*(?:taken|read|stated|declared|mapped) (?:for|as) {stated}",
    )


NEGATED = (
    rf"{ACCEL}[^;]*(?:opposite sign|sign is reversed|is negated|has the wrong sign)",
    r"sign of (?:the )?acceleration",
)
DPS_FOR_RAD, RAD_FOR_DPS = unit(GYRO, "deg/s", "rad/s"), unit(GYRO, "rad/s", "(?:deg/s|dps)")
MDPS_FOR_DPS = (*unit(GYRO, "(?:mdps|mdeg/s|millidegrees?[^;]*)", "(?:deg/s|dps)"), rf"{GYRO}[^;]*1000 times too large")
G_FOR_SI, SI_FOR_G = unit(ACCEL, "g", "m/s2"), unit(ACCEL, "m/s2", "g")
MG_FOR_SI, MG_FOR_G = unit(ACCEL, "mg", "m/s2"), unit(ACCEL, "mg", "g")
COUNTS_FOR_DPS = (*unit(GYRO, "(?:counts?|codes?|raw counts)", "(?:deg/s|dps|rad/s)"),)
LEFT_HANDED = (r"left-handed", r"of both (?:triads|sensors)")


def time_in(unit: str) -> tuple[str, ...]:
    """Return what names a wrong unit of time."""
    return (rf"time\w*{_IS}{unit}", rf"{unit}[^;]*(?:taken|read|stated) (?:for|as) s(?:econds)?\b")


MS, US, NS = (time_in(one) for one in ("(?:milliseconds|ms)", "(?:microseconds|us|µs)", "(?:nanoseconds|ns)"))


def rate(true: int, stated: int) -> tuple[str, ...]:
    """Return what names a sample rate that is another than stated."""
    number = rf"{true}(?:\.\d+)?|{true // 10}\d(?:\.\d+)?|{true // 10 - 1}\d(?:\.\d+)?"
    wrong = rf"(?:instead of {stated}|{stated}(?:\.\d+)? (?:were|was|samples|Hz|declared|stated))"
    return (
        rf"(?:{number}) (?:samples a second|Hz)[^;]*{wrong}",
        rf"sample rate[^;]*{stated}[^;]*(?:{number})|sample rate[^;]*(?:{number})[^;]*{stated}",
    )


NO_GRAVITY = (
    r"gravity (?:was |is |has been |seems )?(?:removed|missing|subtracted|left out)",
    r"without gravity|gravity-free|linear acceleration",
)
OTHER_DEVICE = (
    r"not this device's calibration",
    r"(?:another|different) devices?",
    r"which device was recorded",
    r"calibration of another",
)
OTHER_COLUMN = (
    rf"{ACCEL}[^;]*(?:temperature|another quantity|another column|is not an accel|columns? hold|wrong column|mapped)",
)
SWAPPED = (
    rf"(?:{ACCEL} and {GYRO}|{GYRO} and {ACCEL})[^;]*(?:exchanged|swapped)",
    r"columns of the two sensors[^;]*exchanged",
)
ALREADY = (
    r"already corrected|corrected already|corrected twice",
    r"(?:was|is) corrected|corrected (?:recording|before)",
    r"raw readings, got (?:a )?corrected",
)
FAR_TEMP = (r"temperature far from|degC from (?:the )?reference|outside the drift table|calibrated at [\d.]+ degC",)
SATURATED = (r"saturat|stuck at|end of (?:the|its) range|clipped",)
NOT_STILL = (
    r"not at rest|device at rest, got|must be at rest, but|restless|slow turn",
    r"moved (?:in|during|while)|(?:was|is|were) (?:moving|turning)",
    r"turns? (?:in|during|at) (?:the|its|this) (?:rest|still)",
)
REPEATED = (r"(?:rows?|samples?|readings?)[^;]*(?:repeat|twice|duplicat|doubled)|repeated (?:rows|samples|readings)",)
DROPPED = (r"drop-?outs?|(?:rows|samples) (?:are |is )?missing|missing (?:rows|samples)|\bgaps?\b|\bholes?\b",)
BACKWARD = (r"time[^;]*(?:strictly increas|back(?:wards?)?|revers|decreas)",)
FAHRENHEIT = (r"(?:degF|fahrenheit)",)
KELVIN = (r"temperature[^;]*(?:kelvin|\bK\b[^;]*not degC|in K\b)",)
TEMP_COUNTS = (
    r"temperature[^;]*(?:count|code|wrong scale|scale\.temp)",
    r"column '\w+': expected readings up to 300 degc.*check",
)
TURN_ANGLE = (
    r"angles in deg, not rad",
    r"turn[^;]*(?:angle|deg)[^;]*(?:360|stated|wrong)[^;]*(?:not|got|but|by|times)[^;]*",
    r"--turn-deg",
)
SCALE_AS_STATED = (
    r"depends on the given turns only[^;]*wrong angle, rate or sample rate",
)  # A note: any turn may be wrong
TURN_SIGN = (r"sign of the turns?|turns?[^;]*(?:opposite|reversed|wrong sign)|reversed[^;]*turns",)
UPSIDE_DOWN = (
    r"--(?:forward|up)\b[^;]*--(?:forward|up)\b|upside down|pitch[^;]*(?:--up|--forward|wraps|beyond 100)",
    r"use [+-][xyz] for `up`",
)
REFERENCE_UP = (
    r"points up is [+-]?[yz], not",
    r"--reference-up|(?:y|z) (?:of the laboratory )?(?:axis )?points up, not [yz]",
)
CONJUGATE = (
    r"level to body, not body to level",
    r"conjugate|inverse(?:d)? (?:rotation|orientation|quaternion)|(?:laboratory|level) to body|transposed",
)
SCALAR_LAST = (r"scalar[- ](?:last|first)|x-y-z-w|w-x-y-z|order of the quaternion",)
MIRRORED = (r"mirror|left-handed",)
OTHER_TRIAL = (
    r"another (?:trial|recording|motion)|other (?:trial|recording)",
    r"do(?:es)? not (?:belong|match|show the same)|not the same motion|do not correlate",
    r"no common motion",
)
OTHER_BODY = (
    r"another (?:body|segment)|different (?:body|segment)|not (?:rigid|fixed|the same body)",
    r"(?:body|reference)[^;]*moves against|does not follow the device",
)
MILLIMETRES = (r"\bmm\b|millimet|1000 times",)
MISSING_FACE = (r"face[^;]*-z[^;]*missing|-z (?:is |are )?missing|missing[^;]*-z",)
FACE_TWICE = (r"recorded twice|stated twice|same face twice|face[^;]*twice",)
SWAPPED_FACES = (
    r"faces \+x and -x: .*the two are swapped",
    r"faces? \+x and -x[^;]*swapped|swapped[^;]*\+x[^;]*-x|\+x and -x[^;]*(?:exchanged|the two are swapped)",
)
GRAVITY_ASSUMED = (
    r"gravity assumed|gravity (?:was |is )?not stated|standard gravity .{0,60}assum|assum.{0,40}standard gravity",
)
RADIANS_LATITUDE = (r"latitude[^;]*(?:radian|rad\b)",)
TWO_DEVICES = (
    r"(?:several|two|different|more than one) devices?|readings at rest[^;]*apart|serial numbers? differ|devices differ",
)
SHORT_RESTS = (
    r"(?:rests?|pauses?|pose|face)[^;]*(?:too )?short|hold (?:each|them|every)[^;]*\d+ s|expected rests? of [\d.]+ s or more",
)
ONE_TEMPERATURE = (r"one temperature (?:only|alone)|(?:only|alone|at) one temperature|single temperature|degC only",)
SOAK_ORDER = (
    r"set-?points?[^;]*(?:order|differ|belong|swapped|disagree)",
    r"temperature differs from the set-point|order of the (?:soaks|set-points|temperatures)",
)
OTHER_KIND = (r"undrift\.calibration|expected (?:a )?calibration|not a calibration|kind|format",)
CUT_TURN = (r"cut off|still turns at|whole turn|overlaps a stop",)
RATE_UNIT = (
    r"(?:rate|turn)[^;]*57\.3|stated (?:turn )?rates?[^;]*rad/s|rad/s[^;]*stated[^;]*deg/s|turn_rate_dps[^;]*rad/s|deg/s[^;]*rad/s",
)
