"""The loop against the figures of the makers' manual (ch. 10), of the note, and those worked out from both."""

import numpy as np
import pytest

from testkit.data import show
from testkit.loop_margins import loop_margins, ramp_error_counts
from undrift.errors import InputError
from undrift.kernels import device as k
from undrift.sim.rig.axes import MotorAxis, ServoSettings

DEG_PER_COUNT = 360.0 / 40_000
IDEAL = ServoSettings(quantise=False, coulomb_friction=0.0)


def jogging(servo: ServoSettings, speed: float) -> MotorAxis:
    axis = MotorAxis(servo)
    axis.change(motor_on=True)
    axis.values[k.MODE], axis.values[k.TARGET] = k.JOG, speed
    return axis


def followed(axis: MotorAxis, duration_s: float) -> np.ndarray:
    """Return reference minus axis at the instant of each sample, deg."""
    errors = []
    for _ in range(round(duration_s / axis.coefficients.period)):
        there = axis.values[k.ANGLE] * axis.coefficients.counts_per_rad
        axis.advance(axis.time + axis.coefficients.period)
        errors.append(axis.values[k.REFERENCE] - there)
    return np.array(errors) * 360.0 / axis.servo.counts_per_turn


# lines, T, KP, KD, crossover rad/s, margin deg, largest abs z
TABLE = [
    ("manual", 500, 1e-3, 12.5, 245.0, 192.7, 69.7, 0.921),
    ("note", 10_000, 1e-4, 12.5, 245.0, 522.8, 44.2, 0.98124),
    ("N read as counts", 2_500, 1e-4, 12.5, 245.0, 228.7, 23.5, 0.995),
    ("note's lines, 1 ms", 10_000, 1e-3, 12.5, 245.0, 2398.0, None, 1.403),
    ("default gains, 1 ms", 10_000, 1e-3, 6.0, 64.0, 897.0, 59.9, 0.907),
    ("default gains, 0.1 ms", 10_000, 1e-4, 6.0, 64.0, 311.0, 17.4, 0.995),
]


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row[0])
def test_crossover_margin_and_poles_are_those_of_the_table(row):
    name, lines, period, kp, kd, crossover, margin, largest = row
    loop = loop_margins(ServoSettings(encoder_lines=lines, period_s=period, gains=(kp, kd, 0.0)))
    show(f"{name}: crossover rad/s", round(loop.crossover, 1), crossover)
    show(f"{name}: phase margin deg", round(loop.phase_margin_deg, 1), margin)
    show(f"{name}: max |z|", round(loop.largest_z, 5), largest)
    assert loop.crossover == pytest.approx(crossover, rel=1e-3)  # printed to 4 digits at most
    assert margin is None or loop.phase_margin_deg == pytest.approx(margin, abs=0.06)
    assert loop.largest_z == pytest.approx(largest, abs=6e-4 if largest != 0.98124 else 6e-6)


def test_the_loop_of_the_note_has_its_poles():
    poles = loop_margins(ServoSettings()).poles_s
    show("poles rad/s", [complex(round(p.real, 1), round(p.imag, 1)) for p in poles])
    assert poles[0].real == pytest.approx(-189.4, abs=0.05)
    assert abs(poles[0].imag) == pytest.approx(403.3, abs=0.05)
    manual = loop_margins(ServoSettings(encoder_lines=500, period_s=1e-3)).poles_s
    assert [round(p.real) for p in manual] == [-82, -148, -2139]


def test_payload_slows_the_loop_and_an_integral_term_adds_a_pole():
    bare = loop_margins(ServoSettings())
    laden = loop_margins(ServoSettings(payload_inertia=2e-4))
    assert laden.crossover < 0.8 * bare.crossover
    assert len(loop_margins(ServoSettings(gains=(12.5, 245.0, 1.0))).poles_z) == 4


def test_the_time_simulation_has_the_poles_of_the_margins():
    axis = MotorAxis(IDEAL)
    axis.change(motor_on=True)
    axis.values[k.REFERENCE] = 5.0  # a step of 5 counts: linear, no clip
    error = followed(axis, 0.03)[10:] / DEG_PER_COUNT  # the third pole has died after ten samples
    slow = [z for z in loop_margins(IDEAL).poles_z if abs(z) > 0.9]
    modes = np.vander(slow, len(error), increasing=True).T
    rest = np.abs(error - (modes @ np.linalg.lstsq(modes, error, rcond=None)[0]).real).max()
    show("step response not explained by the slow poles, counts", rest, 1e-9)
    assert rest < 1e-9


def test_the_following_error_in_a_ramp_is_the_notes():
    predicted = ramp_error_counts(IDEAL, 256_000.0) * DEG_PER_COUNT
    error = followed(jogging(IDEAL, 10_000.0), 0.3)
    steps = followed(jogging(ServoSettings(coulomb_friction=0.0), 10_000.0), 0.3)
    show("mid-ramp, worked out, deg", round(predicted, 5), 0.01206)
    show("mid-ramp, simulated, deg", round(error[300:380].mean(), 5), 0.0121)
    show("peak, deg", round(np.abs(error).max(), 4), 0.0148)
    show("peak with count steps, deg", round(np.abs(steps).max(), 4), 0.0155)
    show("at speed with count steps, deg", round(np.abs(steps[1500:]).max(), 4), 0.006)
    assert predicted == pytest.approx(0.01206, abs=5e-6)
    assert error[300:380].mean() == pytest.approx(0.0121, abs=6e-5)
    assert np.abs(error).max() == pytest.approx(0.0148, abs=5e-5)
    assert np.abs(steps).max() == pytest.approx(0.0155, abs=5e-5)
    assert np.abs(steps[1500:]).max() < 0.0065


@pytest.mark.parametrize("servo", [IDEAL, ServoSettings(), ServoSettings(cogging_torque=2e-3, payload_inertia=1e-4)])
def test_a_step_wave_of_90_dps_for_60_s_ends_within_the_notes_error(servo):
    axis = jogging(servo, 10_000.0)
    for turn in range(30):  # 1 s one way, 1 s the other
        for way in (1.0, -1.0):
            axis.values[k.TARGET] = way * 10_000.0
            axis.advance(2.0 * turn + (1.0 if way > 0.0 else 2.0))
    axis.values[k.MODE] = k.STOPPING
    assert axis.advance(60.2) == k.DONE
    axis.advance(60.2)
    ends = abs(axis.values[k.REFERENCE] * DEG_PER_COUNT - np.degrees(axis.values[k.ANGLE]))
    show("error after a step wave of 90 deg/s for 60 s, deg", round(ends, 5), 0.012)
    assert ends < 1.2e-2


def test_the_notes_supply_of_12_v_limits_a_runaway_and_nothing_that_a_protocol_asks_for():
    ends, runaways = [], []
    for volts in (12.0, 48.0):
        axis = jogging(ServoSettings(supply_voltage=volts), 10_000.0)  # 90 deg/s
        axis.advance(0.5)
        axis.values[k.TARGET] = -10_000.0
        axis.advance(1.0)
        ends.append(axis.values.copy())
        axis.change(encoder_good=False)
        axis.advance(3.0)
        runaways.append(abs(axis.values[k.RATE]))
    assert np.array_equal(*ends)
    show(
        "rates of a motor that runs away at 12 and 48 V, rad/s", [round(float(rate), 1) for rate in runaways], "V / Kt"
    )
    assert runaways == pytest.approx([12.0 / 0.1, 48.0 / 0.1], rel=0.02)  # less what friction takes


def test_coefficients_that_make_no_loop_are_refused():
    with pytest.raises(InputError, match=r"servo inertia: wanted a positive number, got 0.0"):
        ServoSettings(inertia=0.0)
    with pytest.raises(InputError, match=r"servo coulomb_friction: wanted zero or more, got -1.0"):
        ServoSettings(coulomb_friction=-1.0)
