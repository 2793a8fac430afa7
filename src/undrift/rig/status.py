"""Where a Galil table stands and what is wrong with it, read beside whoever drives it: nothing is set and nothing stops."""

from dataclasses import dataclass

from undrift.errors import InputError
from undrift.rig.address import RigSettings, parse_address
from undrift.rig.galil.port import LinkPort
from undrift.rig.galil.reports import GalilReports, GalilSettings
from undrift.rig.link import LinkSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """What a table says.

    Parameters
    ----------
    identity : str
        Model and firmware.
    moving, motor_on : bool
        Of the axis.
    angle : float
        Of the position register, rad.
    following_error : float
        Commanded minus actual, rad.
    fault : str or None
        In words.
    """

    identity: str
    moving: bool
    motor_on: bool
    angle: float
    following_error: float
    fault: str | None


def read_status(address: str) -> Status:
    """Ask a table on a connection of its own.

    Parameters
    ----------
    address : str
        Of a Galil rig on TCP or a serial port.

    Returns
    -------
    Status
        What it says.

    Raises
    ------
    InputError
        Another kind of rig, which cannot be asked without being reset.
    RigError
        It is not there, or makes no sense.
    """
    kind, url, settings = parse_address(address, RigSettings())
    if kind != "galil" or url.startswith("gclib:"):
        raise InputError(
            f"status: wanted a Galil card on TCP or serial, got '{address}'; others cannot be asked unharmed"
        )
    links = LinkSettings(
        reply_timeout_s=settings.reply_timeout_s,
        baud=settings.baud or 19200,
        hardware_handshake=settings.hardware_handshake,
    )
    port = LinkPort(url, links)
    try:
        port.resynchronise()
        rig = GalilReports(port, GalilSettings(encoder_lines=settings.encoder_lines, axis=settings.axis or "X"))
        axis = rig.card.axis
        return Status(
            identity=rig.identify(),
            moving=bool(rig.card.integer(f"MG _BG{axis}", 0, 1)),
            motor_on=not rig.card.integer(f"MG _MO{axis}", 0, 1),
            angle=rig.position().angle,
            following_error=rig.following_error(),
            fault=rig.fault(),
        )
    finally:
        port.close()
