"""Readings of a simulated device as time goes on, chunk by chunk.

With the device's clock in error by c, reading k is taken at k / (rate (1 + c)).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.sim.device.effects import Past, Scene, converted
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import draw_streams


class CausalDevice:
    """A device that is read as time goes on: what its effects remember is carried from one chunk to the next."""

    def __init__(self, device: DeviceModel, step_s: float, rng: np.random.Generator) -> None:
        streams = draw_streams(rng)
        self.device, self._step = device, step_s
        self._chains = [
            (chain, streams.pasts(chain, name)) for chain, name in ((device.gyro, "gyro"), (device.accel, "accel"))
        ]
        for chain, pasts in self._chains:
            if chain.instability:
                past = pasts["instability"]
                past.state = past.rng.standard_normal((len(chain.instability.time_constants_s), 3))
        self._thermometer = Past(streams.of("thermometer"))

    def read(self, scene: Scene, mean_rate_b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the next readings of gyroscopes, accelerometers (n, 3) and thermometer (n,): mean_rate_b (n, 3) rad/s."""
        averaging, thermometer = self.device.sampling.gyro_averaging == "interval", self.device.thermometer
        scene, read = replace(scene, step_s=self._step), []
        moved = (mean_rate_b if averaging else scene.rate_b, scene.force_b)
        for (chain, pasts), x in zip(self._chains, moved, strict=True):
            *_, (_, felt) = chain.stages(x, scene, pasts)
            read.append(converted(chain.reading(felt), chain.adc)[0] if chain.adc else chain.reading(felt))
        return read[0], read[1], thermometer.shown(thermometer.felt(scene, self._thermometer), self._thermometer.rng)


# At moments (n,) s, with the step before each: rate, angular acceleration, force, mean rate over the step (n, 3), and the
# temperature of the board (n,)
Seen = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
Surroundings = Callable[[FloatArray, float], Seen]


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
        rate, acceleration, force, mean_rate, temp = self._surroundings(times, self.step_s)
        scene = Scene(
            time=times,
            step_s=self.step_s,
            temp_c=temp,
            warmth=temp - self.model.reference_temp_c,
            age_s=times + self._power_on_s,
            rate_b=rate,
            angular_acceleration_b=acceleration,
            force_b=force,
        )
        return counts, np.column_stack(self._device.read(scene, mean_rate))
