"""What is a Copley drive's own in bring-up: it stands in interpolated position mode, by PVT."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

from epos2_ros.bus.cia402_node import Cia402Node
from epos2_ros.bus.link import Network
from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import ConfigurationError, DriveError
from epos2_ros.motion.trapezoid import MOST_JERK
from epos2_ros.motion.units import INT32_MAX, AxisUnits, position_limits
from epos2_ros.protocol import copley, copley_pvt, epos2


@dataclass(frozen=True)
class CopleySettings:
    """What is written to a drive, in counts; None leaves the drive's value."""

    joint: str
    node_id: int
    min_position_qc: int
    max_position_qc: int
    max_following_error_qc: int  # 0x2120
    stop_deceleration_counts_s2: float | None = None  # 0x6084, 0x6085
    clock_master: int | None = None  # node id of the drive that is; None: the host

    @classmethod
    def of(cls, axis: AxisConfig, clock_master: int | None = None) -> CopleySettings:
        """From the configuration in joint units."""
        units, stop = AxisUnits.of(axis), axis.stop_deceleration
        speed = abs(units.to_qc_s(units.velocity_range))  # less than 0x6081 can hold
        acceleration = INT32_MAX * copley.ACCELERATION_UNIT_COUNTS_S2
        for parameter, unit, limit in (
            ("max_velocity", "/s", speed),
            ("max_acceleration", "/s²", acceleration),
            ("stop_deceleration", "/s²", acceleration),
            ("max_jerk", "/s³", INT32_MAX * copley.JERK_UNIT_COUNTS_S3 / MOST_JERK),
        ):
            value, most = getattr(axis, parameter), abs(units.from_qc_s(limit))
            if value is not None and value > most:
                raise ConfigurationError(
                    f"axes.{axis.joint}.{parameter}: {value:g} {units.unit}{unit} is more than the "
                    f"drive can hold ({most:g} {units.unit}{unit})"
                )
        if axis.max_following_error > INT32_MAX:
            raise ConfigurationError(
                f"axes.{axis.joint}.max_following_error: {axis.max_following_error} qc is more "
                f"than the drive can hold ({INT32_MAX} qc)"
            )
        return cls(
            axis.joint,
            axis.node_id,
            *position_limits(axis, margin_qc=1),
            axis.max_following_error,
            None if stop is None else abs(units.to_qc_s(stop)),
            clock_master,
        )


class CopleyNode:
    """SDO access to one drive."""

    def __init__(self, network: Network, settings: CopleySettings) -> None:
        self.settings = settings
        self.units: tuple[float, float, float] | None = None
        family, master = copley.FAMILY, settings.clock_master
        if master is not None:
            rpdos = epos2.clock_slave_rpdo_mappings(copley.RPDO_MAPPINGS, master)
            family = replace(family, rpdos=rpdos)
        self._access = Cia402Node(network, family, settings.joint, settings.node_id)
        self.node = self._access.node

    def configure(self) -> int:
        """Check identity, configure, go operational; the statusword the drive then has."""
        return self._access.configure(self._write_objects, clear_faults=self.clear_faults)

    def produce_sync(self, period_us: int) -> None:
        """DriveError: sync.producer is to be the host or an EPOS2."""
        raise DriveError(f"{self._access} is not asked to send SYNC: set sync.producer to host")

    def clear_faults(self) -> None:
        """Latched faults stay until ones are written, and no fault reset helps before."""
        objects = self._access.objects
        faults = objects.read(copley.LATCHED_FAULTS)
        if not faults:
            return
        attempt = f"clear its latched faults, {objects.name(copley.LATCHED_FAULTS)}"
        objects.write(copley.LATCHED_FAULTS, faults, 0, attempt)
        if left := objects.read(copley.LATCHED_FAULTS) & faults:
            raise DriveError(
                f"{self._access} keeps latched faults: {copley.describe_faults(left)}; put right "
                "what they say, then switch it off and on again"
            )

    def leave(self) -> None:
        """The host goes: a drive that is off need not watch it any more."""
        self._access.leave()

    def _write_objects(self) -> None:
        s, write = self.settings, self._access.objects.write
        self._check_units()
        self._access.watch_host()
        self._access.objects.keep(
            copley.DESIRED_STATE,
            copley.CANOPEN_MODE,
            0,
            f"let it be commanded by CANopen, {self._access.objects.name(copley.DESIRED_STATE)}",
            "it would ignore commands of motion",
        )
        write(epos2.MODES_OF_OPERATION, epos2.MODE_INTERPOLATED_POSITION)
        write(epos2.INTERPOLATION_SUB_MODE, copley_pvt.INTERPOLATION_CUBIC)
        limits = f"check axes.{s.joint}.min_position and axes.{s.joint}.max_position"
        write(epos2.SOFTWARE_POSITION_LIMIT, s.min_position_qc, 1, check=limits)
        write(epos2.SOFTWARE_POSITION_LIMIT, s.max_position_qc, 2, check=limits)
        write(
            copley.TRACKING_ERROR_DISTANCE,
            s.max_following_error_qc,
            check=f"check axes.{s.joint}.max_following_error",
        )
        if s.stop_deceleration_counts_s2 is not None:
            stop = max(1, round(s.stop_deceleration_counts_s2 / copley.ACCELERATION_UNIT_COUNTS_S2))
            check = f"check axes.{s.joint}.stop_deceleration"
            write(epos2.PROFILE_DECELERATION, stop, check=check)
            write(epos2.QUICK_STOP_DECELERATION, stop, check=check)
        mode = self._access.objects.read(epos2.MODES_OF_OPERATION_DISPLAY)
        if mode != epos2.MODE_INTERPOLATED_POSITION:
            raise DriveError(
                f"{self._access} stays in mode {mode}, not interpolated position mode (7): check "
                "its firmware, and that nothing else controls it"
            )

    def _check_units(self) -> None:
        """Newer firmware has factors between counts and its units; older has none of them.

        A position is counts times feed constant over encoder resolution and gear ratio.
        """
        objects, factor = self._access.objects, Fraction(1)
        told = []
        for index, inverse in (
            (copley.ENCODER_RESOLUTION, True),
            (copley.GEAR_RATIO, True),
            (copley.FEED_CONSTANT, False),
        ):
            above, below = objects.find(index, 1), objects.find(index, 2)
            if above is None or below is None:
                continue
            told.append(f"{objects.name(index)} is {above}/{below}")
            if not above or not below:
                factor = Fraction(0)
            else:
                factor *= Fraction(below, above) if inverse else Fraction(above, below)
        if factor != 1:
            raise DriveError(
                f"{self._access} does not count in counts of its encoder: {', '.join(told)}; set "
                "them all to 1/1 with Copley's CME and store them"
            )
