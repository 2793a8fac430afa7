"""Findings: what a fit noticed, as a code with numbers; this file alone turns a code into sentences.

A fit returns ``finding("rate_table.mounting", "warn", angle_deg=0.3)``. Its text has three parts: a headline, one line of detail,
and one action. A verdict shows the most consequential findings first: by level (fail, warn, info), then by the rank of the code::

    1  numbers may be wrong          2  uncertainty is larger, or not complete
    3  something was not observable  4  what was done, for the record

Templates are ``str.format`` strings over the finding's values; a tuple prints element by element: (0.1, 0.2) as "0.1, 0.2".
"""

import string
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

Level = Literal["info", "warn", "fail"]
Value = float | int | str | bool | tuple[float, ...] | tuple[str, ...]

SHOWN_FIRST = 3  # findings that a person sees without asking for details
_LEVELS = ("fail", "warn", "info")


class Entry(NamedTuple):
    """The sentences of one code."""

    rank: int  # 1 to 4, see the module
    headline: str
    detail: str = ""
    action: str = ""


class _Template(string.Formatter):
    """``str.format`` that prints tuples element by element."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, tuple):
            return ", ".join(self.format_field(item, format_spec) for item in value)
        return str(super().format_field(value, "" if isinstance(value, str) else format_spec))


_TEMPLATE = _Template()


@dataclass(frozen=True, slots=True)
class Finding:
    """What a fit noticed: a code, how much it matters, and its numbers.

    Parameters
    ----------
    code : str
        Stage and matter, "six_face.tilt".
    level : str
        info, warn or fail.
    values : mapping
        Numbers and names that the sentences need; the unit stands in the key ("tilt_deg") unless SI.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("six_face", device, rng=rng))
    >>> finding = calibration.verdict.findings[0]
    >>> finding.code, finding.level, finding.headline
    ('gyro.offset_in_counts', 'warn', 'Gyroscope offset not kept: no scale')
    """

    code: str
    level: Level
    values: Mapping[str, Value] = field(default_factory=dict)

    @property
    def headline(self) -> str:
        """What it is, in a few words."""
        return self._filled(CATALOGUE[self.code].headline)

    @property
    def detail(self) -> str:
        """One line with the numbers; may be empty."""
        return self._filled(CATALOGUE[self.code].detail)

    @property
    def action(self) -> str:
        """What to do about it; may be empty."""
        return self._filled(CATALOGUE[self.code].action)

    @property
    def text(self) -> str:
        """Headline, detail and action in one line."""
        head = ": ".join(part for part in (self.headline, self.detail) if part)
        return "; ".join(part for part in (head, self.action) if part)

    def _filled(self, template: str) -> str:
        return _TEMPLATE.vformat(template, (), self.values)


def finding(code: str, level: Level, /, **values: Any) -> Finding:
    """Return a finding; arrays become tuples, numpy scalars become numbers."""
    return Finding(code, level, {name: _plain(value) for name, value in values.items()})


def _plain(value: Any) -> Value:
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(_plain(item) for item in value) if isinstance(value, list | tuple) else value  # type: ignore[return-value]


def most_consequential_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings by level and rank, each text once."""
    once = {item.text: item for item in findings}.values()
    return tuple(sorted(once, key=lambda item: (_LEVELS.index(item.level), CATALOGUE[item.code].rank)))


CATALOGUE: dict[str, Entry] = {
    # ---- any file written before findings had codes
    "earlier.text": Entry(4, "{text}"),
    # ---- calibration: session, stills, temperature
    "session.temperatures": Entry(
        3,
        "Several temperatures in one session",
        "{groups} from {least_temp_c:.1f} to {most_temp_c:.1f} degC; the {pieces} stills and turns at {temp_c:.1f} degC were used",
        "make tables of all with undrift drift",
    ),
    "session.one_temperature": Entry(
        3,
        "Calibrated at one temperature",
        "offset and scale hold near {temp_c:.1f} degC",
        "for others, record a thermal session and run undrift drift",
    ),
    "session.unknown_temperature": Entry(
        3,
        "Calibrated at one unknown temperature",
        "no temperature was recorded",
        "for others, record a thermal session and run undrift drift",
    ),
    "session.no_still": Entry(3, "No rest found in recording {recording}", "{reason}"),
    "session.short_pauses": Entry(
        3,
        "Pauses too short in recording {recording}",
        "{pauses} pauses were shorter than the {least_s:g} s that a pose must last",
        "hold each for 3 s or more",
    ),
    "session.too_few_poses": Entry(
        3,
        "Accelerometer not observable",
        "wanted rests on six faces or {wanted} free poses, got {rests}; faces without a rest: {missing}",
        "record them",
    ),
    "session.fit_failed": Entry(3, "Full fit not possible: {triad}", "{reason}"),
    "still.sway": Entry(
        1,
        "{still} not at rest ({stills} above the limit)",
        "readings that sway by up to {sway:.3g} {unit} rms",
        "shorten it to the part at rest, or leave it out",
    ),
    "still.tilt": Entry(
        1,
        "{still} not at rest ({stills} above the limit)",
        "a tilt of {tilt_deg:.2f} deg from its first to its last third",
        "shorten it to the part at rest, or leave it out",
    ),
    "still.rate": Entry(
        1,
        "{still} not at rest ({stills} above the limit)",
        "a mean rate {rate:.3g} {unit} off that of the other stills",
        "check for a slow turn, another unit, or offset drift; warm the device up before recording",
    ),
    "paper_mode.offset_left": Entry(
        1,
        "Mode paper: offset left in the readings",
        "offset ({offset:.4g}) {unit}; the gain along it is {loss_percent:.2g} % too small",
        "remove the offset first, or use mode affine",
    ),
    "paper_mode.offset_removed": Entry(
        4, "Mode paper: offset removed before the fit", "it is the mean of opposite inputs or of the rests"
    ),
    "paper_mode.not_used": Entry(
        3, "Mode {mode} not used for the {triad}", "{method} has no such mode", "for it, record {needs}"
    ),
    # ---- calibration: six faces
    "six_face.fixture": Entry(
        3,
        "Sensor misalignment not separated from the fixture",
        "the axes are those of the faces, and a case out of square counts as misaligned sensors",
        "record nine or more free poses to measure the angles between the sensors",
    ),
    "six_face.face_missing": Entry(
        2, "Face {face} is missing", "its axis relies on the offset of the others", "record it"
    ),
    "six_face.short_faces": Entry(
        2,
        "Mode affine used in place of levelled",
        "the faces are too short to estimate the noise of their means",
        "rest 6 s",
    ),
    "six_face.tilt_large": Entry(
        2,
        "Faces tilted by {tilt_deg:.2f} deg (1 sigma)",
        "six faces do not separate tilt from misaligned sensors; the uncertainty of the cross-axis terms includes it",
        "align the fixture, or rest in nine or more free poses",
    ),
    "six_face.tilt_small": Entry(
        4,
        "Faces level within {tilt_deg:.1g} deg (1 sigma)",
        "the uncertainty of the cross-axis terms includes it",
    ),
    "six_face.tilt_left_out": Entry(
        2,
        "Mode paper assumes level faces",
        "they are tilted by {tilt_deg:.2g} deg (1 sigma); the uncertainty excludes that, about {gain_share:.2g} of the gain",
        "use mode levelled",
    ),
    "six_face.scatter": Entry(
        2,
        "Residuals {ratio:.1f} times the noise of the means",
        "the faces were not level, and the uncertainty excludes that",
        "use mode levelled",
    ),
    # ---- calibration: rate table
    "gyro.not_observable": Entry(3, "Gyroscope not observable", "", "record turns by known rates or angles"),
    "gyro.offset_alone": Entry(
        3,
        "Gyroscope: offset alone",
        "the scale is the unit's own and was not checked",
        "record turns by known rates or angles",
    ),
    "gyro.offset_in_counts": Entry(
        3,
        "Gyroscope offset not kept: no scale",
        "at rest it reads ({offset:.5g}) {unit} within {uncertainty:.2g}",
        "give the scale of the columns, or record turns",
    ),
    "gyro.scale_factor": Entry(
        1,
        "Implausible scale factor of gyroscope {axis}",
        "it is {off_percent:+.1f} % off the unit's own scale",
        "check the conversion from counts, the range setting, the stated rates or angles and the sample rate",
    ),
    "rate_table.axes_missing": Entry(
        3,
        "Rate table: no turns about {missing}",
        "turns about {turned} alone do not show the scale factors and cross-axis terms of the others",
        "mount the device with each axis along the table's axis in turn",
    ),
    "rate_table.axis": Entry(
        4,
        "Turns about {axis}: scale factor {scale:.5g} {unit}",
        "uncertain by {uncertainty_percent:.2g} %; nonlinearity {nonlinearity_dps:.2g} deg/s ({nonlinearity_percent:.2g} %), "
        "asymmetry {asymmetry_percent:.2g} %",
    ),
    "rate_table.rates_not_stated": Entry(
        3, "{turns} steady turns without a rate", "", "state the turn_rate_dps and axis of each to use them"
    ),
    "rate_table.no_accel": Entry(
        3,
        "g-sensitivity of the gyroscopes not observable",
        "the session has no accelerometer rests on six faces",
        "record them in the same session",
    ),
    "rate_table.g_sensitivity": Entry(
        4,
        "g-sensitivity up to {dps_per_g:.2g} (deg/s)/g",
        "fitted from dwells and rests; corrected by the specific force",
    ),
    "rate_table.drift": Entry(
        2,
        "Offset drift in the session: {dps_per_minute:.2g} deg/s per minute",
        "random walk, 1 sigma; wanted {wanted:g}; the offset holds for the middle of the session",
        "warm the device up before, and rest before and after the dwells",
    ),
    "rate_table.axis_offset": Entry(
        2,
        "Offset differs by {offset_dps:.2g} deg/s between table axes",
        "wanted {wanted:g}; it hardly changes with time, which points to g-sensitivity; the offset is a mean over the poses",
        "rest on six faces in the same session to fit the g-sensitivity",
    ),
    "rate_table.scatter": Entry(
        2,
        "Residuals {ratio:.1f} times the noise",
        "{residual_percent:.2g} % of the largest rate (wanted {wanted:g} %); the uncertainty is widened by that",
        "check for vibration, nonlinearity, or a table that turns unevenly",
    ),
    "rate_table.uncertainty": Entry(
        2,
        "Gyroscope matrix uncertain by {uncertainty_percent:.2g} %",
        "largest element, 1 sigma; wanted {wanted:g} %",
        "turn at more rates, dwell longer, and check the residual of each dwell",
    ),
    # ---- calibration: known rotation
    "known_rotation.needs_accel": Entry(
        3,
        "Turns by known angles need an accelerometer",
        "its readings at rest on six faces give the g-sensitivity",
        "map the accel columns, or turn at known rates",
    ),
    "known_rotation.needs_faces": Entry(3, "Turns by known angles need all six faces", "", "rest on each face"),
    "known_rotation.needs_turns": Entry(
        3,
        "No turns by known angles",
        "wanted one about each axis, got none",
        "turn the device once about x, y and z between two rests and state angle_deg",
    ),
    "known_rotation.turns_found": Entry(
        2, "Three full turns found", "used as {turns}", "state angle_deg to confirm them"
    ),
    "known_rotation.no_spare_equations": Entry(
        2, "Turn angles not checked", "each turn is one equation for its column of the matrix; none is spare"
    ),
    "known_rotation.angles_exact": Entry(
        2,
        "Turn angles assumed exact",
        "1 deg of 360 deg is 0.28 % of scale; the uncertainty excludes it",
        "give angle_uncertainty",
    ),
    "known_rotation.other_rates": Entry(
        3,
        "Scale at other rates not observable",
        "turns by known angles give one scale for all rates",
        "use a rate table",
    ),
    # ---- calibration: multi-position
    "multi_position.mounting": Entry(
        3,
        "Sensor mounting in the case not observable",
        "free poses show lengths alone; the axes are the accelerometer's own",
        "rest on six faces of the case",
    ),
    "multi_position.g_sensitivity": Entry(
        3,
        "g-sensitivity of the gyroscopes not observable",
        "moves between poses do not show it; assumed zero",
        "rest on six faces and turn by known angles about x, y and z, or use a rate table",
    ),
    "multi_position.residual": Entry(
        1,
        "Poses miss gravity by {rms_mg:.2g} mg rms",
        "wanted {wanted:g} mg; the device moved in some of them, or the sensor is not linear",
        "repeat the poses that moved",
    ),
    "multi_position.uncertainty": Entry(
        2,
        "Corrected gravity uncertain by {uncertainty_mg:.2g} mg",
        "wanted {wanted:g} mg",
        "record more poses, held longer",
    ),
    "multi_position.cross_axis_fixed": Entry(4, "Cross-axis terms fixed at zero", "they were not fitted"),
    "multi_position.scale_alone": Entry(
        3, "Accelerometer: scale and offset alone", "cross-axis terms were not observable and are zero"
    ),
    "multi_position.moves_miss": Entry(
        1,
        "Moves miss gravity by {rms_deg:.2g} deg rms",
        "wanted {wanted:g} deg",
        "turn more slowly, rest longer between turns",
    ),
    "multi_position.gyro_uncertainty": Entry(
        2,
        "Gyroscope matrix uncertain by {uncertainty_percent:.2g} %",
        "largest element, 1 sigma; wanted {wanted:g} %",
        "make more and larger turns",
    ),
    "multi_position.gyro_drift": Entry(
        2,
        "Offset drift of {drift_dps:.2g} deg/s in the session",
        "wanted {wanted:g}; followed from still to still, its mean is kept, and the uncertainty includes the drift",
        "warm the device up before",
    ),
    # ---- calibration: reference
    "reference.uncertainty": Entry(
        2,
        "Gyroscope matrix uncertain by {uncertainty_percent:.2g} %",
        "largest element, 1 sigma; wanted 0.2 %",
        "record longer, with more turning about every axis",
    ),
    "reference.rest_offset": Entry(
        2,
        "Rest offset differs by {spread_dps:.3f} deg/s between recordings",
        "standard deviation; wanted 0.03",
        "warm the device up before each",
    ),
    "reference.g_sensitivity": Entry(4, "g-sensitivity not significant", "", "leave it out"),
    # ---- calibration: noise and ADC
    "noise.not_observable": Entry(
        3, "{triad} {axes}: {term} not observable", "record of {duration_s:.0f} s", "record longer at rest"
    ),
    "noise.no_quantization": Entry(3, "not observable", "no part of the curve falls with the averaging time itself"),
    "noise.no_random_walk": Entry(
        3, "not observable", "no part of the curve falls with the square root of the averaging time"
    ),
    "noise.no_flat_part": Entry(3, "not observable", "no flat part of the curve stands out", "record longer"),
    "noise.no_rise": Entry(
        3, "not observable", "no certain rise of the curve up to {longest_s:.3g} s", "record longer"
    ),
    "noise.model_error": Entry(
        1,
        "{triad}: Allan curve departs from the model",
        "by {error_percent:.0f} % of the variance; the readings are filtered or disturbed",
        "record raw readings on a bench without vibration",
    ),
    # ---- converters
    "adc.no_grid": Entry(
        3,
        "ADC not identified",
        "the readings lie on no grid: they were filtered, resampled or calibrated before they were written",
    ),
    "adc.offset_subtracted": Entry(
        3, "ADC not identified", "an offset was subtracted from the codes", "record the raw device in brisk motion"
    ),
    "adc.few_axes": Entry(
        3, "ADC not identified", "fewer than two axes sweep through code 0", "record the raw device in brisk motion"
    ),
    "adc.few_samples": Entry(
        3, "ADC not identified", "too few samples sweep through code 0", "record the raw device in brisk motion"
    ),
    "adc.toward_zero": Entry(
        4,
        "Codes truncated toward zero",
        "code 0 occurs {ratio:.2f} +- {uncertainty:.2f} times as often as others near it",
    ),
    "adc.nearest": Entry(
        4,
        "Codes rounded to nearest or floor, half a step that the offset takes up",
        "code 0 occurs {ratio:.2f} +- {uncertainty:.2f} times as often as others near it",
    ),
    "adc.uncertain": Entry(
        3, "ADC not identified", "code 0 occurs {ratio:.2f} +- {uncertainty:.2f} times as often as others near it"
    ),
    # ---- drift: sessions and temperature
    "calibration.nominal": Entry(
        3,
        "No calibration given",
        "scale and axes of the gyroscopes are nominal; rests do not show them",
        "calibrate with turns at known rates or angles",
    ),
    "drift.set_points_only": Entry(
        1,
        "No temperature column",
        "tables are over the chamber's set-points; the device's own thermometer has an offset and self-heating",
        "map the temperature column, also in recordings to correct",
    ),
    "drift.temperature_set_points": Entry(
        2,
        "Recording {recording}: temperature from stated set-points",
        "the chamber's set-points in {pieces} pieces; the sensors reach them only once settled",
        "map the temperature column",
    ),
    "drift.temperature_spikes": Entry(
        4,
        "Recording {recording}: {count} temperature spikes left out",
        "the first at {first_s:.6g} s, up to {largest_c:.3g} K",
    ),
    "drift.temperature_stale": Entry(
        4,
        "Recording {recording}: stale temperature left out",
        "{temp_c:.2f} degC for {duration_s:.0f} s from {start_s:.6g} s, then a jump of {jump_c:.2f} K ({count} such)",
        "check the thermometer",
    ),
    "drift.temperature_steps": Entry(
        4, "Recording {recording}: coarse temperature steps", "{step_c:g} K, smoothed over time"
    ),
    "drift.temperature_jumps": Entry(
        1,
        "Recording {recording}: the temperature jumps",
        "by up to {largest_c:.2f} K, faster than a board changes, first at {first_s:.6g} s ({count} such)",
        "check the thermometer",
    ),
    "drift.temperature_hot": Entry(
        1,
        "Recording {recording}: implausible unless in a chamber",
        "{low_c:.1f} to {high_c:.1f} degC throughout: self-heating of a chip, or a wrong scale",
        "check units.temp and scale.temp",
    ),
    "drift.temperature_off_set_point": Entry(
        1,
        "Recording {recording}: temperature differs from the set-point",
        "the column reads {read_c:.1f} degC at {set_point_c:.1f} degC ({count} of {pieces} pieces over {limit_c:g} K apart)",
        "check units.temp and scale.temp",
    ),
    "drift.temperature_gaps": Entry(
        4,
        "Recording {recording}: {missing} temperature readings missing",
        "{interpolated} interpolated in gaps of up to {longest_s:g} s, {left_out} left out",
    ),
    "drift.lag_subtracted": Entry(4, "Thermometer lag subtracted", "{lag_s:.3g} +- {uncertainty_s:.2g} s"),
    "drift.lag_few_blocks": Entry(
        3,
        "Thermometer lag not observable",
        "{count} blocks of rest change by over {least_c_per_min:g} degC/min; wanted {wanted}",
        "record ramps up and down at two speeds, for example 0.5 and 3 degC/min",
    ),
    "drift.lag_one_way": Entry(
        3,
        "Thermometer lag not observable",
        "each temperature was passed at one speed only: temperature explains {percent:.0f} % of the slopes",
        "also cool through the same temperatures",
    ),
    "drift.lag_unbounded": Entry(
        3,
        "Thermometer lag not observable",
        "any lag up to {longest_s:g} s fits",
        "record ramps up and down at two speeds, for example 0.5 and 3 degC/min",
    ),
    "drift.lag_or_hysteresis": Entry(
        3,
        "Thermometer lag and hysteresis not separable",
        "ramps at one speed only: a lag of {lag_s:.3g} s explains the same loop",
        "record a second ramp, three times as fast or slow",
    ),
    # ---- drift: offsets over temperature
    "drift.g_unknown": Entry(
        3,
        "g-sensitivity not estimated; assumed zero",
        "gyroscope offsets include it for the recorded pose",
        "calibrate it with turns at known rates or angles",
    ),
    "drift.g_sensitivity": Entry(
        4,
        "g-sensitivity estimated",
        "up to {largest_dps_per_g:.2g} (deg/s)/g from rests in {poses} poses; now part of the calibration",
    ),
    "drift.poses_g": Entry(
        2,
        "Gyroscope offset depends on the pose (g-sensitivity)",
        "{deviation:.2g} {unit} on x, y, z between {poses} poses (standard deviation); noise explains {known:.2g}",
        "rest on all six faces at one set-point or more",
    ),
    "drift.poses_g_no_accel": Entry(
        2,
        "Gyroscope offset depends on the pose (g-sensitivity)",
        "{deviation:.2g} {unit} on x, y, z between {poses} poses (standard deviation); noise explains {known:.2g}",
        "calibrate the accelerometers on six faces",
    ),
    "drift.poses_disagree": Entry(
        2,
        "Gyroscope offset depends on the pose",
        "{deviation:.2g} {unit} on x, y, z between {poses} poses with g-sensitivity subtracted; noise explains {known:.2g}",
        "visit each pose several times at each set-point",
    ),
    "drift.rests_disagree": Entry(
        2,
        "Rests at one set-point disagree",
        "{deviation:.2g} {unit} on x, y, z over {rests} rests (standard deviation); noise explains {known:.2g}; "
        "hysteresis or warm-up are likely",
        "record more rests at each set-point",
    ),
    "drift.few_set_points": Entry(
        2,
        "{count} set-points cannot exclude higher-order curvature",
        "{set_points_c:.1f} degC; standard uncertainty {at:.2g} {unit} at them, up to {between:.2g} {unit} between",
        "soak at {also_c:.0f} degC as well",
    ),
    "drift.nodes_extrapolated": Entry(
        2,
        "{sensor}: {count} of {nodes} nodes extrapolated",
        "no data near them; seen {low_c:.1f} to {high_c:.1f} degC",
        "record at the other temperatures",
    ),
    "drift.hysteresis": Entry(
        2,
        "{sensor}: hysteresis counts as uncertainty",
        "half-width {half_width:.3g} +- {uncertainty:.2g} raw units on x, y, z; the table is the mean of warming and cooling",
    ),
    "drift.no_hysteresis": Entry(
        4,
        "{sensor}: no significant hysteresis",
        "half-width {half_width:.3g} +- {uncertainty:.2g} raw units on x, y, z",
    ),
    "drift.hysteresis_no_sweep": Entry(
        2,
        "Hysteresis unknown",
        "each session rested at one or two temperatures; its half-width is not in the uncertainty",
        "record a warming and a cooling ramp",
    ),
    "drift.hysteresis_no_overlap": Entry(
        2,
        "Hysteresis unknown",
        "warming and cooling share no {overlap_c:g} degC; its half-width is not in the uncertainty",
        "record both ramps over the same temperatures",
    ),
    "drift.hysteresis_one_way": Entry(
        2,
        "Hysteresis unknown",
        "the temperature went one way only; the half-width is not in the uncertainty",
        "also record a cooling ramp, or a warming one after cooling",
    ),
    "drift.lag_and_hysteresis_excluded": Entry(
        2,
        "Uncertainty excludes thermometer lag and hysteresis",
        "{shift:.2g} {unit} on x, y, z per {lag_s:g} s of lag at {ramp_c_per_min:.2g} degC/min",
        "also record a cooling ramp",
    ),
    "drift.power_on_transient": Entry(
        1,
        "The table may include the power-on transient",
        "",
        "hold one temperature for 30 min after power-on, or warm up from two, with --warm-up",
    ),
    "drift.warm_up_not_observable": Entry(
        3,
        "Warm-up not observable",
        "temperature explains {percent:.1f} % of the transient since power-on",
        "hold one temperature for 30 min after power-on, or warm up from two temperatures",
    ),
    "drift.one_session": Entry(
        3, "Turn-on bias repeatability unknown", "one session only", "record one session more on another day"
    ),
    "drift.sessions_apart": Entry(
        3,
        "Turn-on bias repeatability not observable",
        "none of {sessions} sessions share a temperature; it is not in the uncertainty",
        "record them over shared temperatures",
    ),
    "drift.turn_on_bound": Entry(
        4,
        "No shift between sessions on {axes}",
        "the stated turn-on repeatability is an upper bound from {sessions} sessions",
        "record more sessions",
    ),
    "drift.offset_differs": Entry(
        1,
        "Offset differs from the calibration",
        "{offset_dps:+.3g} deg/s (+- {uncertainty_dps:.2g}) on x, y, z at {temp_c:.1f} degC; a switch-on shifts it by "
        "{turn_on_dps:g} deg/s at most",
        "check which device was recorded, or calibrate again",
    ),
    "drift.offset_unclear": Entry(
        2,
        "Offset differs from the calibration, within uncertainty",
        "{offset_dps:+.3g} deg/s (+- {uncertainty_dps:.2g}) on x, y, z at {temp_c:.1f} degC, below {least_uncertainties:g} "
        "standard uncertainties",
        "rest longer, at more temperatures or nearer the calibration's",
    ),
    # ---- drift: scale and dynamic drift
    "drift.no_gyroscopes": Entry(
        3, "Scale and dynamic drift not observable", "no gyroscopes in calibration or sessions"
    ),
    "drift.no_turns": Entry(
        3,
        "Gyroscope scale over temperature not observable from rests",
        "",
        "turn the device at known rates at two temperatures",
    ),
    "drift.tables_not_observable": Entry(3, "Scale and dynamic drift not observable", "{problem}"),
    "drift.tables_best": Entry(
        4,
        "Tables selected: {tables}",
        "cross-validated error {error_dps:.4f} deg/s rms ({held_out} of {soaks} soaks at {set_points} set-points, and rates, "
        "held out)",
    ),
    "drift.tables_simplest": Entry(
        4,
        "Tables selected: {tables}",
        "cross-validated error {error_dps:.4f} deg/s rms ({held_out} of {soaks} soaks at {set_points} set-points, and rates, "
        "held out); within one standard error or 5 % of {best} ({best_dps:.4f} deg/s)",
    ),
    "drift.tables_requested": Entry(4, "Tables requested: {tables}", "cross-validation selects {automatic}"),
    "drift.tables_by_rates": Entry(
        2,
        "Tables selected by held-out rates alone",
        "soaks at {set_points} set-points: none between others",
        "add a soak at a third set-point",
    ),
    "drift.steps_left_out": Entry(3, "{count} of {steps} rate steps left out", "gaps in rate, reading or temperature"),
    "drift.scale": Entry(
        4, "Scale factor {axis} over temperature", "{percent_per_k:+.4f} +- {expanded_percent_per_k:.2g} %/K (95 %)"
    ),
    "drift.scale_not_observable": Entry(
        3,
        "Scale factor {axis} over temperature not observable",
        "turned about {axis} at {soaks} soaks; the calibration's constant column is used",
        "turn about {axis} at three temperatures or more",
    ),
    "drift.scale_two_temperatures": Entry(
        2,
        "Scale factor {axes}: curvature not observable",
        "two temperatures determine a line",
        "add a soak between them",
    ),
    "drift.scale_differs": Entry(
        1,
        "Scale factors differ from the calibration",
        "turns: {percent:.3g} % on x, y, z at the reference temperature (wanted {limit_percent:g} %)",
        "check turn_rate_dps, the range setting and the device",
    ),
    "drift.asymmetry": Entry(4, "Scale factor asymmetry {axis}", "{percent:+.3f} +- {expanded_percent:.2g} % (95 %)"),
    "drift.asymmetry_not_observable": Entry(
        3, "Scale factor asymmetry {axes} not observable", "", "turn both ways at two rates each"
    ),
    "drift.dynamic_not_observable": Entry(
        3,
        "Dynamic drift {axis} not observable",
        "not turned at two rates and two temperatures; its table holds zeros",
        "turn about {axis} both ways at three soaks or more",
    ),
    "drift.dynamic_one_way": Entry(
        2,
        "Dynamic drift {axis}: turned only about {way}",
        "the other sign is extrapolated; an offset is not separable",
        "turn about {other} as well",
    ),
    "drift.dynamic_two_temperatures": Entry(
        2, "Dynamic drift {axes}: curvature not observable", "two temperatures determine a line", "add a soak"
    ),
    # ---- drift: accelerometers
    "drift.accel_no_readings": Entry(
        3, "Accelerometer offset over temperature not observable", "no readings", "map the accel columns"
    ),
    "drift.accel_not_observable": Entry(3, "Accelerometer offset over temperature not observable", "{problem}"),
    "drift.accel_gravity": Entry(1, "Accelerometer offset over temperature left out", "{problem}"),
    "drift.accel_uncalibrated": Entry(
        3,
        "Accelerometer offset unknown",
        "no calibration in physical units; only the change over temperature is known",
        "calibrate six faces",
    ),
    "drift.accel_no_reference": Entry(
        3,
        "Accelerometer offset unknown",
        "the calibration has no reference temperature; only the change over temperature is known",
        "calibrate with a temperature column",
    ),
    "drift.accel_one_pose": Entry(
        2,
        "Accelerometer offset over temperature from one pose",
        "one of {poses} poses, over {span_c:.1f} degC; scale not separable: {percent_per_c:g} % per degC of gravity counts as "
        "uncertainty",
        "rest on all six faces at three temperatures",
    ),
    "drift.accel_matrix_differs": Entry(
        1,
        "Accelerometer matrix differs from the calibration",
        "{percent:.3g} % on x, y, z at {temp_c:.1f} degC; {largest_percent:+.3g} +- {uncertainty_percent:.2g} % in {element} "
        "(wanted {limit_percent:g} %)",
        "check the range setting and the device, or calibrate again",
    ),
    "drift.accel_offset_differs": Entry(
        1,
        "Accelerometer offset differs from the calibration",
        "{offset_mg:+.3g} mg (+- {uncertainty_mg:.2g}) on x, y, z at {temp_c:.1f} degC (wanted {limit_mg:g} mg)",
        "check which device was recorded, or calibrate again",
    ),
    "drift.accel_left_out": Entry(
        3, "{count} of {blocks} blocks of rest left out", "gaps in accelerometer or temperature"
    ),
    "drift.accel_scale": Entry(
        4,
        "Accelerometer sensitivity {axis} over temperature",
        "{percent_per_k:+.4f} +- {expanded_percent_per_k:.2g} %/K (95 %)",
    ),
    "drift.accel_two_temperatures": Entry(
        2, "Accelerometers: curvature not observable", "two temperatures determine a line", "add a third temperature"
    ),
    "drift.accel_faces_only": Entry(
        3,
        "Accelerometer cross-axis terms held at the calibration's",
        "the poses show offset and sensitivity only",
        "add poses on edges and corners at each temperature",
    ),
    "drift.accel_joint": Entry(
        2,
        "Accelerometers: all poses fitted together",
        "no two temperatures have six poses each; {parameters} parameters, linear in temperature",
        "rest on all six faces at three temperatures",
    ),
    "drift.accel_misses_gravity": Entry(
        1,
        "Poses miss gravity by {rms_mg:.2g} mg rms",
        "wanted {limit_mg:g} mg; the device moved, or is not linear in temperature",
        "repeat the poses at rest",
    ),
    # ---- correction
    "correct.no_temperature": Entry(
        1,
        "{seconds:.1f} s without a temperature",
        "the drift table cannot be evaluated there; the result is a gap (NaN) under every policy",
        "fill in the temperature",
    ),
    "correct.outside": Entry(
        1,
        "{seconds:.1f} s outside the drift table",
        "{low_c:.1f} to {high_c:.1f} degC were recorded (thermometer lag subtracted: {lag_s:g} s)",
        "extend the table by a thermal session at these temperatures",
    ),
    "correct.extrapolated": Entry(
        2,
        "{seconds:.1f} s where the drift table is extrapolated",
        "standard uncertainty there up to {uncertainty}",
        "extend the thermal session to these temperatures and rates",
    ),
    "correct.extrapolated_unstated": Entry(
        2,
        "{seconds:.1f} s where the drift table is extrapolated",
        "the table states no uncertainty there",
        "extend the thermal session to these temperatures and rates",
    ),
    "correct.departure": Entry(
        1,
        "Temperature far from the reference temperature",
        "by up to {departure_c:.1f} degC from {reference_c:.1f} degC; constant offsets hold within {span_c:g} degC",
        "fit a drift table (undrift drift)",
    ),
    "correct.turn_rate": Entry(
        1,
        "Turn rate outside the dynamic drift table",
        "{least_dps:.1f} to {greatest_dps:.1f} deg/s; the table ends at {first_dps:.1f} and {last_dps:.1f} deg/s and is held there",
        "extend the table by turns at these rates",
    ),
    "correct.beyond_range": Entry(
        1,
        "{sensor}: {percent:.3g} % of samples exceed the calibrated range",
        "by more than a tenth: range {low:.3g} to {high:.3g} {unit}, worst {worst:.4g} {unit}; the model is extrapolated",
        "calibrate over a wider range",
    ),
    "correct.no_model": Entry(
        3, "{sensor}: the calibration has no model", "nominal values were passed on", "calibrate the {sensor} as well"
    ),
    "correct.no_sensor": Entry(
        1, "No {sensor} in the recording", "the calibration has one", "check the names of the columns"
    ),
    "correct.gravity": Entry(
        1, "Specific force far from 1 g", "median {median_g:.3g} g after correction", "check the unit and the device"
    ),
    "correct.device": Entry(
        1,
        "Recording and calibration name different devices",
        "recording {recorded}, calibration {calibrated}",
        "check that both belong together",
    ),
    "correct.hysteresis": Entry(
        2,
        "Hysteresis is not corrected",
        "half-width up to {half_width_dps:.2g} deg/s; the table holds the mean of warming and cooling",
    ),
    "correct.warm_up": Entry(
        1,
        "No warm-up was subtracted",
        "up to {largest_dps:.2g} deg/s, zero from {end_s:g} s after power-on",
        "state the time since power-on at the first sample",
    ),
    # ---- validation
    # ---- twin
    "twin.g_sensitivity_zero": Entry(
        3,
        "Within {sigmas:g} standard errors of zero",
        "only gravity acted on the device",
        "swing it harder, or turn it over on a tumbling table",
    ),
    "twin.no_accelerometer": Entry(3, "No accelerometer readings", action="map the accelerometer columns"),
    "twin.not_fitted": Entry(3, "Not fitted", "{error}"),
    "twin.no_rest": Entry(
        3,
        "No usable rest",
        "wanted {samples} samples without gaps in which every reading changes",
        "record a longer rest before the motion",
    ),
    "twin.bandwidth_above": Entry(
        3,
        "Bandwidth above {above_hz:.0f} Hz",
        "noise at rest shows no low-pass below half the sample rate, {nyquist_hz:.0f} Hz",
        "sample faster to find it",
    ),
    # ---- export
    "imucal.uncertainty": Entry(
        2,
        "Uncertainties are unknown",
        "The file of imucal has no uncertainties: they are NaN here.",
        "Calibrate from the recording itself.",
    ),
    # ---- recordings (undrift info)
    "recording.not_read": Entry(1, "{what}"),
    "recording.gravity": Entry(
        1,
        "Accelerometer: wrong unit or scale",
        "median |accel| is {median_g:.3g} g where a body at rest reads 1 g ({factor:.3g} times too {direction})",
        "correct units.accel or scale.accel in the map",
    ),
    "recording.rest_rate": Entry(
        1,
        "Gyroscope: steady turn, or wrong unit or scale",
        "{turn_rate_dps:.3g} deg/s in its quietest two seconds (at {at_s:.6g} s)",
        "check units.gyro and scale.gyro in the map",
    ),
    "recording.temperature_range": Entry(
        1,
        "Temperature is not room temperature",
        "{low_c:.1f} to {high_c:.1f} degC: processor, chamber, or wrong scale",
    ),
    "recording.temperature_jumps": Entry(
        1,
        "Temperature jumps",
        "by over {limit_k:g} K between samples, {count} times, first after sample {first_sample}",
    ),
    "recording.no_temperature": Entry(3, "The temperature column is empty"),
    "recording.dead_axis": Entry(1, "{channel} {axis} never changes", "a dead or unmapped axis"),
    "recording.saturated": Entry(
        1, "{channel} {axis} saturated", "it stays at {reading:.6g} for {count} samples in a row"
    ),
    "recording.dropouts": Entry(
        2,
        "Drop-outs",
        "{count}, the longest {longest_s:.4g} s at {at_s:.6g} s (median step {step_ms:.4g} ms, mean rate {mean_rate_hz:.4g} Hz)",
    ),
    "recording.uneven_sampling": Entry(
        2, "Uneven sampling", "half of the steps lie outside {low_ms:.4g} to {high_ms:.4g} ms"
    ),
    "recording.rows_dropped": Entry(2, "Rows left out", "{count} did not parse"),
    "recording.rows_repaired": Entry(2, "Rows left out", "in {count}, time did not go forward"),
    "recording.other_columns": Entry(4, "Columns not read", "not undrift's own names: {names}", "map them with --map"),
    "recording.up_axis": Entry(
        3, "The file does not state which axis points up", action='state up = "y" or "z" to read it'
    ),
    "recording.markers_never_seen": Entry(3, "Markers never seen", "{labels}"),
    # ---- study
    "validate.adc": Entry(4, "Quantisation corrected", "gyro codes rounded {rounding}; the mean loss was given back"),
    "validate.gaps_before": Entry(
        2, "Gaps before the motion", "{gaps} of {samples} samples are gaps (NaN): the rest is taken from the others"
    ),
    "validate.correction": Entry(3, "{text}"),
    "validate.extrapolated": Entry(
        2,
        "Rates extrapolated",
        "turns at up to {most_dps:.0f} deg/s, {rms_dps:.0f} rms; the fit has seen {seen_dps:.0f} deg/s, {seen_rms_dps:.0f} rms",
    ),
    "validate.devices_apart": Entry(
        1,
        "Readings at rest up to {spread_dps:.2g} deg/s apart",
        "several devices, or one that was not warmed up; leave-one-out speaks of one device only",
    ),
    "study.one_value": Entry(4, "Not tested", "one value only"),
    "study.all_alike": Entry(4, "Not tested", "all subjects respond alike"),
    "study.no_sit_to_stand": Entry(4, "Figure 3", "the study has no sit-to-stand of the library"),
    "study.rivals_not_asked": Entry(4, "Other ways to calibrate", "not asked for"),
    "study.part_failed": Entry(3, "{part}", "{reason}"),
    "study.none_given": Entry(4, "{part}", "none was given"),
    "study.too_few_for_agreement": Entry(4, "{part}", "{wanted} {unit}or more are needed, {given} were given"),
    "study.subjects_left_out": Entry(
        2, "Subjects left out", "no protocol calibrated the device of subject {subjects} of surface.parquet"
    ),
    "study.runs_missing": Entry(
        2, "Runs missing", "{missing} of {runs}: the protocol could not calibrate the device and is no candidate"
    ),
    "study.mixed_model": Entry(
        2,
        "Mixed model for parameters with missing runs",
        "{parameters}. It assumes that runs are missing at random; failures are not, so it favours the value that failed",
    ),
    "study.flat_minimum": Entry(
        4,
        "Flat minimum",
        "{alike} of {protocols} protocols are as good as the optimum over {subjects} subjects (paired t, Holm)",
        "use the shortest session",
    ),
    "study.as_good": Entry(
        4,
        "Protocols as good as the optimum",
        "{alike} of {protocols} over {subjects} subjects (paired t, Holm)",
    ),
    "study.shorter_session": Entry(
        4,
        "Shortest session as good as the optimum",
        "{saved_min:.1f} min shorter; rms error {difference_deg:+.4f} deg, not significant",
    ),
    "study.deciding": Entry(
        4,
        "Parameters that decide the error",
        "{parameters} (best to worst {span_deg:.3f} deg; p {p_holm:.2g} after Holm)",
    ),
    "study.none_decides": Entry(4, "No parameter decides the error", "least p {p_holm:.2g} after Holm"),
    "study.not_tested": Entry(4, "Parameters not tested", "one value of each, or no difference between subjects"),
    "study.value_not_tried": Entry(4, "Not tried", "{parameter} {value_dps:.4g} deg/s ({reason})"),
    "study.halving": Entry(
        4,
        "Successive halving",
        "{protocols} protocols met {subjects} subjects; {runs} runs, full grid {grid}",
    ),
    "study.note_is_optimum": Entry(
        4, "The note's protocol is the optimum", "{alike} of {others} other protocols are as good"
    ),
    "study.note_as_good": Entry(
        4,
        "The note's protocol is as good as the optimum",
        "{error_deg:.3f} against {optimum_deg:.3f} deg. {subjects} subjects detect differences above {detectable_deg:.3f} deg",
    ),
    "study.note_worse": Entry(
        3,
        "The note's protocol is worse than the optimum",
        "{error_deg:.3f} against {optimum_deg:.3f} deg; no single parameter explains it",
    ),
    "study.note_worse_by_one": Entry(
        3,
        "The note's protocol is worse than the optimum",
        "{error_deg:.3f} against {optimum_deg:.3f} deg. "
        "{parameter} {ours:.4g} in place of {note:.4g} {unit} alone removes {gain_deg:.3f} deg",
    ),
    "study.note_not_tried": Entry(4, "The note's protocol was not tried"),
    "study.note_uncalibrated": Entry(3, "The note's protocol left a device uncalibrated"),
    # ---- export: what a target does not carry, and what the reader of its file must know or do
    "export.rounding": Entry(1, "half a code step for codes cut off toward zero"),
    "export.gain": Entry(1, "gains of the {triad}"),
    "export.cross": Entry(1, "cross-axis terms of the {triad}, up to {most_percent:.2g} %"),
    "export.g_sensitivity": Entry(1, "g-sensitivity, up to {most_dps_per_g:.2g} deg/s per g"),
    "export.static": Entry(1, "offsets over temperature (the static table)"),
    "export.hysteresis": Entry(2, "hysteresis", "the table holds the middle of the loop"),
    "export.warm_up": Entry(1, "the extra offset after power-on"),
    "export.scale": Entry(1, "gains and cross-axis terms over temperature (the scale table)"),
    "export.scale_change": Entry(
        1,
        "gains and cross-axis terms over temperature (the scale table)",
        "the gyroscopes' gains change by {change_percent:.2g} %",
    ),
    "export.dynamic": Entry(1, "error over rate and temperature (the dynamic table), up to {most_dps:.2g} deg/s"),
    "export.lag": Entry(1, "the thermometer's lag of {lag_s:.3g} s", "give the temperature with the lag removed"),
    "export.uncertainty": Entry(2, "uncertainties, marks of extrapolation and the verdict"),
    "export.noise": Entry(2, "noise coefficients"),
    "export.read_at": Entry(2, "tables over temperature are read at {temp_c:g} degC"),
    "export.no_constants": Entry(3, "no {triad} constants", "the calibration has no model of it"),
    "export.readings": Entry(4, "{triad} readings are in {unit}"),
    "export.single_precision": Entry(4, "single precision"),
    "export.keys_of_node": Entry(4, "no standard names these keys", "map them to those of your node"),
    "export.misfit": Entry(
        2,
        "the cubics depart from the {triad} table by up to {misfit[0]:.2g} / {misfit[1]:.2g} / {misfit[2]:.2g} {unit}, x / y / z",
    ),
    "export.constant_moved": Entry(
        4,
        "the gyroscopes' constants at {at_c:g} degC, {offset_dps[0]:.6g} / {offset_dps[1]:.6g} / {offset_dps[2]:.6g} deg/s, have "
        "no place in the cubic",
        "{parameter} holds the offset at {temp_c:g} degC instead",
    ),
    "export.measured_anew": Entry(4, "ArduPilot measures INS_GYROFFS anew at every start unless INS_GYR_CAL is 0"),
    "export.parameters_single": Entry(4, "{program} keeps parameters in single precision"),
    "export.device_ids": Entry(
        4,
        "set TC_G{sensor}_ID, TC_A{sensor}_ID, CAL_GYRO{sensor}_ID and CAL_ACC{sensor}_ID to the sensor's device id",
        "no calibration knows it",
    ),
    "export.nominal": Entry(
        3, "{triad} have no model", "nominal values are passed on", "{name}_raw is taken as {unit}"
    ),
    "export.lag_removed": Entry(
        4,
        "the thermometer's lag of {lag_s:.3g} s is removed by {prefix}_temperature",
        "pass every reading through it before {prefix}_correct",
    ),
    "export.warm_up_removed": Entry(
        4,
        "the extra offset after power-on, zero from {over_s:g} s on, is subtracted by {prefix}_correct_since, which takes the time "
        "since power-on",
        action="{prefix}_correct leaves it in",
    ),
    # ---- rig check
    "rig_check.error": Entry(
        1,
        "Following error beyond its limit",
        "Largest {largest_deg:.4f} deg at steady rate, limit {limit_deg:g} deg.",
        "Check friction, load and gains of the table.",
    ),
    "rig_check.link_delay": Entry(
        3,
        "Link delay hides the error",
        "Largest {largest_deg:.3g} deg, of which up to {unknown_deg:.3g} deg may be delay; limit {limit_deg:g} deg.",
        "Repeat with a slower wave or a faster link.",
    ),
    "rig_check.no_encoder": Entry(
        3,
        "Following error not observable",
        "A controller without encoder reports commanded steps; lost steps and loop margins do not show.",
        "Check marks on the table after the wave.",
    ),
    "rig_check.loop_not_observed": Entry(
        3,
        "Servo loop not observable",
        "The records show no crossover of the open loop.",
        "Repeat with a larger acceleration or a faster link.",
    ),
    "rig_check.low_margin": Entry(
        2,
        "Low phase margin",
        "{margin_deg:.1f} deg at {crossover_rad_s:.0f} rad/s; {least_deg:g} deg or more is usual.",
        "Raise KD or lower KP.",
    ),
    "rig_check.no_gains": Entry(
        3,
        "No gains suggested",
        "No KP and KD give {wanted_deg:g} deg at {crossover_rad_s:.0f} rad/s; the margin is {margin_deg:.1f} deg.",
    ),
    "rig_check.gains": Entry(
        4,
        "Suggested gains",
        "KP {kp:g}, KD {kd:g}, KI {ki:g} for a phase margin of {wanted_deg:g} deg.",
        "Repeat with --set-gains to set them.",
    ),
    "rig_check.gains_set": Entry(
        4,
        "Gains set until the next power-up",
        "KP {kp:g}, KD {kd:g}, KI {ki:g} for a phase margin of {wanted_deg:g} deg.",
    ),
}
