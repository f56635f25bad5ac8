"""The CAN interface: python-can at the edge, frames with host times inside.

One thread takes frames from the interface and hands each to the reactor, which alone sends.
canopen's classes use the same way out, so that an SDO request never gets ahead of a SYNC.
"""

from __future__ import annotations

import errno
import logging
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import can
import canopen

from epos2_ros.bus.health import BusState, Health
from epos2_ros.bus.realtime import Scheduling
from epos2_ros.bus.slcan import SlcanBus
from epos2_ros.bus.timestamps import ReceiveClock, now_us
from epos2_ros.bus.transmitter import Transmitter, worst_case_bits
from epos2_ros.errors import BusError
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.intake import SDO_RESPONSE, Intake
from epos2_ros.receive_buffer import deepen

MAX_UNREADABLE = 10  # in a row: then the interface does not work any more
PROBE_TIMEOUT_S = 0.2
RECEIVE_TIMEOUT_S = 0.1  # so often the receiving thread looks whether it is to end
LOAD_WINDOW_US = 1_000_000.0
ENTER_PRE_OPERATIONAL = Frame(0x000, b"\x80\x00")  # NMT, all nodes
SWAMPED = (
    "brings more than this computer gets to: reduce what else is on this bus, or what else the "
    "computer does"
)
_QUEUE_FULL = {errno.ENOBUFS, errno.EAGAIN}

OnFrame = Callable[[Frame, float, bool], None]
OnOther = Callable[[str, int, bytes, float], None]


class Network(canopen.Network):
    """canopen's network, sending by a function of ours instead of a bus of its own."""

    def __init__(self, send: Callable[[Frame], None]) -> None:
        super().__init__()
        self._send_frame = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._send_frame(Frame(can_id, bytes(data), remote))


class Link:
    """An open CAN interface.

    `on_frame(frame, t_us, echo)` is called for every frame on the bus that `intake` accepts, and
    for our own (`echo`); `on_other(kind, can_id, data, t_us)` for the rest ("error", "remote",
    "extended", "fd", "dropped"); `on_disturbance(text)` when the bus gets bad; `on_failure(text)`,
    once, when nothing gets through any more: then open a new link. All by `post`, which runs a job
    in the thread that owns this object, as everything but `network` has to be; what comes in by
    `offer`, which does unless too much waits to be run already. Then the link has failed.
    `priority`: of SCHED_FIFO, which the receiving thread takes; 0: an ordinary thread.
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        bitrate: int,
        intake: Intake,
        on_frame: OnFrame,
        on_disturbance: Callable[[str], None],
        on_failure: Callable[[str], None],
        post: Callable[[Callable[[], None]], None],
        offer: Callable[[Callable[[], None]], bool],
        on_other: OnOther = lambda kind, can_id, data, t_us: None,
        priority: int = 0,
    ) -> None:
        self.name = f"{interface}:{channel}"
        self.clock = ReceiveClock()
        self.network = Network(lambda frame: post(lambda: self.send(frame)))
        self.health = Health()
        self.failed = False
        self._post = post
        self._offer = offer
        self._intake = intake
        self._on_frame = on_frame
        self._on_disturbance = on_disturbance
        self._on_failure = on_failure
        self._on_other = on_other
        self._bitrate = bitrate
        self._listening = True  # only
        self._probing = False  # and our frame has not come back yet
        self._echo_seen = threading.Event()
        self._heard_us = now_us()  # up to when the bus was listened to
        self._traffic: deque[tuple[float, int]] = deque()
        self._bits = 0
        self._bus = open_bus(interface, channel, bitrate)
        if isinstance(self._bus, SlcanBus):
            self._bus.on_reject = self._reject
        # Until the probe has shown an echo, frames count as sent when their time is over.
        self._transmitter = Transmitter(self._hand_over, bitrate, echoes=False)
        self._pumping = False
        self._closing = False
        self._scheduling = Scheduling(priority)
        self._swamped = False  # something that came in was not taken
        self._receiver = threading.Thread(target=self._receive, name="CAN receiver", daemon=True)
        self._receiver.start()

    def probe(self) -> None:
        """Send what bring-up begins with anyway, and see whether the adapter gives it back.

        Until then only to be listened to. BusError if no frame can be sent; the link is closed.
        """
        self._probing = True
        if not self._hand_over(ENTER_PRE_OPERATIONAL):
            self.close()
            raise BusError(f"{self.name} takes no frames: is the interface up, the bus wired?")
        self._transmitter.echoes = self._echo_seen.wait(PROBE_TIMEOUT_S)
        self._listening = False

    # ------------------------------------------------------------------ out

    def send(self, frame: Frame) -> None:
        """Queue a frame and send what may be sent; before the probe is over, nothing is."""
        if not self.failed and not self._listening:
            self._intake.sending(frame)
            self._transmitter.push(frame)
            self.pump()

    def pump(self) -> None:
        """Send what may be sent now; call again at `deadline_us`."""
        if self._pumping:  # asked by `on_frame`: below the next are told, in their order
            return
        self._pumping = True
        try:
            while through := self._transmitter.pump(now_us(), self._heard_us):
                for frame, t_us in through:
                    self._count(frame, t_us)
                    self._on_frame(frame, t_us, True)
        finally:
            self._pumping = False
        if self._transmitter.stalled:
            self.fail(
                "no longer puts frames on the bus: check the cable, its termination and whether "
                "any drive is powered"
            )

    @property
    def deadline_us(self) -> float:
        return self._transmitter.deadline_us

    @property
    def dropped(self) -> int:
        """Frames handed to the adapter that never appeared on the bus."""
        return self._transmitter.dropped

    @property
    def refused(self) -> int:
        """How often the adapter's queue was full."""
        return self._transmitter.refused

    @property
    def echoes(self) -> bool:
        """Whether the adapter gives our own frames back."""
        return self._transmitter.echoes

    @property
    def time_source(self) -> str:
        """Where the time of a SYNC comes from."""
        return ("echo, " if self._transmitter.echoes else "no echo, ") + self.clock.source

    def _hand_over(self, frame: Frame) -> bool:
        message = can.Message(
            arbitration_id=frame.can_id,
            data=None if frame.remote else frame.data,
            is_remote_frame=frame.remote,
            is_extended_id=False,
            check=False,
        )
        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            if not queue_is_full(error):
                self._post(partial(self.fail, f"can't send: {error}"))
            return False
        return True

    def fail(self, text: str) -> None:
        """Send nothing any more: something is wrong that only a new link can put right."""
        if not self.failed:
            self.failed = True
            self._transmitter.reset()  # stale frames would be sent when the bus is back
            self._on_failure(f"{self.name} {text}")

    # ------------------------------------------------------------------ in

    def _receive(self) -> None:
        unreadable: list[str] = []  # in a row
        self._scheduling.begin()
        while not self._closing:
            self._scheduling.look()
            began_us = now_us()
            try:
                message = self._bus.recv(RECEIVE_TIMEOUT_S)
            except Exception as error:  # libraries raise anything on input they don't understand
                unreadable.append(str(error))
                code = getattr(error, "errno", None) or getattr(error, "error_code", None)
                if code is None and len(unreadable) < MAX_UNREADABLE:
                    continue
                if not self._closing:
                    self._post(partial(self.fail, f"can't receive: {error}"))
                return
            if unreadable:
                self._reject("unreadable input", unreadable[0], len(unreadable))
                unreadable = []
            if self._swamped:
                self._post(partial(self.fail, SWAMPED))
                return
            if message is not None:
                try:
                    self._on_message(message, began_us)
                except Exception as error:  # a mistake of ours
                    self._post(partial(_raise, error))
            else:
                self._take(partial(self._nothing_until, began_us))

    def _on_message(self, message: can.Message, began_us: float) -> None:
        frame = Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame)
        t_us = self.clock.host_us(message.timestamp)
        kind = _unused(message)
        if kind == "remote":
            self._take(partial(self._take_request, frame, t_us))
        elif kind:
            self._take(partial(self._on_other, kind, frame.can_id, frame.data, t_us))
            self._take(partial(self._nothing_until, began_us))
            if kind == "error":
                self._take(partial(self._take_error, frame.can_id, frame.data))
            elif message.is_rx:  # else it is ours
                self._reject(f"{kind} frame", f"{kind} frame 0x{frame.can_id:03X}")
        else:
            if self._probing and frame == ENTER_PRE_OPERATIONAL:
                self._probing = False
                self._echo_seen.set()
                self._take(partial(self._take_probe, frame, t_us))
            else:
                self._take(partial(self._take_in, frame, t_us))

    def _reject(self, kind: str, what: str, times: int = 1) -> None:
        told = f"{self.name}: {what}"
        self._take(lambda: self._intake.rejects.add(kind, self.name, told, times))

    def _take(self, job: Callable[[], None]) -> None:
        self._swamped = self._swamped or not self._offer(job)

    def _nothing_until(self, t_us: float) -> None:
        self._heard_us = max(self._heard_us, t_us)

    def _take_probe(self, frame: Frame, t_us: float) -> None:
        self._heard_us = max(self._heard_us, t_us)
        self._count(frame, t_us)
        self._on_frame(frame, t_us, True)

    def _take_in(self, frame: Frame, t_us: float) -> None:
        self._heard_us = max(self._heard_us, t_us)
        self._count(frame, t_us)
        echo = self._transmitter.echoes and self._transmitter.on_echo(frame)
        accepted = echo or self._intake.accepts(frame)
        if accepted:
            self._on_frame(frame, t_us, echo)
        else:
            self._on_other("dropped", frame.can_id, frame.data, t_us)
        self.pump()
        if accepted and not echo and frame.can_id & 0x780 == SDO_RESPONSE:
            self.network.notify(frame.can_id, bytearray(frame.data), t_us / 1e6)

    def _take_request(self, frame: Frame, t_us: float) -> None:
        """A remote frame: one of ours, which guards a drive, or somebody else's."""
        self._heard_us = max(self._heard_us, t_us)
        self._count(frame, t_us)
        if self._transmitter.echoes and self._transmitter.on_echo(frame):
            self._on_other("request", frame.can_id, b"", t_us)
        else:
            self._on_other("remote", frame.can_id, b"", t_us)
            self._reject("remote frame", f"remote frame 0x{frame.can_id:03X}")
        self.pump()

    def _take_error(self, classes: int, data: bytes) -> None:
        self.health.on_error_frame(classes, data)
        if self.health.state is BusState.OFF:
            self.fail("is bus off: check cable, termination and can.bitrate")
        elif self.health.state is BusState.PASSIVE:
            self._on_disturbance(
                f"{self.name} is error passive: frames are disturbed or nobody acknowledges them; "
                "check cable, termination and can.bitrate"
            )

    # ------------------------------------------------------------------ state

    def _count(self, frame: Frame, t_us: float) -> None:
        bits = worst_case_bits(len(frame.data))
        self._traffic.append((t_us, bits))
        self._bits += bits
        while self._traffic[0][0] < t_us - LOAD_WINDOW_US:
            self._bits -= self._traffic.popleft()[1]

    @property
    def load(self) -> float:
        """Share of the last second in which the bus was taken, stuff bits at worst (0 … 1)."""
        return self._bits / self._bitrate

    def close(self) -> None:
        """Stop receiving and close the interface."""
        if not self._closing:
            self.failed = self._closing = True
            self._receiver.join()
            with suppress(can.CanError, OSError):  # what is gone can't be told to close
                self._bus.shutdown()


def queue_is_full(error: can.CanError | OSError) -> bool:
    """Whether the adapter has refused a frame only because it has taken too many already."""
    code = error.errno if isinstance(error, OSError) else error.error_code
    return code in _QUEUE_FULL or "buffer full" in str(error).lower()


def _unused(message: can.Message) -> str:
    """The kind of what is none of CANopen's data frames; "" for those."""
    if message.is_error_frame:
        return "error"
    if message.is_fd or len(message.data) > 8:
        return "fd"
    if message.is_remote_frame:
        return "remote"
    return "extended" if message.is_extended_id else ""


def _raise(error: Exception) -> None:
    raise error


def open_bus(interface: str, channel: str, bitrate: int, echoes: bool = True) -> can.BusABC:
    """A python-can bus, one that gives our own frames back if `echoes` and it can; BusError."""
    for library in ("can", "canopen"):  # what they complain of is raised, and said once
        logging.getLogger(library).setLevel(logging.CRITICAL)
    arguments: dict[str, Any] = {"interface": interface, "channel": channel, "bitrate": bitrate}
    try:
        if interface == "slcan":
            return SlcanBus(channel, bitrate=bitrate)
        bus = _own_messages_too(arguments) if echoes else can.Bus(**arguments)
        deepen(bus)
        return bus
    except (can.CanError, OSError, ValueError, ImportError, TypeError) as error:
        raise BusError(
            f"can't open CAN interface {interface!r}, channel {channel!r}: {error}; check "
            "can.interface and can.channel, and that the interface is up (ip link show)"
        ) from error


def _own_messages_too(arguments: dict[str, Any]) -> can.BusABC:
    try:
        return can.Bus(receive_own_messages=True, **arguments)
    except can.CanInterfaceNotImplementedError as error:
        if "own messages" not in str(error):
            raise
        return can.Bus(**arguments)
