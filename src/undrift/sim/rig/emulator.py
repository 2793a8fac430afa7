"""Emulator: a rig that does not exist, on a real socket."""

from dataclasses import dataclass, field
from types import TracebackType
from typing import Literal, Self, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.rig.clock import Clock, HostClock
from undrift.sim.rig.faults import LINK_FAULTS, FaultyLink, check_fault
from undrift.sim.rig.galil.card import CardSettings
from undrift.sim.rig.galil.session import GalilMachine
from undrift.sim.rig.grbl.board import GrblSettings
from undrift.sim.rig.grbl.language import GrblMachine
from undrift.sim.rig.server import Server
from undrift.sim.rig.servo import ServoSettings

EmulatorKind = Literal["galil", "grbl"]
LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulatorSettings:
    """What is emulated, and where it listens.

    Parameters
    ----------
    kind : str
        galil (a servo card) or grbl (a stepper board).
    servo : ServoSettings
        Loop of the servo card.
    card : CardSettings
        The servo card.
    grbl : GrblSettings
        The stepper board.
    host : str
        A loopback address.
    port : int
        0 takes a free one.
    with_pty : bool
        True opens a pseudo terminal as well.
    speed : float
        Emulated seconds in one of the host's.
    history_s : float
        How far back the axis is remembered, emulated s.
    fault_seed : int
        Seed of the garbage on a faulty link.
    """

    kind: EmulatorKind = "galil"
    servo: ServoSettings = field(default_factory=ServoSettings)
    card: CardSettings = field(default_factory=CardSettings)
    grbl: GrblSettings = field(default_factory=GrblSettings)
    host: str = "127.0.0.1"
    port: int = 0
    with_pty: bool = False
    speed: float = 1.0
    history_s: float = 1200.0
    fault_seed: int = 0


class Emulator:
    """A running rig; a context manager that closes it.

    Parameters
    ----------
    settings : EmulatorSettings
        What is emulated.
    clock : Clock, optional
        Emulated time; the host's clock times `speed` unless given.

    Raises
    ------
    InputError
        A kind that is not one, or a host that is not a loopback address.
    """

    def __init__(self, settings: EmulatorSettings, clock: Clock | None = None) -> None:
        if settings.kind not in get_args(EmulatorKind):
            wanted = " or ".join(get_args(EmulatorKind))
            raise InputError(f"emulator kind: wanted {wanted}, got '{settings.kind}'; name one of them")
        if settings.host not in LOOPBACK:
            raise InputError(
                f"emulator host: wanted one of {', '.join(LOOPBACK)}, got '{settings.host}'; it serves this computer only"
            )
        GalilMachine(settings.servo, settings.card, HostClock()).card.axis.warm()
        chosen = clock or HostClock(settings.speed)
        self.settings, self.clock = settings, chosen
        self.machine: GalilMachine | GrblMachine
        if settings.kind == "galil":
            self.machine = GalilMachine(settings.servo, settings.card, chosen, settings.history_s)
        else:
            self.machine = GrblMachine(settings.grbl, chosen, settings.history_s)
        self._broken: set[str] = set()
        self._link = FaultyLink(settings.fault_seed)
        self._server = Server(self.machine, self._link, (settings.host, settings.port), settings.with_pty)
        self.host: str = self._server.host
        self.port: int = self._server.port
        self.pty_path: str | None = self._server.pty_path

    def __enter__(self) -> Self:
        """Return the emulator itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it.

        Parameters
        ----------
        kind, error, trace : object
            What ended the block.
        """
        self.close()

    def close(self) -> None:
        """Close every socket and end the thread; harmless when called again."""
        self._server.close()

    def now(self) -> float:
        """Return emulated time from the start, s."""
        return self.clock.now()

    @property
    def motor_on(self) -> bool:
        """Whether the motor holds the axis."""
        return self.machine.motor_on

    def axis_angle(self) -> float:
        """Return the true angle of the axis now, rad."""
        return self.machine.present()[0]

    def axis_rate(self) -> float:
        """Return the true turn rate of the axis now, rad/s."""
        return self.machine.present()[1]

    def axis_state(self, time: float, *, mean_s: float = 0.0) -> tuple[float, float]:
        """Return the true angle and turn rate at a moment of the past, or now.

        Parameters
        ----------
        time : float
            Emulated time, s, as `now` gives it.
        mean_s : float
            The rate is the mean of so long before, s; 0 for the momentary one, with the ripple of the servo in it.

        Returns
        -------
        angle, turn_rate : float
            rad, rad/s.

        Raises
        ------
        InputError
            A time to come, or one that is no longer kept.
        """
        angle, rate = self.axis_states(np.array([time]), mean_s=mean_s)
        return float(angle[0]), float(rate[0])

    def axis_states(self, times: FloatArray, *, mean_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return the true angle and turn rate at moments of the past.

        Parameters
        ----------
        times : array, shape (n,)
            Emulated times, s.
        mean_s : float
            The rate is the mean of so long before each, s; 0 for the momentary one.

        Returns
        -------
        angle, turn_rate : array, shape (n,)
            rad, rad/s.

        Raises
        ------
        InputError
            A time to come, or one that is no longer kept.
        """
        if not mean_s > 0.0:
            return self.machine.states(times)
        before = np.maximum(times - mean_s, 0.0)  # the axis rested before it was made
        angle, _ = self.machine.states(np.concatenate((times, before)))
        return angle[: len(times)], (angle[: len(times)] - angle[len(times) :]) / mean_s

    def history(self, last_s: float | None = None) -> tuple[FloatArray, FloatArray]:
        """Return where the axis has been.

        Parameters
        ----------
        last_s : float or None
            Only so much of it, emulated s.

        Returns
        -------
        time, angle : array, shape (n,)
            s, rad.
        """
        return self.machine.history(last_s)

    def inject(self, fault: str, *, answers: int | None = None) -> None:
        """Let a fault begin; the names and what each does stand in faults.py.

        Parameters
        ----------
        fault : str
            Name of the fault.
        answers : int or None
            How many answers a fault of the link strikes; None until it is cleared.

        Raises
        ------
        InputError
            Not one of the faults.
        """
        check_fault(fault)
        if fault in LINK_FAULTS:
            self._link.start(fault, answers)
        else:
            self.machine.set_fault(fault, True)
            self._broken.add(fault)
        if fault == "power_cut":
            self._server.set_dark(True)
        self._server.settle()

    def clear(self, fault: str | None = None) -> None:
        """Let a fault end; after a power cut the rig starts afresh.

        Parameters
        ----------
        fault : str or None
            Which; None for all.

        Raises
        ------
        InputError
            Not one of the faults.
        """
        if fault is not None:
            check_fault(fault)
        self._link.stop(fault)
        for name in sorted(self._broken & ({fault} if fault else self._broken)):
            self.machine.set_fault(name, False)
            self._broken.discard(name)
        self._server.set_dark("power_cut" in self._broken)
        self._server.settle()


def start_emulator(settings: EmulatorSettings | None = None, *, clock: Clock | None = None) -> Emulator:
    """Start an emulated rig; use it in a `with` block, or close it.

    Parameters
    ----------
    settings : EmulatorSettings, optional
        What is emulated.
    clock : Clock, optional
        A HandClock makes it repeatable.

    Returns
    -------
    Emulator
        Listening.

    Raises
    ------
    InputError
        A kind that is not one, or a host that is not a loopback address.
    """
    return Emulator(settings or EmulatorSettings(), clock)
