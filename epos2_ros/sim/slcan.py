"""The device side of an slcan adapter (LAWICEL ASCII protocol) on a pseudo-terminal.

To python-can a bus like any other; whoever opens the terminal `path` sees a serial CAN
adapter with that bus behind it.
Source: LAWICEL AB, CANUSB manual 1.0, "CANUSB Commands".
"""

from __future__ import annotations

import os
import select
import time
import tty

import can

from .terminal_reader import TerminalReader

OK, ERROR = b"\r", b"\a"
_BITRATES = (10, 20, 50, 100, 125, 250, 500, 800, 1000)  # kbit/s, by the digit after S
_VERSION = b"V1013\r"  # hardware 1.0, software 1.3
_SERIAL = b"NE201\r"
_NO_FLAGS = b"F00\r"
_LONGEST_COMMAND = 32


class SlcanAdapter(can.BusABC):
    """Frames from the terminal come out of `recv`, frames given to `send` go to the terminal."""

    def __init__(self, bus_bitrate: int | None = None) -> None:
        """`bus_bitrate` [bit/s]: an adapter at another one hears nothing; None: at any."""
        self._bus_bitrate = bus_bitrate
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # kept open, so that the terminal outlives its users
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self.bitrate: int | None = None  # [kbit/s]
        self._open = False
        self._listen_only = False
        self._time_stamps = False
        self._input = bytearray()
        self._came_s = 0.0  # when the last of it came, by the wall clock
        self._reader = TerminalReader(self._master)
        super().__init__(self.path)
        self.channel_info = f"slcan adapter on {self.path}"

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """A frame from the bus. Raises `CanOperationError` while nobody reads the terminal."""
        if not self._open or not self._in_tune:
            return  # a closed adapter hears nothing
        line = f"{'r' if msg.is_remote_frame else 't'}{msg.arbitration_id:03X}{msg.dlc}"
        if not msg.is_remote_frame:
            line += msg.data.hex().upper()
        if self._time_stamps:
            line += f"{int(time.monotonic() * 1000) % 60_000:04X}"
        self._write(line.encode() + b"\r")

    def _write(self, line: bytes) -> None:
        try:
            written = os.write(self._master, line)
            while written < len(line):  # never half a line
                select.select([], [self._master], [])
                written += os.write(self._master, line[written:])
        except BlockingIOError as error:
            raise can.CanOperationError("terminal full: nobody reads it") from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        message = self._next_frame()
        if message is None and (more := self._more(timeout)):
            self._came_s, data = more
            self._input += data
            message = self._next_frame()
        return message, False

    def _more(self, timeout: float | None) -> tuple[float, bytes] | None:
        try:
            return self._reader.read(timeout)
        except OSError as error:
            raise can.CanOperationError(str(error)) from error

    def _next_frame(self) -> can.Message | None:
        """Carries out commands up to the first that puts a frame on the bus."""
        while True:
            line, end, rest = self._input.partition(b"\r")
            if not end:
                if len(line) > _LONGEST_COMMAND:
                    self._input.clear()
                return None
            self._input = rest
            message = self._command(line.lstrip(b"\n").decode("ascii", "replace"))
            if message is not None:
                return message

    def _command(self, line: str) -> can.Message | None:
        message = None
        if line[:1] in ("t", "T", "r", "R"):
            sends = self._open and self._in_tune and not self._listen_only
            message = self._parse(line) if sends else None
            answer = (b"z\r" if line[0] in "tr" else b"Z\r") if message else ERROR
        else:
            answer = self._set_up(line)
        self._write(answer)
        return message

    @property
    def _in_tune(self) -> bool:
        return self._bus_bitrate is None or (self.bitrate or 0) * 1000 == self._bus_bitrate

    def _set_up(self, line: str) -> bytes:
        """Everything but frames."""
        command, argument = line[:1], line[1:]
        if command == "":
            return OK
        if command == "S" and not self._open and argument in tuple("012345678"):
            self.bitrate = _BITRATES[int(argument)]
            return OK
        if command == "s" and not self._open and len(argument) == 4:
            return OK  # bit timing registers: any
        if command in ("O", "L") and not self._open:
            self._open, self._listen_only = True, command == "L"
            return OK
        if command == "C" and self._open:
            self._open = False
            return OK
        if command == "Z" and not self._open and argument in ("0", "1"):
            self._time_stamps = argument == "1"
            return OK
        if command in ("M", "m") and not self._open and len(argument) == 8:
            return OK  # acceptance filters: everything passes
        return {"V": _VERSION, "N": _SERIAL, "F": _NO_FLAGS}.get(line, ERROR)

    def _parse(self, line: str) -> can.Message | None:
        """A transmit command: tIIIL…, TIIIIIIIIL…, and r, R without data."""
        extended, remote = line[0] in "TR", line[0] in "rR"
        digits = 8 if extended else 3
        try:
            can_id, length = int(line[1 : 1 + digits], 16), int(line[1 + digits : 2 + digits])
            data = bytes.fromhex(line[2 + digits :])
        except ValueError:
            return None
        if length > 8 or len(data) != (0 if remote else length):
            return None
        return can.Message(
            timestamp=self._came_s,
            arbitration_id=can_id,
            is_extended_id=extended,
            is_remote_frame=remote,
            dlc=length,
            data=None if remote else data,
        )

    def shutdown(self) -> None:
        super().shutdown()
        self._reader.close()
        os.close(self._master)
        os.close(self._slave)
