"""Readings of a simulated device as time goes on: chunk by chunk, with what it remembers carried from one to the next.

The effects and their order are those of sim/device/chain.py. What has a memory - low-pass, flicker, random walk, hysteresis, the
thermometer's lag - is stepped here by its own recursion, so that chunks of any size join without a seam. Readings are taken at even
steps; the jitter and the delays of a converter are left out.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.adc import converted, rounded
from undrift.sim.device.amplifier import amplified
from undrift.sim.device.chain import SensorChain
from undrift.sim.device.g_sensitivity import with_g
from undrift.sim.device.instability import RATIO
from undrift.sim.device.lever_arm import lever_arm_force
from undrift.sim.device.low_pass import difference_equation
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.nonlinearity import bent
from undrift.sim.device.offset import with_offset
from undrift.sim.device.scale import scaled
from undrift.sim.device.scene import Scene
from undrift.sim.device.thermal_scale import warmed
from undrift.sim.device.thermometer import TRIM_TEMP_C, Thermometer
from undrift.sim.device.warm_up import warming_up
from undrift.sim.streams import draw_streams


@dataclass(frozen=True, slots=True, eq=False)
class DeviceSaid:
    """Readings, n of them.

    Parameters
    ----------
    gyro, accel : array, shape (n, 3)
        In the units of the device's chains.
    temp_c : array, shape (n,)
        degC.
    """

    gyro: FloatArray
    accel: FloatArray
    temp_c: FloatArray


class CausalDevice:
    """A device that is read as time goes on.

    Parameters
    ----------
    device : DeviceModel
        What it is.
    step_s : float
        Time from reading to reading, s.
    rng : Generator
        Draws the noise, each effect from a stream of its own.
    """

    def __init__(self, device: DeviceModel, step_s: float, rng: np.random.Generator) -> None:
        streams = draw_streams(rng)
        self.device = device
        self._gyro = _Chain(
            device.gyro, step_s, [streams.of(f"gyro_{name}") for name in ("white", "instability", "walk")]
        )
        self._accel = _Chain(
            device.accel, step_s, [streams.of(f"accel_{name}") for name in ("white", "instability", "walk")]
        )
        self._thermometer = _Lag(device.thermometer, step_s, streams.of("thermometer"))

    def read(self, scene: Scene, mean_rate_b: FloatArray) -> DeviceSaid:
        """Return the readings of the next moments.

        Parameters
        ----------
        scene : Scene
            n moments, each a step after the one before, also from call to call.
        mean_rate_b : array, shape (n, 3)
            Mean rate of the step before each, rad/s.

        Returns
        -------
        DeviceSaid
            n readings.
        """
        averaging = self.device.sampling.gyro_averaging == "interval"
        return DeviceSaid(
            self._gyro.read(mean_rate_b if averaging else scene.rate_b, scene),
            self._accel.read(scene.force_b, scene),
            self._thermometer.read(scene),
        )


class _Chain:
    """Three sensors and what they remember."""

    def __init__(self, chain: SensorChain, step_s: float, noise: list[np.random.Generator]) -> None:
        self._chain, self._step = chain, step_s
        self._white, self._flicker, self._walk = noise
        self._walked: FloatArray | None = None
        self._flickers: list[FloatArray] = []
        self._follower: float | None = None
        self._low: list[tuple[FloatArray, FloatArray]] = []
        self._low_state: list[FloatArray] = []
        if chain.low_pass:
            pairs = zip(chain.low_pass.cutoff_hz.tolist(), chain.low_pass.quality.tolist(), strict=True)
            self._low = [difference_equation(cutoff, quality, step_s) for cutoff, quality in pairs]

    def read(self, x: FloatArray, scene: Scene) -> FloatArray:
        chain = self._chain
        x = self._noisy(self._felt(x, scene))
        if chain.amplifier:
            x = amplified(x, chain.amplifier, chain.scale.nominal_sensitivity)[0]
        if self._low:
            x = self._low_passed(x)
        sensitivity, amplifier = chain.scale.nominal_sensitivity, chain.amplifier
        reading: FloatArray = amplifier.null + amplifier.gain * sensitivity * x if amplifier else sensitivity * x
        return converted(reading, chain.adc)[0] if chain.adc else reading

    def _felt(self, x: FloatArray, scene: Scene) -> FloatArray:
        """Return what the sensors make of the scene, free of noise."""
        chain = self._chain
        x = scaled(x, chain.scale, lever_arm_force(chain.lever_arm, scene) if chain.lever_arm else None)
        if chain.nonlinearity:
            x = bent(x, chain.nonlinearity)
        if chain.g_sensitivity:
            x = with_g(x, chain.g_sensitivity, scene)
        if chain.offset:
            x = with_offset(x, chain.offset, scene)
        if chain.thermal_scale:
            x = warmed(x, chain.thermal_scale, scene)
        if chain.rate_drift:
            x = x + chain.rate_drift.error(x, scene.warmth)
        if chain.warm_up:
            x = warming_up(x, chain.warm_up, scene)
        return x + self._hysteresis(scene) if chain.hysteresis else x

    def _hysteresis(self, scene: Scene) -> FloatArray:
        loop = self._chain.hysteresis
        if loop is None:
            return np.zeros((len(scene.time), 3))
        at = float(scene.temp_c[0]) if self._follower is None else self._follower
        behind = np.empty(len(scene.temp_c))
        for k, temp in enumerate(scene.temp_c.tolist()):
            at = min(max(at, temp - loop.play_k), temp + loop.play_k)
            behind[k] = (at - temp) / loop.play_k
        self._follower = at
        return np.outer(behind, loop.amplitude)

    def _noisy(self, x: FloatArray) -> FloatArray:
        chain = self._chain
        if chain.white_noise:
            x = x + self._white.standard_normal(x.shape) * (chain.white_noise.random_walk / math.sqrt(self._step))
        if chain.instability:
            x = x + self._flickering(len(x)) * chain.instability.instability * math.sqrt(math.log(RATIO) / math.pi)
        if chain.random_walk:
            steps = self._walk.standard_normal(x.shape) * (chain.random_walk.bias_walk * math.sqrt(self._step))
            if self._walked is None:  # the first reading has not walked yet
                self._walked, steps[0] = np.zeros(3), 0.0
            walked = self._walked + np.cumsum(steps, axis=0)
            self._walked = walked[-1]
            x = x + walked
        return x

    def _flickering(self, n: int) -> FloatArray:
        from scipy.signal import lfilter

        effect = self._chain.instability
        constants = [] if effect is None else effect.time_constants_s.tolist()
        if not self._flickers:
            self._flickers = [self._flicker.standard_normal(3) for _ in constants]
        total = np.zeros((n, 3))
        for k, constant in enumerate(constants):
            keep = math.exp(-self._step / constant)
            fresh = self._flicker.standard_normal((n, 3)) * math.sqrt(-math.expm1(-2.0 * self._step / constant))
            y = np.asarray(lfilter([1.0], [1.0, -keep], fresh, axis=0, zi=(keep * self._flickers[k])[None, :])[0])
            self._flickers[k] = y[-1]
            total += y
        return total

    def _low_passed(self, x: FloatArray) -> FloatArray:
        from scipy.signal import lfilter

        if not self._low_state:  # it had been resting before the first reading
            self._low_state = [
                np.array([1.0 - b[0], b[2] - a[2]]) * x[0, axis] for axis, (b, a) in enumerate(self._low)
            ]
        out = np.empty_like(x)
        for axis, (b, a) in enumerate(self._low):
            out[:, axis], self._low_state[axis] = lfilter(b, a, x[:, axis], zi=self._low_state[axis])
        return out


class _Lag:
    """The board thermometer and what it remembers."""

    def __init__(self, thermometer: Thermometer, step_s: float, noise: np.random.Generator) -> None:
        self._what, self._step, self._noise = thermometer, step_s, noise
        self._felt: float | None = None
        self._before = 0.0

    def read(self, scene: Scene) -> FloatArray:
        what = self._what
        felt = self._lagging(scene.temp_c)
        young = 1.0 if what.lag_s == 0.0 else -np.expm1(-scene.age_s / what.lag_s)
        felt = felt + what.self_heating_c * young
        said: FloatArray = felt + what.trim_error_c + what.slope_error * (felt - TRIM_TEMP_C)
        if what.noise_c > 0.0:
            said = said + self._noise.normal(0.0, what.noise_c, len(said))
        if what.step_c == 0.0:
            return said
        whole: FloatArray = rounded((said - what.zero_c) / what.step_c, what.rounding) * what.step_c + what.zero_c
        return whole

    def _lagging(self, temp: FloatArray) -> FloatArray:
        from scipy.signal import lfilter

        if self._what.lag_s == 0.0:
            return temp
        if self._felt is None:
            self._felt = self._before = float(temp[0])
        ratio = self._step / self._what.lag_s
        keep, mean = math.exp(-ratio), -math.expm1(-ratio) / ratio
        b = [1.0 - mean, mean - keep]
        felt = np.asarray(lfilter(b, [1.0, -keep], temp, zi=[keep * self._felt + b[1] * self._before])[0])
        self._felt, self._before = float(felt[-1]), float(temp[-1])
        return felt
