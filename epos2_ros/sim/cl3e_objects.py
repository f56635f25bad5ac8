"""The object dictionary of Nanotec's CL3-E as its maker writes it down: one line per sub-object.

Facts from Nanotec's own EDS of firmware FIR-v1419 (2014). There is no 0x1006, 0x1013, 0x1016,
0x1029 and 0x6007: the drive watches its host by life guarding (0x100C, 0x100D), has no clock to be
corrected and sends no SYNC. Left out is the loading of firmware (0x1F50, 0x1F51, 0x1F57). The PDOs'
records follow below; what later firmware adds and takes away is in `cl3e`.
"""

from __future__ import annotations

from functools import cache

from .maker_table import PdoRow, Row, parse


@cache
def rows() -> tuple[Row, ...]:
    """All of the dictionary, the PDOs' records aside."""
    return parse(_TABLE)


RPDOS = (
    PdoRow(0x200, (0x6040_0010, 0x6060_0008, 0x3202_0020)),
    PdoRow(0x300, (0x607A_0020, 0x6081_0020)),
    PdoRow(0x400, (0x6042_0010,)),
    PdoRow(0x500, (0x60FE_0120,)),
)
TPDOS = (
    PdoRow(0x180, (0x6041_0010, 0x6064_0020)),
    PdoRow(0x280, (0x6064_0020,)),
    PdoRow(0x380, (0x6044_0010,)),
    PdoRow(0x480, (0x60FD_0020,)),
)

# index, sub-index, type, access (* PDO mappable), default, range, name
_TABLE = """
1000    0 u32 ro         262546 - Device Type
1001    0 u8  ro*             0 - Error Register
1003    0 u8  rw              0 - number of errors
1003  1-8 u32 ro              0 - standard error field
1005    0 u32 rw            128 - COB-ID Sync
1007    0 u32 rw              0 - Synchronous Window Length
1008    0 str const           - - Manufacturer Device Name
1009    0 str const           - - Manufacturer Hardware Version
100A    0 str const           - - Manufacturer Software Version
100C    0 u16 rw              0 - Guard Time
100D    0 u8  rw              0 - Live Time Factor
1010    0 u8  ro              2 - Number of Entries
1010    1 u32 rw              1 - Save all the parameters to non-volatile memory
1010    2 u32 rw              1 - Save the comm parameters to non-volatile memory
1011    0 u8  ro              1 - Number of Entries
1011    1 u32 rw              0 - Restore all default parameters
1014    0 u32 ro        id+0x80 - COB-ID EMCY
1017    0 u16 rw              0 - Producer heartbeat time
1018    0 u8  ro              4 - Number of Entries
1018    1 u32 ro            620 - Vendor-ID
1018    2 u32 ro              3 - Product code
1018    3 u32 ro              1 - Revision number
1018    4 u32 ro              1 - Serial number
2000    0 u32 rw              0 - Trace Configuration
2005    0 u8  rw            136 - CANopen Baudrate
2009    0 u8  rw            127 - CANopen NodeID
2010    0 u32 rw              0 - IP-Configuration
2011    0 u32 rw              0 - Static-IP-Address
2012    0 u32 rw              0 - Static-IP-Subnet-Mask
2018    0 u32 ro              0 - Current-IP-Address
2019    0 u32 ro              0 - Current-IP-Subnet-Mask
2020    0 u32 ro              0 - AppInfo-Static-IP-Address
2021    0 u32 ro              0 - AppInfo-Static-IP-Subnet-Mask
2022    0 str ro              - - Drive serial number
2028    0 u8  rw              5 - MODBUS Slave Address
202A    0 u32 rw          38400 - MODBUS RTU Baudrate
202B    0 u8  rw              8 - MODBUS RTU Word Length
202C    0 u8  rw              2 - MODBUS RTU Stop Bits
202D    0 u8  rw              0 - MODBUS RTU Parity
202E    0 u8  rw              0 - MODBUS Control
2030    0 u32 rw             50 - Pole pair count
2031    0 u32 rw           1800 - Peak current
2032    0 u32 rw         200000 - Maximum Speed
2033    0 i32 rw              0 - Plunger Block
2034    0 u32 rw          28500 - Upper voltage warning level
2035    0 u32 rw          10000 - Lower voltage warning level
2036    0 u32 rw           1000 - Open loop current reduction idle time
2037    0 i32 rw            -50 - Open loop current reduction value/factor
2038    0 u8  ro              6 - Number of Entries
2038    1 u32 rw           1000 - Close Brake idle time
2038    2 u32 rw           1000 - Shutdown power idle time
2038    3 u32 rw           1000 - Open Brake delay time
2038    4 u32 rw           1000 - Start Operation delay time
2038    5 u32 rw              0 - PWM frequency
2038    6 u32 rw              0 - PWM duty cycle
2039    0 u8  ro              4 - Number of Entries
2039    1 i32 ro              0 - I_d
2039    2 i32 ro              0 - I_q
2039    3 i32 ro              0 - I_a
2039    4 i32 ro              0 - I_b
203A    0 u8  ro              3 - Number of Entries
203A    1 u32 rw              0 - Minimum current for block detection
203A    2 u32 rw              0 - Period of blocking
203A    3 u32 rw              0 - Block detection time
203B    0 u8  ro              6 - Number of Entries
203B    1 u32 rw              0 - Nominal Current
203B    2 u32 rw              0 - Maximum duration of peak current
203B    3 u32 rw              0 - Threshold
203B    4 u32 rw              0 - CalcValue
203B    5 u32 rw              0 - LimitedCurrent
203B    6 u32 rw              0 - Status
2050    0 i32 rw              0 - Encoder Alignment
2051    0 u8  ro              3 - Number of Entries
2051  1-3 i32 rw              0 - Parameter
2052    0 i32 rw           4096 - Encoder Resolution
2053    0 u8  rw              0 - Index Polarity
2054    0 i32 rwr*           -1 - Index Width
2055    0 u8  ro              3 - Number of Entries
2055    1 u32 rw              0 - Maximum Index Misreading distance
2055    2 u32 rw              0 - Positive Alignment Error
2055    3 u32 rw              0 - Negative Alignment Error
2056    0 u32 rwr*          500 - Limit switch tolerance band
2057    0 i32 rw            128 - Clock Direction Multiplier
2058    0 i32 rw              1 - Clock Direction Divider
2059    0 u32 rw              0 - Encoder Configuration
2060    0 u32 rw              1 - Compensate polepair count
2061    0 u32 rw              1 - Velocity numerator
2062    0 u32 rw             60 - Velocity denominator
2063    0 u32 rw              1 - Acceleration numerator
2064    0 u32 rw             60 - Acceleration denominator
2065    0 u32 rw              1 - Jerk numerator
2066    0 u32 rw             60 - Jerk denominator
2070    0 u8  rww*            0 - Mode of modulo operation
2080    0 u32 rww*            0 - Motion Slave Controlword
2081    0 u32 rwr*            0 - Motion Slave Statusword
2082    0 u32 rwr*            0 - Error Reaction Delay
2083    0 u8  rw              0 - Error Reaction Delay
2084    0 u32 rw              0 - Bootup Delay
2090    0 u16 rww*            0 - Reversing sequence Controlword
2091    0 u16 rwr*            0 - Reversing sequence Statusword
2092    0 u32 rww*            0 - Reversing sequence time delay
2093    0 i32 rww*            0 - Reversing sequence current step
2094    0 i32 rww*            0 - Reversing sequence velocity step
2095    0 i32 rww*            0 - Reversing sequence position step
20A0    0 u8  ro              8 - Number of Entries
20A0    1 u16 rw              0 - Permutation
20A0    2 u16 rw              0 - Inversion
20A0    3 u16 rw              0 - Angle 30
20A0    4 u16 rw          10922 - Angle 90
20A0    5 u16 rw          21845 - Angle 150
20A0    6 u16 rw          32768 - Angle 210
20A0    7 u16 rw          43690 - Angle 270
20A0    8 u16 rw          54613 - Angle 330
2100    0 u8  ro              5 - Number of Entries
2100    1 u32 ro              0 - status changed
2100    2 u32 ro              0 - error occurred
2100    3 u32 ro              0 - I/O changed
2100    4 u32 ro              0 - fieldbus event occurred
2100    5 u32 ro              0 - miscellaneous
2101    0 i32 ro              0 - Fieldbus Module
2200    0 u32 rww*            0 - Sampler Control
2201    0 u32 ro*             0 - Sampler Status
2202    0 u8  rw              2 - Number of Entries
2202    1 u32 rw     1615003664 - Sample value #1
2202    2 u32 rw      570622496 - Sample value #2
2203    0 u8  ro              3 - Number of Entries
2203    1 u32 rw              0 - Sample buffer size
2203    2 u32 rw              0 - Sample buffer watermark
2203    3 u32 rw              0 - Sample tick
2204    0 u32 rww*            1 - Sample Time in ms
2300    0 u32 rww*            0 - VMM Control
2301    0 u32 ro*             0 - VMM Status
2302    0 u32 ro*             0 - VMM Error Code
2303    0 u8  rww*            0 - Number of active user program
2304    0 u8  ro              8 - Number of Entries
2304    1 u32 rw              0 - Name of user program 1 UB
2304    2 u32 rw              0 - Name of user program 1 LB
2304    3 u32 rw              0 - Name of user program 2 UB
2304    4 u32 rw              0 - Name of user program 2 LB
2304    5 u32 rw              0 - Name of user program 3 UB
2304    6 u32 rw              0 - Name of user program 3 LB
2304    7 u32 rw              0 - Name of user program 4 UB
2304    8 u32 rw              0 - Name of user program 4 LB
2310    0 u8  rw              0 - Number of Entries
2320    0 u8  rw              0 - Number of Entries
2330    0 u8  rw              0 - Number of Entries
2400    0 u8  ro             32 - Number of Entries
2400 1-32 i32 rww*            0 - VMM Input
2500    0 u8  ro             32 - Number of Entries
2500 1-32 i32 rwr*            0 - VMM Output
2600    0 u8  rw              0 - Number of Entries
2800    0 u8  rw              0 - Number of Entries
3010    0 u8  ro             12 - Number of Entries
3010    1 i32 ro              0 - UbPower
3010    2 i32 ro              0 - UbPowerReal
3010    3 i32 ro              0 - UbLogic
3010    4 i32 ro              0 - UbLogicReal
3010    5 i32 ro              0 - Aux12
3010    6 i32 ro              0 - Aux12Real
3010    7 i32 ro              0 - T_Board
3010    8 i32 ro              0 - T_BoardReal
3010    9 i32 ro              0 - Ia
3010   10 i32 ro              0 - IaReal
3010   11 i32 ro              0 - Ib
3010   12 i32 ro              0 - IbReal
3020    0 u8  ro              0 - Last error to display
3202    0 u32 rww*            0 - Motor drive submode select
3203    0 u32 rww*            0 - Auto-Setup submode select
3204    0 u32 rww*            0 - Open Loop switch on position source
3205    0 u32 rww*            1 - Closed Loop switch on position source
3208    0 u8  ro              4 - Number of Entries
3208    1 i32 rw              0 - commutation
3208    2 i32 rw              0 - torque
3208    3 i32 rw              0 - velocity
3208    4 i32 rw              0 - position
3209    0 u8  ro              4 - Number of Entries
3209    1 i32 rw              0 - commutation
3209    2 i32 rw              0 - torque
3209    3 i32 rw              0 - velocity
3209    4 i32 rw              0 - position
320A    0 u8  ro              4 - Number of Entries
320A    1 i32 rw              0 - commutation
320A    2 i32 rw              0 - torque
320A    3 i32 rw             -1 - velocity
320A    4 i32 rw             -1 - position
320B    0 u8  ro              4 - Number of Entries
320B    1 i32 rw              0 - commutation
320B    2 i32 rw              0 - torque
320B    3 i32 rw              1 - velocity
320B    4 i32 rw              1 - position
3210    0 u8  ro             10 - Number of Entries
3210    1 i32 rw           2048 - s_P
3210    2 i32 rw              0 - s_I
3210    3 i32 rw           7000 - v_P
3210    4 i32 rw              4 - v_I
3210    5 i32 rw         420000 - Id_P
3210    6 i32 rw          12000 - Id_I
3210    7 i32 rw         420000 - Iq_P
3210    8 i32 rw          12000 - Iq_I
3210    9 i32 rw         120000 - I_P
3210   10 i32 rw          45000 - I_I
3211    0 u32 rww*            0 - Motor drive deadtime compensation
3220    0 u8  ro              2 - Number of Entries
3220  1-2 i16 ro*             0 - Analogue input
3221    0 i32 rw              0 - Analogue inputs control
3230    0 u8  ro              4 - Number of Entries
3230    1 u8  ro              6 - Number of Digital Inputs
3230    2 u8  ro              2 - Number of Digital Outputs
3230    3 u8  ro              2 - Number of Analogue Inputs
3230    4 u8  ro              0 - Number of Analogue Outputs
3240    0 u8  ro              7 - Number of Entries
3240    1 u32 rww*            0 - Special function enable
3240    2 u32 rww*            0 - Function inverted
3240    3 u32 rww*            0 - Force enable
3240    4 u32 rww*            0 - Force value
3240    5 u32 rww*            0 - Raw value
3240    6 u32 rww*            0 - Input Range Select
3240    7 u32 rww*            0 - Differential Select
3250    0 u8  ro              5 - Number of Entries
3250    1 u32 rww*       983041 - Special function enable
3250    2 u32 rww*            0 - Function inverted
3250    3 u32 rww*            0 - Force enable
3250    4 u32 rww*            0 - Force value
3250    5 u32 rww*            0 - Raw value
327A    0 i32 rw              0 - Extended Target Position
3700    0 i16 rw             -1 - Following error option code
4000    0 u32 rw              0 - Password
4010    0 u8  ro             13 - Number of Entries
4010    1 u32 rw            275 - Value #1
4010    2 u32 rw           4800 - Value #2
4010    3 u32 rw           3000 - Value #3
4010    4 u32 rw           8850 - Value #4
4010  5-8 u32 rw              0 - Value
4010    9 u32 rw             30 - Value #9
4010   10 u32 rw              0 - Value #10
4010   11 u32 rw            300 - Value #11
4010 12-13 u32 rw              0 - Value
4011    0 u8  ro              6 - Number of Entries
4011    1 i32 rw          28601 - Value #1
4011    2 i32 rw           1024 - Value #2
4011    3 i32 rw              0 - Value #3
4011  4-5 i32 rw              1 - Value
4011    6 i32 rw              0 - Value #6
4020    0 u8  ro             10 - Number of Entries
4020  1-6 u32 rw              0 - Value
4020  7-8 u32 rw            300 - Value
4020    9 u32 rw          27500 - Value #9
4020   10 u32 rw            500 - Value #10
4030    0 u8  ro             16 - Number of Entries
4030    1 u32 ro              0 - FieldbusSupport
4030    2 u32 ro              0 - HwVersion
4030  3-7 u32 ro              0 - GitHash_B
4030 8-11 u32 ro              0 - PcName_B
4030   12 u32 ro              0 - FwBuildYear
4030   13 u32 ro              0 - FwBuildWeek
4030   14 u32 ro              0 - FwBuildCounter
4030   15 u32 ro              0 - FirmwareType
4030   16 u32 ro              0 - CompilerFlags
4031    0 u8  ro             18 - Number of Entries
4031    1 u32 ro              0 - ModuleCode_1
4031    2 u32 ro              0 - ModuleVersion_1
4031    3 u32 ro              0 - ModuleCode_2
4031    4 u32 ro              0 - ModuleVersion_2
4031    5 u32 ro              0 - ModuleCode_3
4031    6 u32 ro              0 - ModuleVersion_3
4031    7 u32 ro              0 - ModuleCode_4
4031    8 u32 ro              0 - ModuleVersion_4
4031    9 u32 ro              0 - ModuleCode_5
4031   10 u32 ro              0 - ModuleVersion_5
4031   11 u32 ro              0 - ModuleCode_6
4031   12 u32 ro              0 - ModuleVersion_6
4031   13 u32 ro              0 - ModuleCode_7
4031   14 u32 ro              0 - ModuleVersion_7
4031   15 u32 ro              0 - ModuleCode_8
4031   16 u32 ro              0 - ModuleVersion_8
4031   17 u32 ro              0 - ModuleCode_9
4031   18 u32 ro              0 - ModuleVersion_9
603F    0 u16 ro*             - - Error code
6040    0 u16 rww*            0 - Controlword
6041    0 u16 ro*             - - Statusword
6042    0 i16 rww*          200 - vl target velocity
6043    0 i16 ro*             0 - vl velocity demand
6044    0 i16 ro*             0 - vl velocity actual value
6046    0 u8  const           2 - Number of Entries
6046    1 u32 rww*            0 - MinAmount
6046    2 u32 rww*        20000 - MaxAmount
6048    0 u8  const           2 - Number of Entries
6048    1 u32 rww*          500 - DeltaSpeed
6048    2 u16 rww*            1 - DeltaTime
6049    0 u8  const           2 - Number of Entries
6049    1 u32 rww*          500 - DeltaSpeed
6049    2 u16 rww*            1 - DeltaTime
604A    0 u8  const           2 - Number of Entries
604A    1 u32 rww*         5000 - DeltaSpeed
604A    2 u16 rww*            1 - DeltaTime
604C    0 u8  const           2 - Number of Entries
604C    1 i32 rww*            1 - vl dimension factor numerator
604C    2 i32 rww*            1 - vl dimension factor denominator
605A    0 i16 rw              2 - Quick stop option code
605B    0 i16 rw              0 - Shutdown option code
605C    0 i16 rw              1 - Disable option code
605D    0 i16 rw              1 - Halt option code
605E    0 i16 rw              2 - Fault option code
6060    0 i8  rww*            0 - Modes of operation
6061    0 i8  ro*             0 - Modes of operation display
6062    0 i32 ro*             0 - Position demand value
6063    0 i32 ro*             0 - Position actual internal value
6064    0 i32 ro*             0 - Position actual value
6065    0 u32 rww*          256 - Following error window
6066    0 u16 rww*          100 - Following error time out
6067    0 u32 rww*           10 - Position window
6068    0 u16 rww*          100 - Position window time
606B    0 i32 ro*             0 - Velocity demand value
606C    0 i32 ro*             0 - Velocity actual value
606D    0 u16 rww*            0 - Velocity window
606E    0 u16 rww*            0 - Velocity window time
6071    0 i16 rww*            0 - Target torque
6072    0 u16 rww*            0 - Max torque
6074    0 i16 ro*             0 - Torque demand
607A    0 i32 rww*         4000 - Target Position
607B    0 u8  const           2 - Number of Entries
607B    1 i32 rww*  -2147483647 - Min position range limit
607B    2 i32 rww*   2147483646 - Max position range limit
607C    0 i32 rww*            0 - Home offset
607D    0 u8  const           2 - Number of Entries
607D    1 i32 rww*  -2147483648 - Min position limit
607D    2 i32 rww*   2147483647 - Max position limit
607E    0 u8  rw              0 - Polarity
6081    0 u32 rww*          500 - Profile velocity
6082    0 u32 rww*            0 - End velocity
6083    0 u32 rww*          500 - Profile acceleration
6084    0 u32 rww*          500 - Profile deceleration
6085    0 u32 rww*         5000 - Quick stop deceleration
6086    0 i16 rww*            0 - Motion profile type
6087    0 u32 rww*            0 - Torque slope
608F    0 u8  const           2 - Number of Entries
608F    1 u32 rw           2000 - Encoder increments
608F    2 u32 rw              1 - Motor revolutions
6091    0 u8  const           2 - Number of Entries
6091    1 u32 rw              1 - Motor revolutions
6091    2 u32 rw              1 - Shaft revolutions
6092    0 u8  const           2 - Number of Entries
6092    1 u32 rww*            1 - Feed
6092    2 u32 rww*            1 - Shaft revolutions
6098    0 i8  rww*           35 - Homing method
6099    0 u8  const           2 - Number of Entries
6099    1 u32 rww*           50 - Speed during search for switch
6099    2 u32 rww*            1 - Speed during search for zero
609A    0 u32 rww*          500 - Homing acceleration
60A4    0 u8  const           4 - Number of Entries
60A4    1 u32 rw           1000 - Begin Acceleration Jerk
60A4    2 u32 rw           1000 - End Acceleration Jerk
60A4    3 u32 rw           1000 - Begin Deceleration Jerk
60A4    4 u32 rw           1000 - End Deceleration Jerk
60C2    0 u8  const           2 - Number of Entries
60C2    1 u8  rw              1 - Interpolation time period value
60C2    2 i8  rw              0 - Interpolation time index
60C5    0 u32 rww*   4294967293 - Max acceleration
60C6    0 u32 rww*         5000 - Max deceleration
60F4    0 i32 ro*             0 - Following error actual value
60FD    0 u32 ro*             0 - Digital Inputs
60FE    0 u8  const           1 - Number of Entries
60FE    1 u32 rww*            0 - Digital Outputs #1
60FF    0 i32 rww*            0 - Target velocity
6402    0 u8  ro              2 - Number of analogue inputs
6402  1-2 i32 ro*             0 - Analogue input
6431    0 u8  ro              2 - Number of analogue inputs
6431  1-2 i32 rw              0 - Analogue input
6432    0 u8  ro              2 - Number of analogue inputs
6432  1-2 i32 rw              1 - Analogue input
6502    0 u32 ro*           175 - Supported drive modes
6505    0 str ro              - - http drive catalogue address
"""
