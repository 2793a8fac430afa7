"""Readings of a simulated device as time goes on, chunk by chunk.

With the device's clock in error by c, reading k is taken at k / (rate (1 + c)).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.sim.device.effects import Past, Scene
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import draw_streams

# Surroundings at times (n,), s, with the step before each: rate, angular acceleration, force, mean rate over the step (n, 3), and
# the temperature of the board (n,)
Seen = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
Surroundings = Callable[[FloatArray, float], Seen]


class CausalDevice:
    """A device that is read as time goes on: the state of its effects is carried from one chunk to the next."""

    def __init__(self, device: DeviceModel, step_s: float, rng: np.random.Generator) -> None:
        streams = draw_streams(rng)
        self.device, self._step = device, step_s
        self._pasts = {name: streams.pasts(getattr(device, name), name) for name in ("gyro", "accel")}
        for name, pasts in self._pasts.items():
            if flicker := getattr(device, name).instability:
                past = pasts["instability"]
                past.state = past.rng.standard_normal((len(flicker.time_constants_s), 3))
        self._thermometer = Past(streams.of("thermometer"))

    def read(self, scene: Scene, mean_rate_b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the next readings of gyroscopes, accelerometers (n, 3) and thermometer (n,): mean_rate_b (n, 3) rad/s."""
        device, scene = self.device, replace(scene, step_s=self._step)
        rate = mean_rate_b if device.sampling.gyro_averaging == "interval" else scene.rate_b
        readings = []
        for name, true in (("gyro", rate), ("accel", scene.force_b)):
            chain = getattr(device, name)
            *_, (_, x) = chain.stages(true, scene, self._pasts[name])
            readings.append(chain.converted(x)[0])
        felt_c = device.thermometer.felt(scene, self._thermometer)
        return readings[0], readings[1], device.thermometer.shown(felt_c, self._thermometer.rng)


class SimulatedDevice:
    """A device that is read at even steps of its own clock, whatever surrounds it."""

    def __init__(
        self, model: DeviceModel, surroundings: Surroundings, seed: int, start_s: float, *, power_on_s: float = 3600.0
    ) -> None:
        self.model, self.rate = model, model.sampling.sample_rate_hz or 100.0
        self.step_s = 1.0 / (self.rate * (1.0 + model.sampling.clock_error))
        self._surroundings, self._power_on_s = surroundings, power_on_s
        self._device = CausalDevice(model, self.step_s, np.random.default_rng(seed))
        self._next = 1 + int(start_s / self.step_s + 1e-6)  # reading k is taken at k steps

    def read(self, now: float) -> tuple[IntArray, FloatArray]:
        """Return number and values of the readings up to now: (n,), (n, 7) of both triads and the thermometer."""
        counts = np.arange(self._next, int(now / self.step_s + 1e-6) + 1)
        if not counts.size:
            return counts, np.empty((0, 7))
        self._next = int(counts[-1]) + 1
        times = np.minimum(counts * self.step_s, now)
        rate, acceleration, force, mean_rate, temp_c = self._surroundings(times, self.step_s)
        scene = Scene(
            time=times,
            step_s=self.step_s,
            temp_c=temp_c,
            warmth=temp_c - self.model.reference_temp_c,
            age_s=times + self._power_on_s,
            rate_b=rate,
            angular_acceleration_b=acceleration,
            force_b=force,
        )
        return counts, np.column_stack(self._device.read(scene, mean_rate))
