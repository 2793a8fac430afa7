"""DeviceModel: a device told by what it physically is: two sensor chains, a board thermometer, a clock.

Every effect is a value of its own in a file of its own; ``simulate.py`` composes them. No matrix is inverted here; the
correction undrift fits is another set of equations.
"""

from dataclasses import dataclass, replace

from undrift.sim.device.chain import SensorChain
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.sampling import Sampling
from undrift.sim.device.thermometer import Thermometer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DeviceModel:
    """Three gyroscopes, three accelerometers, a thermometer and a clock.

    Parameters
    ----------
    serial : str
        Serial number.
    gyro, accel : SensorChain
        The sensors.
    thermometer : Thermometer
        The board thermometer.
    sampling : Sampling
        The clock.
    reference_temp_c : float
        Temperature at which the offsets are stated, degC.
    name : str
        Kind of device.
    source_tag : str
        How far its figures are to be trusted: note, found, calc, known, known-low, assumed; "drawn" or "fitted" for a unit.
    """

    serial: str = quantity("")
    gyro: SensorChain = quantity("")
    accel: SensorChain = quantity("")
    thermometer: Thermometer = quantity("", None, Thermometer())
    sampling: Sampling = quantity("", None, Sampling())
    reference_temp_c: float = quantity("", None, 25.0)
    name: str = quantity("", None, "")
    source_tag: str = quantity("", None, "assumed")

    def __post_init__(self) -> None:
        settle(self)

    def without_noise(self) -> "DeviceModel":
        """Return the same device with no noise, no jitter, no rounding and no end to its range.

        Returns
        -------
        DeviceModel
            Deterministic.
        """
        return replace(
            self,
            gyro=self.gyro.without_noise(),
            accel=self.accel.without_noise(),
            thermometer=replace(self.thermometer, noise_c=0.0, step_c=0.0),
            sampling=replace(self.sampling, jitter_s=0.0),
        )
