"""Session: the bytes of one client of a card, in both directions, and the machine that clients share."""

import threading

from undrift.arrays import FloatArray
from undrift.sim.rig.clock import Clock
from undrift.sim.rig.galil.card import Card, CardSettings
from undrift.sim.rig.galil.language import execute
from undrift.sim.rig.galil.program import Program
from undrift.sim.rig.galil.words import BUFFER_FULL, SERIAL_TIMEOUT, STOP_ABORT_INPUT, Refused
from undrift.sim.rig.servo import ServoSettings


class GalilMachine:
    """A card, its clock and its programs, for any number of clients.

    Parameters
    ----------
    servo : ServoSettings
        The loop.
    settings : CardSettings
        Which card.
    clock : Clock
        Emulated time.
    history_s : float
        How far back the axis is remembered, s.
    """

    def __init__(self, servo: ServoSettings, settings: CardSettings, clock: Clock, history_s: float = 1200.0) -> None:
        self.card = Card(servo, settings, history_s)
        self.program = Program(self.card)
        self.clock = clock
        self.lock = threading.RLock()
        self._sessions: list[GalilSession] = []

    def open_session(self, serial: bool) -> "GalilSession":
        """Return what a new client talks to.

        Parameters
        ----------
        serial : bool
            True for a serial link.

        Returns
        -------
        GalilSession
            Its end of the link.
        """
        with self.lock:
            session = GalilSession(self, serial)
            self._sessions.append(session)
            return session

    def close_session(self, session: object) -> None:
        """Forget a client; the card goes on with what it was told.

        Parameters
        ----------
        session : GalilSession
            Which.
        """
        with self.lock:
            self._sessions = [kept for kept in self._sessions if kept is not session]

    def tick(self) -> None:
        """Bring card and programs up to now, and hand out what nobody asked for."""
        with self.lock:
            self.program.advance(self.clock.now())
            while self.card.unsolicited:
                text = self.card.unsolicited.popleft()
                for session in self._sessions:
                    session.tell(text)

    @property
    def motor_on(self) -> bool:
        """Whether the servo holds the axis."""
        with self.lock:
            self.tick()
            return self.card.motor_on and self.card.wiring.powered

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return angle and rate of the axis, rad and rad/s, shape (n,).

        Parameters
        ----------
        times : array, shape (n,)
            Emulated times, s, up to now.
        """
        with self.lock:
            self.tick()
            return self.card.axis.states(times)

    def present(self) -> tuple[float, float]:
        """Return angle and rate of the axis now, rad and rad/s."""
        with self.lock:
            self.tick()
            _, angle, rate = self.card.axis.history(0.0)
            return float(angle[-1]), float(rate[-1])

    def history(self, last_s: float | None = None) -> tuple[FloatArray, FloatArray]:
        """Return time and angle of the kept past, s and rad, shape (n,).

        Parameters
        ----------
        last_s : float or None
            Only so much of it, s.
        """
        with self.lock:
            self.tick()
            time, angle, _ = self.card.axis.history(last_s)
            return time, angle

    def set_fault(self, name: str, on: bool) -> None:
        """Break or mend a part of the card or of its wiring.

        Parameters
        ----------
        name : str
            One of RIG_FAULTS.
        on : bool
            True breaks it.
        """
        with self.lock:
            self.tick()
            wiring = self.card.wiring
            if name == "amplifier_fault":
                wiring.amplifier_fault = on
            elif name == "encoder_loss":
                wiring.encoder_lost = on
            elif name == "limit_switch":
                wiring.forward_pressed = on
            elif name == "limit_switch_reverse":
                wiring.reverse_pressed = on
            elif name == "power_cut":
                self._power(not on)
            elif name == "message" and on:
                self.card.unsolicited.append("EMULATED MESSAGE\r\n")
            elif name == "abort_input" and on:
                self._abort_input()
            self.card.apply()
            self.tick()

    def _power(self, on: bool) -> None:
        self.card.wiring.powered = on
        self.program.halt()
        self.card.abort()
        self.card.set_up()
        for session in self._sessions:
            session.forget()

    def _abort_input(self) -> None:
        self.program.halt()
        self.card.abort(STOP_ABORT_INPUT)
        if self.card.values["OE"] in (1.0, 3.0):
            self.card.motor(False)


class GalilSession:
    """One client's bytes.

    Parameters
    ----------
    machine : GalilMachine
        The card behind it.
    serial : bool
        True for a serial link, which may echo and which times out.
    """

    def __init__(self, machine: GalilMachine, serial: bool) -> None:
        self._machine = machine
        self._serial = serial
        self._unasked = b""
        self.forget()
        if serial and machine.card.settings.echo_serial:
            machine.card.values["EO"] = 1.0

    def forget(self) -> None:
        """Drop the line in progress."""
        self._line = ""
        self._quoted = self._dropping = self._downloading = False
        self._begun: float | None = None

    def greet(self) -> bytes:
        """Return what the card says to a new client: nothing."""
        return b""

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes from the client.

        Parameters
        ----------
        data : bytes
            Any.

        Returns
        -------
        list of bytes
            An answer for each command that they completed, and echoes.
        """
        machine = self._machine
        with machine.lock:
            machine.tick()
            if not machine.card.wiring.powered:
                return []
            answers = []
            for letter in data.decode("latin-1"):
                if self._serial and machine.card.values["EO"] == 1.0:
                    answers.append(letter.encode("latin-1"))
                answers += self._take(letter)
            machine.tick()
            return [answer for answer in answers if answer]

    def unasked(self) -> bytes:
        """Return what the card says without being asked, since the last look."""
        with self._machine.lock:
            self._time_out()
            data, self._unasked = self._unasked, b""
            return data

    def tell(self, text: str) -> None:
        """Queue a message; CW1 sets the high bit of each character.

        Parameters
        ----------
        text : str
            The message.
        """
        data = text.encode("latin-1", "replace")
        if self._machine.card.values["CW"] == 1.0:
            data = bytes(byte | 0x80 for byte in data)
        self._unasked += data

    def _take(self, letter: str) -> list[bytes]:
        if letter == "\n":
            return []
        if self._downloading:
            return self._download(letter)
        if letter == "\r" or (letter == ";" and not self._quoted):
            line, self._line, self._quoted, self._begun = self._line, "", False, None
            dropped, self._dropping = self._dropping, self._dropping and letter == ";"
            return [] if dropped else [self._answer(line, letter)]
        if self._dropping:
            return []
        if not self._line:
            self._begun = self._machine.clock.now()
        self._line += letter
        self._quoted ^= letter == '"'
        if len(self._line) > self._machine.card.settings.line_length:
            return [self._refuse(BUFFER_FULL, ";")]
        return []

    def _answer(self, line: str, end: str) -> bytes:
        card = self._machine.card
        try:
            text = self._machine.program.command(line)
            if text == "DL":  # no prompt until the program has come
                self._downloading = True
                return b""
            if text is None:
                text = execute(card, line)
        except Refused as refusal:
            return self._refuse(refusal.code, end)
        return (text + ":").encode("latin-1", "replace")

    def _refuse(self, code: int, end: str) -> bytes:
        self._machine.card.error_code = code
        self._line, self._quoted, self._begun = "", False, None
        self._dropping = end == ";"
        return b"?"

    def _download(self, letter: str) -> list[bytes]:
        if letter not in "\\\x1a":
            self._line += letter
            return []
        text, self._line, self._downloading = self._line, "", False
        try:
            self._machine.program.load(text)
        except Refused as refusal:
            return [self._refuse(refusal.code, "\r")]
        return [b":"]

    def _time_out(self) -> None:
        machine = self._machine
        late = self._begun is not None and machine.clock.now() - self._begun > machine.card.settings.serial_timeout_s
        if self._serial and late:
            self._unasked += self._refuse(SERIAL_TIMEOUT, "\r")
