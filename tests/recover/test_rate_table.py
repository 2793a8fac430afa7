"""Rate table with rests: matrix, g-sensitivity and a drifting offset come back, with the least error that noise and walk allow.

The Monte Carlo works on the means of dwells and rests of a bench session; a walk that is built step by step outward from the
middle of the session is added to them. Whole recordings are simulated where few will do.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from testkit.cohorts import COHORTS, first_and_long, ratio_limit, share_limits
from testkit.cramer_rao import Array, Tally, carried, information, jacobian, white_device
from testkit.data import show
from testkit.quiet import without_noise
from undrift.calibration import sources
from undrift.calibration.calibrate import calibrate
from undrift.calibration.rate_table import fit_rate_table
from undrift.calibration.table import DwellMeans
from undrift.fit.priors import G_SENSITIVITY, GYRO_FLICKER
from undrift.fit.triad import TriadFit
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.motion import unit_vector
from undrift.sim.sessions import simulate_session
from undrift.units import STANDARD_GRAVITY

BENCH = BenchSettings(turn_rates=(0.3, 0.6, 0.9, 1.2, 1.5), dwell_s=3.0, still_s=6.0)
SHORT = replace(BENCH, turn_rates=(0.5, 1.0, 1.5), sample_rate_hz=50.0)
CONSUMER_WALK = 0.06  # q over the white noise of one second, 1/s: 3e-4 deg/s/sqrt(s) and 0.007 / sqrt(2) deg/s/sqrt(Hz)


@dataclass(frozen=True)
class Plan:
    """Dwells, then rests: true inputs, seconds averaged, and when."""

    axes: tuple
    rate: Array
    force: Array
    length_s: Array
    time: Array
    dwells: int

    @property
    def middle(self) -> float:
        return 0.5 * float(self.time.min() + self.time.max())


@cache
def plan() -> Plan:
    motion = bench_motion("bench", rng=np.random.default_rng(0), settings=BENCH)
    turns, stills = motion.turns, motion.stills
    rate = [turn.turn_rate * unit_vector(turn.axis) for turn in turns] + [np.zeros(3)] * len(stills)  # type: ignore[operator, arg-type]
    pieces = (*turns, *stills)
    return Plan(
        axes=tuple(turn.axis for turn in turns),
        rate=np.array(rate),
        force=np.array([motion.force_b[p.start : p.stop].mean(axis=0) for p in pieces]),
        length_s=np.array([(p.stop - p.start) / BENCH.sample_rate_hz for p in pieces]),
        time=np.array([0.5 * (motion.time[p.start] + motion.time[p.stop - 1]) for p in pieces]),
        dwells=len(turns),
    )


@pytest.fixture(autouse=True)
def no_flicker(monkeypatch: pytest.MonkeyPatch) -> None:
    """State no flicker and no steady drift: the devices here have white noise and walks only."""
    monkeypatch.setattr(sources, "GYRO_FLICKER", 0.0)
    monkeypatch.setattr(sources, "REST_DRIFT", 0.0)


def spans(p: Plan) -> Array:
    """Return start and stop of each piece, (E, 2), s."""
    return p.time[:, None] + 0.5 * p.length_s[:, None] * np.array([-1.0, 1.0])


def walk_of(rng: np.random.Generator, q: Array) -> Array:
    """Return a random walk at the times of the plan, less its mean from the first to the last, (E, 3)."""
    p = plan()
    fine = np.linspace(p.time.min(), p.time.max(), 4001)
    steps = rng.standard_normal((len(fine), 3)) * np.sqrt(np.diff(fine, prepend=fine[0]))[:, None]
    walk = np.cumsum(steps, axis=0) * q
    walk -= walk.mean(axis=0)
    return np.column_stack([np.interp(p.time, fine, own) for own in walk.T])


def feigned(device: DeviceModel) -> Array:
    """Return H: reading per m/s2."""
    felt = device.gyro.g_sensitivity
    return np.zeros((3, 3)) if felt is None else device.gyro.gain * felt.matrix


def white(device: DeviceModel) -> Array:
    """Return the white noise of one second, (3,)."""
    return device.gyro.gain * device.gyro.white_noise.random_walk


def fitted(device: DeviceModel, rng: np.random.Generator, walk: float) -> TriadFit:
    """Return the fit to noisy means of a device whose offset walks by ``walk`` times its white noise."""
    p = plan()
    sigma = white(device) / np.sqrt(p.length_s)[:, None]
    reading = p.rate @ device.gyro.forward_matrix.T + p.force @ feigned(device).T + device.gyro.raw_offset
    reading = reading + walk_of(rng, walk * white(device)) + sigma * rng.standard_normal(sigma.shape)
    n = p.dwells
    dwells = DwellMeans(
        reading=reading[:n], turn_rate=p.rate[:n].sum(axis=1), axis=p.axes, noise=sigma[:n], up=np.ones(n), unit="count",
        span=spans(p)[:n],
    )  # fmt: skip
    return fit_rate_table(dwells.with_rests(reading[n:], noise=sigma[n:], span=spans(p)[n:], force=p.force))


def report(theta: Array) -> Array:
    """Return M, b and G = M H of K, b and H, row by row."""
    matrix = np.linalg.inv(theta[:9].reshape(3, 3))
    return np.concatenate((matrix.ravel(), theta[9:12], (matrix @ theta[12:].reshape(3, 3)).ravel()))


def truth(device: DeviceModel) -> Array:
    return np.concatenate((device.gyro.forward_matrix.ravel(), device.gyro.raw_offset, feigned(device).ravel()))


@cache
def design(size: int) -> Array:
    """Return what the means gain with each of K, b and H, sensor by sensor, (3, E, size): the same for every device."""
    p = plan()

    def mean(x: Array) -> Array:
        H = x[12:].reshape(3, 3) if len(x) > 12 else np.zeros((3, 3))
        return (p.rate @ x[:9].reshape(3, 3).T + p.force @ H.T + x[9:12]).T.ravel()

    return jacobian(mean, np.zeros(size), 1.0).reshape(3, len(p.time), size)  # linear: any step is exact


@cache
def whitening(walk: float) -> Array:
    """Return the matrix that whitens the means of one sensor, white noise of one second 1, (E, E)."""
    p = plan()
    since = p.time - p.time.min()
    mean = since - since**2 / (2.0 * since.max())
    shared = np.minimum.outer(since, since) - mean[:, None] - mean + since.max() / 3.0
    return np.linalg.inv(np.linalg.cholesky(np.diag(1.0 / p.length_s) + walk**2 * shared))


def bound(device: DeviceModel, walk: float) -> Array:
    """Return the Cramer-Rao bound of what is reported, where sigma and q are known."""
    theta = truth(device)
    fisher = np.zeros((len(theta), len(theta)))
    for rows, noise in zip(design(len(theta)), white(device), strict=True):
        fisher += information(whitening(walk) @ rows / noise, np.ones(len(rows)))
    return carried(report, theta, 1e-4 * theta[0], np.linalg.inv(fisher))


PARTS = {"matrix": slice(0, 9), "offset": slice(9, 12), "g-sensitivity": slice(12, 21)}


def monte_carlo(walk: float, gravity: bool, devices: int) -> dict[str, Tally]:
    """Return errors over the bound and over what was stated, for each part of the parameters."""
    rng, tallies = np.random.default_rng(10), {name: Tally.of(name) for name in PARTS}
    for _ in range(devices):
        device = white_device(rng, g_sensitivity=gravity)
        model = fitted(device, rng, walk).model
        assert model.g_sensitivity is not None
        estimate = np.concatenate((model.matrix.ravel(), model.offset, model.g_sensitivity.ravel()))
        error, least = estimate - report(truth(device)), bound(device, walk)
        for name, part in PARTS.items():
            tallies[name].add(error[part], least[part], model.standard_uncertainty[part])
    for name, tally in tallies.items():
        label = f"walk {walk:g}, gravity felt {gravity}, {name}"
        show(f"{label}: RMSE over bound, coverage", f"{tally.ratio:.3f}, {tally.coverage:.3f}")
    return tallies


@pytest.mark.parametrize("gravity", first_and_long((True, False)))
def test_bench_session_without_noise_gives_back_the_device(gravity: bool) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        device = without_noise(white_device(rng, g_sensitivity=gravity))
        gyro = calibrate(simulate_session("bench", device, rng=rng, settings=SHORT)).gyro
        true = true_calibration(device).gyro
        assert gyro is not None
        assert true is not None
        # Gravity shows the table's axis to 1e-6 rad a block, the least noise that is assumed.
        np.testing.assert_allclose(gyro.matrix @ device.gyro.forward_matrix, np.eye(3), atol=1e-7)
        np.testing.assert_allclose(gyro.offset, true.offset, atol=1e-4)  # counts of up to 1500
        assert gyro.g_sensitivity is not None
        felt = np.zeros((3, 3)) if true.g_sensitivity is None else true.g_sensitivity
        assert (np.abs(felt).max() > 1e-4) == gravity  # 0.06 (deg/s)/g
        np.testing.assert_allclose(gyro.g_sensitivity, felt, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("devices", COHORTS)
@pytest.mark.parametrize(
    ("walk", "gravity"), [(0.0, True), (0.0, False), (CONSUMER_WALK, True), (0.3, True), (0.3, False)]
)
def test_errors_reach_the_bound_with_and_without_drift(
    walk: float, gravity: bool, devices: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    if walk == CONSUMER_WALK:  # too small to show in many sessions: the flicker that the fit states covers it
        monkeypatch.setattr(sources, "GYRO_FLICKER", GYRO_FLICKER)
    # The bound knows q and has no prior for the g-sensitivity; the fit finds q.
    for name, tally in monte_carlo(walk, gravity, devices).items():
        errors = np.size(tally.by_bound)
        assert name == "g-sensitivity" or tally.ratio <= max(ratio_limit(errors), 1.07 if name == "offset" else 0.0)
        low, high = share_limits(errors)
        assert tally.coverage >= low
        # A walk too small to show cannot be ruled out: the intervals of what it moves are then too wide, never too narrow.
        assert walk == 0.0 or tally.coverage <= high


@pytest.mark.slow
def test_rests_on_faces_give_the_offset_without_accelerometers() -> None:
    """Dwells have +x, +y and +z up: their mean offset holds a third of three g-sensitivities, which the faces below cancel."""
    errors = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        device = white_device(rng, g_sensitivity=True)
        session = simulate_session("bench", device, rng=rng, settings=SHORT)
        gyros = replace(session, records=tuple(replace(record, accel=None) for record in session.records))
        calibration = calibrate(gyros)
        assert calibration.gyro is not None
        assert calibration.gyro.g_sensitivity is None
        errors.append((calibration.gyro.offset - device.gyro.raw_offset) / calibration.gyro.standard_uncertainty[9:12])
        lone = calibrate(replace(gyros, stills=tuple(replace(still, face=None) for still in gyros.stills))).gyro
        assert lone is not None
        assert np.all(calibration.gyro.standard_uncertainty[9:12] < lone.standard_uncertainty[9:12])
    # 18 squares of mean 1: chi-square, passed by chance once in a thousand times
    assert float(np.mean(np.square(errors))) < 2.35


# Findings, and sessions without any.


def steady(walk: float = 0.0, scatter: float = 1.0) -> DwellMeans:
    rng, p, n = np.random.default_rng(40), plan(), plan().dwells
    sigma = np.full((len(p.time), 3), 1e-4)
    reading = p.rate + walk_of(rng, np.full(3, walk)) + scatter * sigma * rng.standard_normal(sigma.shape)
    dwells = DwellMeans(
        reading=reading[:n],
        turn_rate=p.rate[:n].sum(axis=1),
        axis=p.axes,
        noise=sigma[:n],
        up=np.ones(n),
        span=spans(p)[:n],
    )
    return dwells.with_rests(reading[n:], noise=sigma[n:], span=spans(p)[n:], force=p.force)


def test_rests_on_one_face_leave_the_g_sensitivity_at_its_prior() -> None:
    means = steady()
    up = np.array([0.0, 0.0, STANDARD_GRAVITY])  # dwells too: as if the device never turned over
    fit = fit_rate_table(replace(means, force=np.tile(up, (len(means.axis), 1))))
    sigma = fit.model.standard_uncertainty[12:].reshape(3, 3)
    np.testing.assert_allclose(sigma[:, :2], G_SENSITIVITY, rtol=1e-6)
