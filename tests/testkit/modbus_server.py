"""A controller of a chamber behind pymodbus's own server, on loopback; it heats, in registers that the test names."""

import asyncio
import struct
import threading
import time

from pymodbus.framer import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice


class Controller:
    """Serves 33,000 registers; the reading follows the set-point while the control is on."""

    def __init__(
        self, *, read, wanted, kind, low_first=False, gain=1.0, on=None, held=None, rate_per_s=200.0, rtu=False
    ):
        self.read, self.wanted, self.kind, self.low_first, self.gain, self.on = read, wanted, kind, low_first, gain, on
        self.registers = dict(held or {})
        self.temp, self.rate_per_s, self.refuse = 20.0, rate_per_s, set()
        self._last = time.monotonic()
        self.put(read, self.temp)
        self.put(wanted, self.temp)
        self._ready = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._framer = FramerType.RTU if rtu else FramerType.SOCKET
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        assert self._ready.wait(10.0)

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        asyncio.run_coroutine_threadsafe(self._server.shutdown(), self._loop).result(10.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10.0)
        self._loop.close()

    def number(self, at):
        """Return what a register, or two, hold."""
        if self.kind == "int16":
            return struct.unpack(">h", struct.pack(">H", self.registers.get(at, 0)))[0] * self.gain
        words = [self.registers.get(at, 0), self.registers.get(at + 1, 0)]
        return struct.unpack(">f", struct.pack(">HH", *(words[::-1] if self.low_first else words)))[0]

    def put(self, at, value):
        """Keep a number in a register, or two."""
        if self.kind == "int16":
            self.registers[at] = round(value / self.gain) & 0xFFFF
            return
        words = struct.unpack(">HH", struct.pack(">f", value))
        self.registers[at], self.registers[at + 1] = words[::-1] if self.low_first else words

    async def _act(self, function, block, start, count, current, given):
        now = time.monotonic()
        if self.on is None or self.registers.get(self.on[0], 0) == self.on[1]:
            most = self.rate_per_s * (now - self._last)
            self.temp += min(max(self.number(self.wanted) - self.temp, -most), most)
        self._last = now
        self.put(self.read, self.temp)
        if start in self.refuse:
            return self._refusal
        for k, word in enumerate(given or ()):
            self.registers[start + k] = int(word)
        for k in range(count):
            current[start - block + k] = self.registers.get(start + k, 0)
        return None

    def _run(self):
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._begin())
        self._ready.set()
        self._loop.run_forever()

    async def _begin(self):
        from pymodbus.constants import ExcCodes

        self._refusal = ExcCodes.ILLEGAL_ADDRESS
        block = SimData(address=0, count=33_000, values=0, datatype=DataType.REGISTERS)
        device = SimDevice(id=1, simdata=[block], action=self._act)
        self._server = ModbusTcpServer(device, address=("127.0.0.1", 0), framer=self._framer)
        await self._server.serve_forever(background=True)
        self.port = self._server.transport.sockets[0].getsockname()[1]
