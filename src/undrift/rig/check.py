"""Acceptance of a table: following error in a step wave, crossover and phase margin of its servo loop, and gains that suit it.

Step wave: +- a rate for a while, as the note's preliminary test (90 deg/s for 60 s, error below 0.012 deg). The error is commanded
minus actual, recorded by the controller at even steps of its own clock. It counts from 50 ms after each run-up, and at rest at the
end; in the run-up it grows with acceleration and is shown apart. A stepper reports no error: there it is the distance of its
reported positions from a straight line, with the delays of the link in it.

Loop: at rates that no whole number of counts per sample fits, the rate changes every few milliseconds while the controller records
position y and error e. The open loop's response is measured, no model of the loop is assumed:

    L(omega) = sum conj(Z) Y / sum conj(Z) E          Z, Y, E: spectra; sums over records and a narrow band

with z = 1 where the commanded rate y' + e' is nearer to the larger of its two values, else 0: it is related to what was commanded
and, unlike y + e itself, not to the rounding of counts, which would bias L.

log |L| and arg L as parabolas of log omega give the crossover |L| = 1 and the margin pi + arg L there; leaving out one record after
the other gives their standard uncertainties (jackknife). It is the sampled loop's margin, with the delay of the hold.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.clock import Clock
from undrift.errors import InputError, RigError, RigTimeout, check_positive
from undrift.findings import Finding, finding
from undrift.model import Verdict
from undrift.rig.rig import Gains, Position, Rig, Servo, Trace, achieved_turn_rate
from undrift.rig.watch import uninterrupted
from undrift.units import RADIAN_PER_DEGREE

Report = Callable[[str], None]

OFF_COUNTS = 2.5  # from a straight line: a changing rate, not rounding
SETTLE_S = 0.05  # after a run-up, before the error counts
RECORDED = 0.8  # part of each half period that is recorded
RECORDS, MOST_RECORDS = 24, 96  # of the loop: looked at after so many
ENOUGH, LARGEST_UNCERTAINTY = 0.025, 0.1  # standard, of the margin (rad) and of the crossover (relative)
RECORD_S, EXCITED = 0.25, 0.7  # table s; part of it in which the rate changes: the loop comes to rest within the record
CHANGE = 0.3  # of the wave's rate, to and fro
PAUSES_S = (0.0025, 0.004, 0.0065, 0.01)  # between two changes: crossovers from 300 to 1300 rad/s see the most of them
SMOOTHING_S = 0.004  # over which the commanded rate is seen through the rounding of counts
GOLDEN = 0.6180339887498949  # its multiples, less whole turns, fill an interval evenly
TAPER = 0.05  # of a record, at each end
BAND = 0.08  # of log omega, over which spectra are summed
NEAR = 0.5  # of log omega, either way, that the parabolas are fitted to
LEAST_MARGIN_DEG, WANTED_MARGIN_DEG, LARGEST_MARGIN_DEG = 30.0, 45.0, 70.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckSettings:
    """The step wave and its limit."""

    turn_rate: float = 90.0 * RADIAN_PER_DEGREE  # Either way, rad/s
    duration_s: float = 60.0  # Table s
    acceleration: float = 2300.0 * RADIAN_PER_DEGREE  # rad/s2
    limit: float = 0.012 * RADIAN_PER_DEGREE  # Largest following error, rad
    half_period_s: float = 1.0  # One way, table s
    set_gains: bool = False  # Leave the suggested gains on the controller

    def __post_init__(self) -> None:
        names = ("turn_rate", "duration_s", "acceleration", "limit", "half_period_s")
        check_positive(self, "rig check", "state another", *names)
        if not self.turn_rate / self.acceleration < 0.2 * self.half_period_s:
            raise InputError(
                f"rig check: wanted run-ups below {0.2 * self.half_period_s:g} s, got "
                f"{self.turn_rate / self.acceleration:.3g} s; choose a larger acceleration or a slower wave"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class WaveError:
    """Following error in a step wave."""

    rms: float  # At steady rate, rad
    largest: float  # At steady rate and at rest at the end, rad
    in_run_up: float  # Largest while the rate changes, rad; NaN where that is not recorded
    turn_rate: float  # Mean of the rates achieved, either way, by the controller's clock where it has one, rad/s
    unknown: float = 0.0  # So much of it the link's delays may be, rad


@dataclass(frozen=True, slots=True)
class OpenLoop:
    """The open loop near its crossover."""

    crossover: float  # rad/s
    crossover_uncertainty: float  # Standard, rad/s
    margin: float  # rad
    margin_uncertainty: float  # Standard, rad

    @property
    def response(self) -> complex:
        """L at the crossover."""
        return complex(-math.cos(self.margin), -math.sin(self.margin))


@dataclass(frozen=True, slots=True)
class RigCheck:
    """What a check found."""

    identity: str
    error: WaveError
    passed: bool | None  # None where the link hides the error
    loop: OpenLoop | None  # None where it is not observable
    gains: Gains | None  # As found
    suggested: Gains | None
    held: Gains | None  # By the controller at the end
    verdict: Verdict = field(default_factory=Verdict)


def check_rig(rig: Rig, clock: Clock, settings: CheckSettings, report: Report = lambda line: None) -> RigCheck:
    """Check a table and let go of it: at rest, its motor as found; off after an error of the rig itself."""
    try:
        found = _checked(rig, clock, settings, report)
    except BaseException as error:
        with uninterrupted():
            rig.close(as_found=not isinstance(error, RigError))
        raise
    with uninterrupted():
        rig.close(as_found=True)
    return found


def _checked(rig: Rig, clock: Clock, settings: CheckSettings, report: Report) -> RigCheck:
    rig.limits.check_turn_rate(settings.turn_rate)
    rig.limits.check_travel(2.0 * settings.turn_rate * settings.half_period_s)
    identity, servo = rig.identify(), rig.servo
    gains = servo.read_gains() if servo else None
    rig.enable(True)
    rig.set_acceleration(settings.acceleration)
    try:
        error = (
            _recorded_wave(rig, servo, clock, settings, report) if servo else _polled_wave(rig, clock, settings, report)
        )
        loop = _measured_loop(rig, servo, clock, settings, report) if servo else None
        rig.stop()
    finally:
        if servo:
            servo.free()
    suggested = held = gains
    if servo and loop and not LEAST_MARGIN_DEG <= loop.margin / RADIAN_PER_DEGREE <= LARGEST_MARGIN_DEG:
        suggested = servo.gains_for(WANTED_MARGIN_DEG * RADIAN_PER_DEGREE, loop.crossover, loop.response)
    if servo and suggested and suggested != gains and settings.set_gains:
        held = servo.set_gains(suggested)
    beyond = error.largest > settings.limit
    passed = None if beyond and error.largest - error.unknown <= settings.limit else not beyond
    verdict = Verdict.of(*_findings(error, passed, loop, (gains, suggested, held), settings))
    return RigCheck(identity, error, passed, loop, gains, suggested, held, verdict)


# ---- Step wave


def _wave(rig: Rig, clock: Clock, settings: CheckSettings, report: Report, each: Callable[[float], None]) -> None:
    """Turn to and fro, `each` half period at a signed rate, and come to rest."""
    sign, end = 1.0, clock.now() + settings.duration_s
    while (begun := clock.now()) < end:
        report(f"step wave, {max(end - begun, 0.0):.0f} s left")
        each(sign * settings.turn_rate)
        clock.wait(settings.half_period_s - (clock.now() - begun))
        sign = -sign
    rig.stop()


def _recorded_wave(rig: Rig, servo: Servo, clock: Clock, settings: CheckSettings, report: Report) -> WaveError:
    turns: list[tuple[float, Trace]] = []  # at the rate held

    def each(turn_rate: float) -> None:
        servo.start(RECORDED * settings.half_period_s)
        turns.append((rig.turn(turn_rate), servo.trace()))

    _wave(rig, clock, settings, report, each)
    at_rest = abs(rig.following_error())
    parted = [(trace, steady_part(trace, turn_rate)) for turn_rate, trace in turns]
    steady = np.concatenate([trace.error[part:] for trace, part in parted])
    if not len(steady):
        raise RigTimeout(
            "rig check: wanted records that reach a steady rate, got none; look at the link and at the table"
        )
    slopes = [
        abs(trace.position[-1] - trace.position[part]) / (trace.period_s * (len(trace.position) - 1 - part))
        for trace, part in parted
        if len(trace.position) - part > 2
    ]
    return WaveError(
        rms=float(np.sqrt(np.mean(steady**2))),
        largest=max(float(np.abs(steady).max()), at_rest),
        in_run_up=max(float(np.abs(trace.error[:part]).max(initial=0.0)) for trace, part in parted),
        turn_rate=float(np.mean(slopes)),
    )


def steady_part(trace: Trace, turn_rate: float) -> int:
    """Return the first sample from which on the commanded rate is steady and settled; their number where it is not at the end."""
    commanded = trace.position + trace.error
    along = commanded - turn_rate * trace.period_s * np.arange(len(commanded))
    steps = np.abs(np.diff(trace.position))
    count = float(steps[steps > 0.0].min(initial=math.inf))
    off = np.flatnonzero(np.abs(along - np.median(along[-(len(along) // 4) :])) > OFF_COUNTS * count)
    first = 0 if not len(off) else int(off[-1]) + 1 + math.ceil(SETTLE_S / trace.period_s)
    return min(first, len(commanded))


def _polled_wave(rig: Rig, clock: Clock, settings: CheckSettings, report: Report) -> WaveError:
    """Without an encoder: distances of reported positions from a straight line at the rate that the controller holds."""
    residuals: list[float] = []
    rates: list[float] = []
    delays: list[float] = []

    def each(turn_rate: float) -> None:
        begun = clock.now()
        held = rig.turn(turn_rate)
        clock.wait(abs(turn_rate) / settings.acceleration + SETTLE_S)
        positions: list[Position] = []
        while clock.now() - begun < RECORDED * settings.half_period_s or len(positions) < 3:
            positions.append(rig.position())
            clock.wait(0.01)
        along = np.array([p.angle - held * (p.time - positions[0].time) for p in positions])
        residuals.extend(along - along.mean())
        rates.append(abs(achieved_turn_rate(positions).turn_rate))
        delays.append(2.0 * max(p.within_s for p in positions))

    _wave(rig, clock, settings, report, each)
    off = np.abs(np.array(residuals))
    return WaveError(
        rms=float(np.sqrt(np.mean(off**2))),
        largest=float(off.max()),
        in_run_up=math.nan,
        turn_rate=float(np.mean(rates)),
        unknown=settings.turn_rate * max(delays),
    )


# ---- Open loop


def _measured_loop(rig: Rig, servo: Servo, clock: Clock, settings: CheckSettings, report: Report) -> OpenLoop | None:
    """Record the loop until crossover and margin are known well enough; None where they are not after many records."""
    traces: list[Trace] = []
    while len(traces) < MOST_RECORDS:
        for number in range(len(traces), len(traces) + RECORDS):
            report(f"servo loop, record {number + 1}")
            traces.append(_excited(rig, servo, clock, settings, number))
        loop = open_loop(traces)
        if loop and max(loop.margin_uncertainty, loop.crossover_uncertainty / loop.crossover) < ENOUGH:
            break
    if loop and max(loop.margin_uncertainty, loop.crossover_uncertainty / loop.crossover) > LARGEST_UNCERTAINTY:
        return None
    return loop


def _excited(rig: Rig, servo: Servo, clock: Clock, settings: CheckSettings, number: int) -> Trace:
    """Return a record of the loop while the rate changes as often as the link lets it."""
    base = math.copysign(settings.turn_rate * (0.4 + 0.5 * (number * GOLDEN % 1.0)), 0.5 - number % 2)
    pause_s = PAUSES_S[number % len(PAUSES_S)]
    rig.turn(base)
    clock.wait(2.0 * settings.turn_rate / settings.acceleration + SETTLE_S)
    servo.start(RECORD_S)
    end, count = clock.now() + EXCITED * RECORD_S, 0
    while (begun := clock.now()) < end:
        count += 1
        servo.nudge(base - math.copysign(CHANGE * settings.turn_rate * (count % 2), base))
        clock.wait(pause_s * (0.7 + 0.6 * (count * GOLDEN % 1.0)) - (clock.now() - begun))
    servo.nudge(base)
    return servo.trace()


def open_loop(traces: Sequence[Trace]) -> OpenLoop | None:
    """Return crossover and margin of the open loop; None where the records do not show a crossover."""
    n, period_s = min(len(trace.position) for trace in traces), traces[0].period_s
    omega = 2.0 * math.pi * np.fft.rfftfreq(n - 1, period_s)[1:]

    inward = np.arange(n - 1)
    taper = np.minimum(1.0, np.minimum(inward, inward[::-1]) / (TAPER * n))

    def spectra(values: FloatArray) -> np.ndarray:
        return np.fft.rfft(taper * (values - values[:, -1 - n // 8 :].mean(axis=1, keepdims=True)), axis=1)[:, 1:]

    places = np.array([trace.position[:n] for trace in traces])
    errors = np.array([trace.error[:n] for trace in traces])
    position, error = spectra(np.diff(places, axis=1)), spectra(np.diff(errors, axis=1))
    commanded = np.conj(spectra(_faster(places + errors, max(1, round(SMOOTHING_S / period_s)))))
    band = np.floor(np.log(omega / omega[0]) / BAND).astype(int)
    kept = np.unique(band)
    member = (band == kept[:, None]) / np.array([(band == number).sum() for number in kept])[:, None]
    centre = member @ np.log(omega)
    forward, backward = (commanded * position) @ member.T, (commanded * error) @ member.T  # records x bands
    whole = _crossover(centre, forward.sum(axis=0), backward.sum(axis=0))
    if whole is None:
        return None
    left_out = [
        _crossover(centre, forward.sum(axis=0) - f, backward.sum(axis=0) - b)
        for f, b in zip(forward, backward, strict=True)
    ]
    if any(found is None for found in left_out):
        return None
    spread = np.sqrt((len(traces) - 1) * np.var(np.array(left_out, float), axis=0))
    return OpenLoop(whole[0], float(spread[0]), whole[1], float(spread[1]))


def _faster(commanded: FloatArray, over: int) -> FloatArray:
    """Return 1 where the commanded rate is nearer to its larger value, 0 elsewhere: free of the counts' rounding.
    commanded (k, n) rad -> (k, n - 1)."""
    padded = np.pad(commanded, ((0, 0), (over // 2, over - over // 2)), mode="edge")
    rate = padded[:, over:] - padded[:, :-over]
    low, high = (np.quantile(rate[:, over:-over], part, axis=1, keepdims=True) for part in (0.05, 0.95))
    return (rate > 0.5 * (low + high))[:, 1:].astype(float)


def _crossover(centre: FloatArray, forward: np.ndarray, backward: np.ndarray) -> tuple[float, float] | None:
    """Return where |forward / backward| falls through one, rad/s, and the phase above -180 deg there, rad."""
    response = forward / backward
    gain = np.log(np.abs(response))
    below = np.flatnonzero((gain[:-1] < 0.0) & (gain[1:] < 0.0))
    if not len(below) or below[0] == 0:
        return None
    middle = centre[below[0]]
    for _ in range(3):
        near = np.abs(centre - middle) < NEAR
        if near.sum() < 5:
            return None
        x, weight = centre[near] - middle, np.sqrt(np.abs(backward[near]))
        falling = np.polynomial.Polynomial.fit(x, gain[near], 2, w=weight)
        phase = np.polynomial.Polynomial.fit(x, np.unwrap(np.angle(response[near])), 2, w=weight)
        roots = [root.real for root in falling.roots() if abs(root.imag) < 1e-9]
        if not roots:
            return None
        step = min(roots, key=abs)
        margin = math.pi + float(phase(step))
        middle += step
    return math.exp(middle), (margin + math.pi) % (2.0 * math.pi) - math.pi


# ---- Findings


def _findings(
    error: WaveError,
    passed: bool | None,
    loop: OpenLoop | None,
    gains: tuple[Gains | None, Gains | None, Gains | None],
    settings: CheckSettings,
) -> list[Finding]:
    dps, made = RADIAN_PER_DEGREE, []
    wave = {"largest_deg": error.largest / dps, "limit_deg": settings.limit / dps}
    if passed is False:
        made.append(finding("rig_check.error", "fail", **wave))
    elif passed is None:
        made.append(finding("rig_check.link_delay", "warn", **wave, unknown_deg=error.unknown / dps))
    read, suggested, held = gains
    if read is None:
        made.append(finding("rig_check.no_encoder", "warn"))
    elif loop is None:
        made.append(finding("rig_check.loop_not_observed", "warn"))
    else:
        seen = {"margin_deg": loop.margin / dps, "crossover_rad_s": loop.crossover}
        if seen["margin_deg"] < LEAST_MARGIN_DEG:
            made.append(finding("rig_check.low_margin", "warn", **seen, least_deg=LEAST_MARGIN_DEG))
        if suggested is None:
            made.append(finding("rig_check.no_gains", "info", **seen, wanted_deg=WANTED_MARGIN_DEG))
    if suggested is not None and suggested != read:
        numbers = {**asdict(suggested), "wanted_deg": WANTED_MARGIN_DEG}
        made.append(finding("rig_check.gains_set" if held == suggested else "rig_check.gains", "info", **numbers))
    return made
