"""Readings of a simulated device as time goes on, chunk by chunk.

With the device's clock in error by c, reading k is taken at k / (rate (1 + c)).
"""

from collections.abc import Callable

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.sim.device.effects import Past, Scene, SensorChain
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import draw_streams

# Surroundings at times (n,), s, with the step before each: rate, angular acceleration, force, mean rate over the step (n, 3), and
# the temperature of the board (n,)
Seen = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
Surroundings = Callable[[FloatArray, float], Seen]


class SimulatedDevice:
    """A device that is read at even steps of its own clock. The state of its effects is carried from one chunk to the next."""

    def __init__(
        self, model: DeviceModel, surroundings: Surroundings, seed: int, start_s: float, *, power_on_s: float = 3600.0
    ) -> None:
        self.model, self.rate = model, model.sampling.sample_rate_hz or 100.0
        self.step_s = 1.0 / (self.rate * (1.0 + model.sampling.clock_error))
        self._surroundings, self._power_on_s = surroundings, power_on_s
        self._next = 1 + int(start_s / self.step_s + 1e-6)  # reading k is taken at k steps
        streams = draw_streams(np.random.default_rng(seed))
        self._pasts = {name: streams.pasts(getattr(model, name), name) for name in ("gyro", "accel")}
        for name, pasts in self._pasts.items():
            if flicker := getattr(model, name).instability:
                past = pasts["instability"]
                past.state = past.rng.standard_normal((len(flicker.time_constants_s), 3))
        self._thermometer = Past(streams.of("thermometer"))

    def read(self, now: float) -> tuple[IntArray, FloatArray]:
        """Return number and values of the readings up to now: (n,), (n, 7) of both triads and the thermometer."""
        counts = np.arange(self._next, int(now / self.step_s + 1e-6) + 1)
        if not counts.size:
            return counts, np.empty((0, 7))
        self._next = int(counts[-1]) + 1
        times, model = np.minimum(counts * self.step_s, now), self.model
        rate, acceleration, force, mean_rate, temp_c = self._surroundings(times, self.step_s)
        scene = Scene(
            time=times,
            step_s=self.step_s,
            temp_c=temp_c,
            warmth=temp_c - model.reference_temp_c,
            age_s=times + self._power_on_s,
            rate_b=rate,
            angular_acceleration_b=acceleration,
            force_b=force,
        )
        readings = []
        for name, true in (
            ("gyro", mean_rate if model.sampling.gyro_averaging == "interval" else rate),
            ("accel", force),
        ):
            chain: SensorChain = getattr(model, name)
            *_, (_, x) = chain.stages(true, scene, self._pasts[name])
            readings.append(chain.converted(x)[0])
        felt_c = model.thermometer.felt(scene, self._thermometer)
        return counts, np.column_stack((*readings, model.thermometer.shown(felt_c, self._thermometer.rng)))
