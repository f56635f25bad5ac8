"""A CANopen slave: NMT, heartbeat, SDO, PDO, SYNC, TIME and EMCY on an explicit clock.

Frames and times go in, frames come out of `outbox`; nothing here waits or threads.
Times are true time in µs, never falling: `receive(can_id, data, t_us)` is called when a
frame's last bit has passed, `advance(t_us)` when `next_event_us` has come.
Source: CiA 301 (4.2), section numbers in the text; EPOS2 numbers where noted.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import NamedTuple

from .dictionary import (
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    VISIBLE_STRING,
    AbortCode,
    Entry,
    ObjectDictionary,
    SdoAbort,
)
from .pdo import MAX_ENTRIES, ReceivePdo, TransmitPdo
from .sdo import SdoServer

INF = math.inf
NMT, SYNC, EMCY, TIME = 0x000, 0x080, 0x080, 0x100
SDO_RESPONSE, SDO_REQUEST, HEARTBEAT = 0x580, 0x600, 0x700
SYNC_PRODUCER = 1 << 30
HISTORY = 5
HEARTBEAT_ERROR = 0x8130
PDO_LENGTH_ERROR = 0x8210
_ROUNDING_US = 0.01  # of times added up in different ways


class Pdos(NamedTuple):
    """What a device's PDOs can do."""

    number: int = 4  # each way
    entries: int = MAX_ENTRIES
    inhibits: bool = True


class NmtState(IntEnum):
    """As in the heartbeat message (7.2.8.3.2.2)."""

    INITIALISING = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class NmtCommand(IntEnum):
    """7.2.8.3.1."""

    START = 0x01
    STOP = 0x02
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


@dataclass(frozen=True)
class Identity:
    """Objects 0x1000, 0x1008 … 0x100A and 0x1018."""

    device_type: int
    vendor_id: int
    product_code: int
    revision: int
    serial: int
    device_name: bytes
    hardware_version: bytes
    software_version: bytes


def error_register_bits(code: int) -> int:
    """Bits of 0x1001 an emergency code sets (7.5.2.2, table 26 of 7.2.7.1)."""
    specific = {0x2: 0x02, 0x3: 0x04, 0x4: 0x08, 0xF: 0x80}.get(code >> 12, 0)
    if 0x8100 <= code <= 0x82FF:
        specific = 0x10
    elif code >> 8 == 0x86:
        specific = 0x20
    return 0x01 | specific


class Slave:
    """The communication half of a device; a subclass brings the application.

    It overrides the hooks `_tick` (with `_tick_us`, when it is due), `_on_alarm` (`_alarm_us`),
    `_on_sync`, `_on_time`, `_on_communication_error`, `_reset_application`.

    pdos:          what its PDOs can do
    boot_ms:       from a reset or power-on to the boot-up message; the device is made booted
    frames_needed: of others, before it knows the bus's bit rate and starts up
    """

    def __init__(
        self,
        node_id: int,
        identity: Identity,
        t_us: float = 0.0,
        boot_ms: float = 0.0,
        frames_needed: int = 0,
        pdos: Pdos = Pdos(),  # noqa: B008
    ) -> None:
        if not 1 <= node_id <= 127:
            raise ValueError(f"node id {node_id}: must be 1 … 127")
        self.node_id = node_id
        self._boot_ms = boot_ms
        self._frames_needed = self._frames_left = frames_needed
        self.now_us = t_us
        self.next_event_us = INF
        self.received_us = t_us  # when the frame being looked at came in
        self.outbox: deque[tuple[int, bytes]] = deque()
        self.nmt_state = NmtState.INITIALISING
        self.connected = True
        self.powered = True
        self.rate = 1.0  # of the device's own clock, for its timers
        self.dictionary = ObjectDictionary()
        self._tick_us = INF
        self._timers_us = INF
        self._heartbeat_us = INF
        self._sync_us = INF
        self._boot_us = INF  # when it has started up
        self._alarm_us = INF
        self._guard_us = INF  # the host has to ask before, or it is lost
        self._toggle = 0  # of the next answer to node guarding
        self._deadlines_us: dict[int, float] = {}  # of the heartbeats consumed
        self._dirty = False
        self._fast_ready_us = INF
        self._handlers: dict[int, Callable[[bytes], None]] = {}
        self._sdo = SdoServer(self.dictionary)
        self.error_register = 0
        self._history: deque[int] = deque(maxlen=HISTORY)
        self._build_communication_objects(identity)
        self.rpdos = [
            ReceivePdo(n, node_id, self.dictionary, self._reconfigure, pdos.entries)
            for n in range(1, pdos.number + 1)
        ]
        self.tpdos = [
            TransmitPdo(
                n, node_id, self.dictionary, self._reconfigure, pdos.entries, pdos.inhibits
            )
            for n in range(1, pdos.number + 1)
        ]
        self._event_tpdos: list[TransmitPdo] = []
        if not frames_needed:
            self._boot()

    # --- the world outside --------------------------------------------------------------

    def receive(self, can_id: int, data: bytes, t_us: float, remote: bool = False) -> bool:
        """A frame was completed on the bus at `t_us`; `False` if it is none of this device's.

        A frame may be handed in late (`t_us` before `now_us`): what it does counts from `t_us`.
        """
        if not (self.connected and self.powered):
            return False
        if self._frames_left:
            self._listen(t_us)
            return False
        handler = self._handlers.get(can_id)
        if handler is None:
            return False
        self.advance(t_us)
        self.received_us = t_us
        if remote:
            self._remote_request(can_id)
        else:
            handler(data)
        self._dirty = True  # what a frame changes is looked at after the inhibit time, too
        self._send_events()
        self._arm()
        return True

    def _listen(self, t_us: float) -> None:
        """Bit rate detection: the device is not on the bus yet."""
        self._frames_left -= 1
        if not self._frames_left:
            self.now_us = max(t_us, self.now_us)
            self._start_up()
            self._arm()

    def transmitted(self, can_id: int, t_us: float) -> None:
        """A frame of `outbox` was completed on the bus: a SYNC producer hears its own SYNC."""
        if can_id == self._sync_can_id and self._handlers.get(can_id) is not None:
            self.receive(can_id, b"", t_us)

    def advance(self, t_us: float) -> None:
        """Runs everything that is due up to `t_us`."""
        while self.next_event_us <= t_us:
            now = self.next_event_us
            self.now_us = max(now, self.now_us)
            if self._tick_us <= now:
                self._tick()
                if self._dirty or self._fast_ready_us <= now:
                    self._send_events()
            if self._timers_us <= now:
                self._run_timers()
                self._arm()
            self.next_event_us = min(self._tick_us, self._timers_us)
        if t_us > self.now_us:
            self.now_us = t_us

    def disconnect(self) -> None:
        """Pulls the bus cable; the device goes on by itself."""
        self.connected = False
        self.outbox.clear()

    def reconnect(self) -> None:
        self.connected = True

    def push(self, counts: float) -> bool:
        """A hand turns the shaft so far; `False`: it does not turn."""
        return False

    def power_off(self) -> None:
        self.powered = False
        self.outbox.clear()
        self.next_event_us = self._tick_us = self._timers_us = INF
        self._alarm_us = self._boot_us = self._guard_us = INF

    def power_on(self, t_us: float) -> None:
        """Starts anew, with the parameters that are stored."""
        self.powered = True
        self.now_us = max(t_us, self.now_us)
        self._frames_left = self._frames_needed
        self._reset_node()
        self._arm()

    # --- hooks of the application -------------------------------------------------------

    def _tick(self) -> None:
        """The control cycle due at `_tick_us`."""

    def _on_alarm(self) -> None:
        """What `_alarm_us` was set for; it is INF again."""

    def _on_sync(self) -> None:
        """SYNC came in at `received_us`, before any synchronous PDO is looked at."""

    def _on_time(self) -> None:
        """TIME came in at `received_us`."""

    def _on_communication_error(self, code: int) -> None:
        """A heartbeat failed to appear or a PDO was too short."""
        self.emergency(code)

    def _reset_application(self) -> None:
        """The device was reset; all entries have their defaults again."""

    # --- emergencies --------------------------------------------------------------------

    def emergency(self, code: int, register: int | None = None) -> None:
        """Sends EMCY `code`, notes it in 0x1003 and sets its bits in 0x1001 (7.2.7)."""
        bits = error_register_bits(code) if register is None else register
        self.error_register |= bits
        self._history.appendleft(code)
        self._send_emergency(code)

    def clear_emergency(self) -> None:
        """All errors are gone: EMCY 0x0000."""
        if self.error_register:
            self.error_register = 0
            self._send_emergency(0)

    def _send_emergency(self, code: int) -> None:
        cob_id = self._emcy_cob_id.value
        if self._communicates and not cob_id >> 31:
            register = self.error_register.to_bytes(1, "little")
            self._send(cob_id & 0x7FF, code.to_bytes(2, "little") + register + bytes(5))
        self._dirty = True

    # --- object dictionary --------------------------------------------------------------

    def _build_communication_objects(self, identity: Identity) -> None:
        od = self.dictionary
        od.variable(0x1000, Entry("Device type", UNSIGNED32, "const", identity.device_type))
        od.variable(
            0x1001,
            Entry(
                "Error register", UNSIGNED8, "ro", mappable=True, read=lambda: self.error_register
            ),
        )
        od.variable(
            0x1003,
            Entry(
                "Number of errors",
                UNSIGNED8,
                high=0,
                read=lambda: len(self._history),
                write=lambda _: self._history.clear(),
            ),
        )
        for n in range(HISTORY):
            past = Entry(
                f"Error history {n + 1}", UNSIGNED32, "ro", read=partial(self._past_error, n)
            )
            od.variable(0x1003, past, n + 1)
        self._sync_cob_id = od.variable(
            0x1005,
            Entry(
                "COB-ID SYNC",
                UNSIGNED32,
                value=SYNC,
                check=self._check_sync_cob_id,
                write=self._on_sync_configured,
            ),
        )
        self._sync_period = od.variable(
            0x1006,
            Entry("Communication cycle period", UNSIGNED32, write=self._on_sync_configured),
        )
        for index, name, text in (
            (0x1008, "Manufacturer device name", identity.device_name),
            (0x1009, "Manufacturer hardware version", identity.hardware_version),
            (0x100A, "Manufacturer software version", identity.software_version),
        ):
            od.variable(index, Entry(name, VISIBLE_STRING, "const", text=text))
        # maxon, application note "Interpolation Position Mode", 3.6.1
        od.variable(0x1012, Entry("COB-ID TIME", UNSIGNED32, value=TIME, low=TIME, high=TIME))
        self._emcy_cob_id = od.variable(
            0x1014,
            Entry("COB-ID EMCY", UNSIGNED32, value=EMCY + self.node_id, check=self._check_emcy_id),
        )
        self._consumers = [
            Entry(
                f"Consumer heartbeat time {n}",
                UNSIGNED32,
                check=partial(self._check_consumer, n),
                write=self._on_consumer,
            )
            for n in (1, 2)
        ]
        od.record(0x1016, *self._consumers)
        self._guard_ms = od.variable(
            0x100C, Entry("Guard time", UNSIGNED16, write=self._on_guarding)
        )
        self._life_factor = od.variable(
            0x100D, Entry("Life time factor", UNSIGNED8, write=self._on_guarding)
        )
        self._heartbeat_ms = od.variable(
            0x1017, Entry("Producer heartbeat time", UNSIGNED16, write=self._on_heartbeat_time)
        )
        od.record(
            0x1018,
            Entry("Vendor id", UNSIGNED32, "const", identity.vendor_id),
            Entry("Product code", UNSIGNED32, "const", identity.product_code),
            Entry("Revision number", UNSIGNED32, "const", identity.revision),
            Entry("Serial number", UNSIGNED32, "const", identity.serial),
        )
        od.record(
            0x1200,
            Entry("COB-ID SDO client to server", UNSIGNED32, "const", SDO_REQUEST + self.node_id),
            Entry("COB-ID SDO server to client", UNSIGNED32, "const", SDO_RESPONSE + self.node_id),
        )

    def _past_error(self, n: int) -> int:
        if n >= len(self._history):
            raise SdoAbort(AbortCode.NO_SUBINDEX)
        return self._history[n]

    def _check_sync_cob_id(self, value: int) -> None:
        old = self._sync_cob_id.value
        if value & ~(SYNC_PRODUCER | 0x7FF) or not value & 0x7FF:
            raise SdoAbort(AbortCode.VALUE_RANGE)
        if old & SYNC_PRODUCER and (value ^ old) & 0x7FF:
            raise SdoAbort(AbortCode.DEVICE_STATE)  # 7.5.2.5: not while producing

    def _on_sync_configured(self, _: int) -> None:
        self._sync_us = INF  # `_arm` starts it again with the new period
        self._reconfigure()

    def _check_emcy_id(self, value: int) -> None:
        old = self._emcy_cob_id.value
        if value & 0x7FFF_F800 or not value & 0x7FF:
            raise SdoAbort(AbortCode.VALUE_RANGE)
        if not old >> 31 and not value >> 31 and value != old:
            raise SdoAbort(AbortCode.VALUE_RANGE)  # 7.5.2.17: not while it exists

    def _check_consumer(self, number: int, value: int) -> None:
        if value >> 24:
            raise SdoAbort(AbortCode.VALUE_RANGE)
        node = value >> 16
        watched = [
            entry.value >> 16
            for n, entry in enumerate(self._consumers, 1)
            if n != number and entry.value & 0xFFFF
        ]
        if value & 0xFFFF and 1 <= node <= 127 and node in watched:
            raise SdoAbort(AbortCode.PARAMETER_INCOMPATIBLE)  # 7.5.2.19

    def _on_consumer(self, _: int) -> None:
        self._deadlines_us.clear()
        self._reconfigure()

    def _on_guarding(self, _: int) -> None:
        """It watches the host again from the next request on."""
        self._guard_us = INF

    def _on_heartbeat_time(self, value: int) -> None:
        self._heartbeat_us = self.now_us if value else INF

    # --- NMT ----------------------------------------------------------------------------

    @property
    def _operational(self) -> bool:
        return self.nmt_state is NmtState.OPERATIONAL

    @property
    def _communicates(self) -> bool:
        """Whether SYNC, EMCY, TIME and SDO exist in the present NMT state."""
        return self.nmt_state in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL)

    @property
    def _sync_can_id(self) -> int:
        return self._sync_cob_id.value & 0x7FF

    def _start_up(self) -> None:
        """Initialising; boot-up follows in `boot_ms`, or when the bit rate is known."""
        self.nmt_state = NmtState.INITIALISING
        self._reconfigure()
        if self._frames_left:
            return
        if self._boot_ms:
            self._boot_us = self.now_us + 1000.0 * self._boot_ms
        else:
            self._boot()

    def _boot(self) -> None:
        """Boot-up message, then pre-operational (7.3.2.2.1)."""
        self._boot_us = INF
        self._send(HEARTBEAT + self.node_id, bytes(1))
        self._enter(NmtState.PRE_OPERATIONAL)

    def _enter(self, state: NmtState) -> None:
        if state is self.nmt_state:
            return
        self.nmt_state = state
        for pdo in (*self.rpdos, *self.tpdos):
            pdo.restart()
        self._dirty = True
        self._reconfigure()

    def _on_nmt(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return
        command = data[0]
        if command == NmtCommand.START:
            self._enter(NmtState.OPERATIONAL)
        elif command == NmtCommand.STOP:
            self._enter(NmtState.STOPPED)
        elif command == NmtCommand.ENTER_PRE_OPERATIONAL:
            self._enter(NmtState.PRE_OPERATIONAL)
        elif command == NmtCommand.RESET_NODE:
            self._reset_node()
        elif command == NmtCommand.RESET_COMMUNICATION:
            self._reset_communication()

    def _reset_node(self) -> None:
        for _, entry in self.dictionary.items():
            entry.restore()
        self._alarm_us = INF
        self.error_register = 0
        self._history.clear()
        self._reset_application()
        self._reset_communication()

    def _reset_communication(self) -> None:
        for (index, _), entry in self.dictionary.items():
            if 0x1000 <= index <= 0x1FFF:
                entry.restore()
        for pdo in (*self.rpdos, *self.tpdos):
            pdo.reset()
        self._sdo.reset()
        self._deadlines_us.clear()
        self._heartbeat_us = self.now_us if self._heartbeat_ms.value else INF
        self._sync_us = self._guard_us = INF
        self._toggle = 0
        self._start_up()

    def _reconfigure(self) -> None:
        """Who listens to which identifier, in the present NMT state (7.3.2.2.4, table 38)."""
        self._handlers = {}
        self._event_tpdos = []
        if self.nmt_state is NmtState.INITIALISING:
            return
        self._handlers[NMT] = self._on_nmt
        self._handlers[HEARTBEAT + self.node_id] = lambda _: None  # asked for by remote frames
        if self._communicates:
            self._handlers[SDO_REQUEST + self.node_id] = self._on_sdo
            self._handlers[TIME] = lambda _: self._on_time()
            self._handlers[self._sync_can_id] = lambda _: self._sync()
        if self._operational:
            for tpdo in self.tpdos:
                if tpdo.valid:
                    self._handlers[tpdo.can_id] = lambda _: None  # remote requests
            for rpdo in self.rpdos:
                if rpdo.valid:
                    self._handlers[rpdo.can_id] = partial(self._on_rpdo, rpdo)
            self._event_tpdos = [t for t in self.tpdos if t.valid and t.event_driven]
        for consumer in self._consumers:
            node, time = consumer.value >> 16 & 0xFF, consumer.value & 0xFFFF
            if time and 1 <= node <= 127:
                self._handlers[HEARTBEAT + node] = partial(self._on_heartbeat, node, time)

    # --- what comes in ------------------------------------------------------------------

    def _on_sdo(self, data: bytes) -> None:
        response = self._sdo.request(data)
        if response is not None:
            self._send(SDO_RESPONSE + self.node_id, response)

    def _on_rpdo(self, rpdo: ReceivePdo, data: bytes) -> None:
        if not rpdo.receive(data):
            self._on_communication_error(PDO_LENGTH_ERROR)

    def _on_heartbeat(self, node: int, time_ms: int, _: bytes) -> None:
        self._deadlines_us[node] = self.received_us + 1000.0 * time_ms / self.rate

    def _sync(self) -> None:
        self._on_sync()
        if self._operational:
            for tpdo in self.tpdos:
                if tpdo.valid and tpdo.synchronous and tpdo.on_sync():
                    self._send(tpdo.can_id, tpdo.sample())
            for rpdo in self.rpdos:
                if rpdo.valid:
                    rpdo.sync()

    def _remote_request(self, can_id: int) -> None:
        if can_id == HEARTBEAT + self.node_id:
            self._be_guarded()
            return
        for tpdo in self.tpdos:
            if tpdo.valid and tpdo.can_id == can_id and self._operational:
                self._send(can_id, tpdo.sample())

    def _be_guarded(self) -> None:
        """Node guarding (7.2.8.2.2.1); where a heartbeat is produced, that replaces it."""
        if self._heartbeat_ms.value:
            return
        self._send(HEARTBEAT + self.node_id, bytes([self._toggle | self.nmt_state]))
        self._toggle ^= 0x80
        life_ms = self._guard_ms.value * self._life_factor.value
        self._guard_us = self.received_us + 1000.0 * life_ms / self.rate if life_ms else INF

    # --- what goes out ------------------------------------------------------------------

    def _send(self, can_id: int, data: bytes) -> None:
        if self.connected and self.powered:
            self.outbox.append((can_id, data))

    def _send_events(self) -> None:
        """Event-driven TPDOs whose values have changed, each after its inhibit time."""
        now = self.now_us
        dirty, self._dirty = self._dirty, False
        self._fast_ready_us = INF
        for tpdo in self._event_tpdos:
            if now < tpdo.ready_us:
                tpdo.waiting = tpdo.waiting or dirty
                if tpdo.waiting:
                    self._timers_us = min(self._timers_us, tpdo.ready_us)
            else:
                tpdo.waiting = False
                trigger = tpdo.trigger()
                if trigger != tpdo.sent:
                    self._send(tpdo.can_id, tpdo.sample())
                    tpdo.sent = trigger
                    tpdo.ready_us = now + tpdo.inhibit_us / self.rate - _ROUNDING_US
            if tpdo.fast:
                self._fast_ready_us = min(self._fast_ready_us, max(now, tpdo.ready_us))

    # --- timers -------------------------------------------------------------------------

    def _arm(self) -> None:
        """Works out when the next timer is due."""
        if not self.powered:
            return
        period_us = self._sync_period.value
        if not (self._sync_cob_id.value & SYNC_PRODUCER and period_us and self._communicates):
            self._sync_us = INF
        elif self._sync_us == INF:
            self._sync_us = self.now_us + period_us / self.rate
        self._timers_us = min(
            self._heartbeat_us,
            self._sync_us,
            self._boot_us,
            self._alarm_us,
            self._guard_us,
            *self._deadlines_us.values(),
            *(tpdo.ready_us for tpdo in self._event_tpdos if tpdo.waiting),
        )
        self.next_event_us = min(self._tick_us, self._timers_us)

    def _run_timers(self) -> None:
        now = self.now_us
        if self._boot_us <= now:
            self._boot()
        if self._alarm_us <= now:
            self._alarm_us = INF
            self._on_alarm()
        if self._guard_us <= now:
            self._guard_us = INF
            if not self._heartbeat_ms.value:
                self._on_communication_error(HEARTBEAT_ERROR)
        if self._heartbeat_us <= now:
            if self.nmt_state is not NmtState.INITIALISING:  # there it is the boot-up message
                self._send(HEARTBEAT + self.node_id, bytes([self.nmt_state]))
            self._heartbeat_us += 1000.0 * self._heartbeat_ms.value / self.rate
        if self._sync_us <= now:
            self._send(self._sync_can_id, b"")
            self._sync_us += self._sync_period.value / self.rate
        for node, deadline_us in list(self._deadlines_us.items()):
            if deadline_us <= now:
                del self._deadlines_us[node]  # watched again from its next heartbeat on
                self._on_communication_error(HEARTBEAT_ERROR)
        self._send_events()
