"""What is a Nanotec CL3-E's own in bring-up: units, presets that have to go, its mode of motion."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

from epos2_ros.bus.cia402_node import Cia402Node
from epos2_ros.bus.link import Network
from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import ConfigurationError, DriveError
from epos2_ros.motion.trapezoid import MOST_JERK
from epos2_ros.motion.units import UINT32_MAX, AxisUnits, position_limits
from epos2_ros.protocol import cl3e, epos2

MODE_TIMEOUT_S = 1.0
ACCELERATION_HEADROOM = 1.25  # of the drive's own limits over those of the configuration


@dataclass(frozen=True)
class Cl3eSettings:
    """What is written to a drive, in counts; None leaves the drive's value."""

    joint: str
    node_id: int
    counts_per_turn: int
    min_position_qc: int
    max_position_qc: int
    max_following_error_qc: int
    max_acceleration_qc_s2: float | None = None  # 0x60C5, 0x60C6
    stop_deceleration_qc_s2: float | None = None  # 0x6085
    homes: bool = False

    @classmethod
    def of(cls, axis: AxisConfig) -> Cl3eSettings:
        """From the configuration in joint units."""
        units = AxisUnits.of(axis)
        velocity, acceleration, jerk = cl3e.fine_units(axis.counts_per_turn)

        def held(parameter: str, unit: str, fine: float, headroom: float = 1.0) -> float | None:
            value = getattr(axis, parameter)
            if value is None:
                return None
            most = abs(units.from_qc_s(UINT32_MAX * fine)) / headroom
            if value > most:
                raise ConfigurationError(
                    f"axes.{axis.joint}.{parameter}: {value:g} {units.unit}{unit} is more than the "
                    f"drive can hold ({most:g} {units.unit}{unit})"
                )
            return abs(units.to_qc_s(value)) * headroom

        held("max_velocity", "/s", velocity)
        held("max_jerk", "/s³", jerk, MOST_JERK)
        return cls(
            axis.joint,
            axis.node_id,
            axis.counts_per_turn,
            *position_limits(axis, margin_qc=1),
            axis.max_following_error,
            held("max_acceleration", "/s²", acceleration, ACCELERATION_HEADROOM),
            held("stop_deceleration", "/s²", acceleration),
            axis.homing is not None and bool(axis.homing.method),
        )


class _HalfConverted(DriveError):
    """A drive's units are those in which nobody leaves it."""


class Cl3eNode:
    """SDO access to one drive."""

    def __init__(self, network: Network, settings: Cl3eSettings) -> None:
        self.settings = settings
        self.units: tuple[float, float, float] | None = None
        self._access = Cia402Node(network, cl3e.FAMILY, settings.joint, settings.node_id)
        self._objects = self._access.objects
        self.node = self._access.node

    def configure(self) -> int:
        """Check identity, configure, go operational; the statusword the drive then has."""
        try:
            return self._access.configure(self._write_objects)
        except _HalfConverted:
            self._access.reset_node()
            return self._access.configure(self._write_objects)

    def produce_sync(self, period_us: int) -> None:
        """DriveError: no CL3-E can send SYNC (it has no 0x1006)."""
        raise DriveError(f"{self._access} can't send SYNC: set sync.producer to host")

    def clear_faults(self) -> None:
        """A fault reset needs nothing before."""

    def leave(self) -> None:
        """The host goes: a drive that is off need not watch it any more."""
        self._access.leave()

    def _write_objects(self) -> None:
        s, write = self.settings, self._objects.write
        self._check_units()
        self._access.watch_host()  # first: by it a drive that restarts later is known
        self.units = self._set_units()
        write(epos2.MODES_OF_OPERATION, cl3e.MODE_PROFILE_POSITION)
        unit = self.units[1]
        most, stop = (
            None if value is None else max(1, math.ceil(value / unit))
            for value in (s.max_acceleration_qc_s2, s.stop_deceleration_qc_s2)
        )
        for index, subindex, value, parameters in (
            (cl3e.QUICK_STOP_OPTION, 0, cl3e.STAY_IN_QUICK_STOP, ()),
            (cl3e.FOLLOWING_ERROR_OPTION, 0, cl3e.FAULT_BY_QUICK_STOP_RAMP, ()),
            (cl3e.FOLLOWING_ERROR_WINDOW, 0, s.max_following_error_qc, ("max_following_error",)),
            (cl3e.END_VELOCITY, 0, 0, ()),
            (epos2.SOFTWARE_POSITION_LIMIT, 1, s.min_position_qc, ("min_position",)),
            (epos2.SOFTWARE_POSITION_LIMIT, 2, s.max_position_qc, ("max_position",)),
            (epos2.MAX_ACCELERATION, 0, most, ("max_acceleration",)),
            (cl3e.MAX_DECELERATION, 0, most, ("max_acceleration",)),
            (epos2.QUICK_STOP_DECELERATION, 0, stop, ("stop_deceleration",)),
            (cl3e.HALT_OPTION, 0, cl3e.HALT_BY_QUICK_STOP_RAMP, ()),
        ):
            if value is not None:
                names = " and ".join(f"axes.{s.joint}.{name}" for name in parameters)
                write(index, value, subindex, check=f"check {names}" if names else "")
        if self._objects.find(cl3e.POSITIONING_OPTION) is not None:
            write(cl3e.POSITIONING_OPTION, cl3e.NO_RELEASE)
        if s.homes and not self._objects.read(cl3e.SUBMODE) & 1:
            write(cl3e.OPEN_LOOP_SOURCE, 1, 4)  # without which open loop can't be homed
        here = self._objects.read(epos2.POSITION_ACTUAL)
        write(epos2.TARGET_POSITION, here)  # its preset of 4000 would be the first move's
        self._await_mode()

    def _check_units(self) -> None:
        """What the drive's own objects have to say of positions, and newer firmware of velocities.

        Older firmware has fractions (0x2061 … 0x2066), newer has 0x60A8 and 0x60A9 in their place.
        READING: the position of older firmware is in increments of 0x608F where gear ratio and feed
        constant are 1; that of newer firmware in tenths of a degree.
        """
        read = self._objects.read
        for index in (cl3e.GEAR_RATIO, cl3e.FEED_CONSTANT):
            name = f"{self._objects.name(index, 1)} / -02"
            self._expect(name, (read(index, 1), read(index, 2)), (1, 1))
        if self._objects.find(cl3e.UNIT_VELOCITY) is None:
            index = cl3e.ENCODER_RESOLUTION
            increments, turns = read(index, 1), read(index, 2)
            name = f"{self._objects.name(index, 1)} / -02"
        else:
            for index, wanted in (
                (cl3e.UNIT_POSITION, cl3e.TENTH_DEGREES),
                (cl3e.UNIT_VELOCITY, cl3e.RPM),
            ):
                unit = read(index)
                if unit != wanted:
                    raise DriveError(
                        f"{self._access} has 0x{unit:08X} in {self._objects.name(index)}; the "
                        f"driver takes 0x{wanted:08X} only, its preset: set it and store it"
                    )
            increments, turns = cl3e.TENTHS_PER_TURN, 1
            name = self._objects.name(cl3e.UNIT_POSITION)
        if increments != self.settings.counts_per_turn * turns:
            raise DriveError(
                f"{self._access} counts {increments / max(turns, 1):g} per turn of the motor by "
                f"{name}, not {self.settings.counts_per_turn}: set "
                f"axes.{self.settings.joint}.counts_per_turn to what the drive has, or change the "
                "drive's"
            )

    def _set_units(self) -> tuple[float, float, float]:
        """0.01 rpm and 0.01 rpm/s where they can be set: a path needs finer ones than whole rpm.

        What the drive holds in these units is converted with them, so that it stays as fast as it
        was. A host that fails amid that leaves a fraction that no drive has: then the drive is
        reset, by which it has again what is stored in it.
        """
        counts = self.settings.counts_per_turn
        if self._objects.find(cl3e.UNIT_VELOCITY) is not None:
            return cl3e.preset_units(counts)
        name = f"{self._objects.name(cl3e.JERK_UNIT)} / 0x{cl3e.JERK_UNIT + 1:04X}"
        self._expect(name, self._fraction(cl3e.JERK_UNIT), cl3e.RPM_FRACTION)
        self._make_finer(cl3e.VELOCITY_UNIT, cl3e.VELOCITIES)
        self._make_finer(cl3e.ACCELERATION_UNIT, cl3e.ACCELERATIONS)
        return cl3e.fine_units(counts)

    def _fraction(self, index: int) -> tuple[int, int]:
        return self._objects.read(index), self._objects.read(index + 1)

    def _make_finer(self, index: int, values: Sequence[tuple[int, int]]) -> None:
        read, write = self._objects.read, self._objects.write
        numerator, denominator = cl3e.FINE_FRACTION
        found = self._fraction(index)
        if found == cl3e.FINE_FRACTION:
            return
        name = f"{self._objects.name(index)} / 0x{index + 1:04X}"
        self._expect(name, found, cl3e.RPM_FRACTION)
        finer = denominator // cl3e.RPM_FRACTION[1]
        write(index, cl3e.HALF_WAY)
        for key in values:
            write(key[0], min(read(*key) * finer, UINT32_MAX), key[1])
        write(index + 1, denominator)
        write(index, numerator)

    def _expect(self, name: str, found: tuple[int, int], wanted: tuple[int, int]) -> None:
        """Two fractions are the same."""
        if found[0] * wanted[1] != found[1] * wanted[0] or 0 in found:
            raise (_HalfConverted if found[0] == cl3e.HALF_WAY else DriveError)(
                f"{self._access} has {found[0]}/{found[1]} in {name}; the driver takes "
                f"{wanted[0]}/{wanted[1]} only, its preset: set it and store it, or switch the "
                "drive off and on"
            )

    def _await_mode(self) -> None:
        """A set-point before 0x6061 has followed is ignored silently."""
        until = time.monotonic() + MODE_TIMEOUT_S
        while (mode := self._objects.read(epos2.MODES_OF_OPERATION_DISPLAY)) != (
            cl3e.MODE_PROFILE_POSITION
        ):
            if time.monotonic() > until:
                raise DriveError(
                    f"{self._access} stays in mode {mode}, not profile position mode (1)"
                )
