"""The object dictionary of maxon's EPOS2 as its maker writes it down: one line per sub-object.

Facts from maxon's own EDS of the EPOS2 70/10, software version 2126h (2013, the newest met). It
differs from the application note "Interpolation Position Mode" of 2008: 0x60C4-02 can't be mapped,
0x60C4-06 can; 0x1006, 0x1009, 0x100A, 0x605A and 0x605D don't exist; TPDOs have no event timer.
Left out are objects that the EDS calls internal. The PDOs' records follow below.
"""

from __future__ import annotations

from functools import cache

from .maker_table import PdoRow, Row, parse


@cache
def rows() -> tuple[Row, ...]:
    """All of the dictionary, the PDOs' records aside."""
    return parse(_TABLE)


RPDOS = (
    PdoRow(0x200, (0x6040_0010,)),
    PdoRow(0x300, (0x6040_0010, 0x6060_0008)),
    PdoRow(0x400, (0x6040_0010, 0x607A_0020)),
    PdoRow(0x500, (0x6040_0010, 0x60FF_0020)),
)
TPDOS = (
    PdoRow(0x4000_0180, (0x6041_0010,)),
    PdoRow(0xC000_0280, (0x6041_0010, 0x6061_0008)),
    PdoRow(0xC000_0380, (0x6041_0010, 0x6064_0020)),
    PdoRow(0xC000_0480, (0x6041_0010, 0x606C_0020)),
)
RPDO_TYPES = frozenset({1, 255})  # at the next SYNC, at once
TPDO_TYPES = frozenset({1, 253, 255})  # at SYNC, on remote request, on change
INHIBIT_100US = 10

# index, sub-index, type, access (* PDO mappable), default, range, name
_TABLE = """
1000  0 u32 ro             -            - Device Type
1001  0 u8  ro             -            - Error Register
1003  0 u8  rw             0            - Number of Errors
1003  1 u32 ro             -            - Error History (1)
1003  2 u32 ro             -            - Error History (2)
1003  3 u32 ro             -            - Error History (3)
1003  4 u32 ro             -            - Error History (4)
1003  5 u32 ro             -            - Error History (5)
1005  0 u32 rw           128     128..128 COB-ID SYNC
1008  0 str const          -            - Manufacturer Device Name
100C  0 u16 rw             0            - Guard Time
100D  0 u8  rw             0            - Lifetime Factor
1010  0 u8  ro             1            - Number of entries
1010  1 u32 rw             -            - Save All Parameters
1011  0 u8  ro             5            - Number of entries
1011  1 u32 rw             -            - Restore All Default Parameters
1011  5 u32 rw             -            - Restore Default PDO COB-IDs
1012  0 u32 rw           256            - COB-ID Time Stamp Object
1013  0 u32 rww*           -            - High Resolution Time Stamp
1014  0 u32 rw       id+0x80            - COB-ID EMCY
1016  0 u8  ro             2            - Number of entries
1016  1 u32 rw             0            - Consumer 1 Heartbeat Time
1016  2 u32 rw             0            - Consumer 2 Heartbeat Time
1017  0 u16 rw             0            - Producer Heartbeat Time
1018  0 u8  ro             4            - Number of entries
1018  1 u32 ro             -            - Vendor ID
1018  2 u32 ro             -            - Product Code
1018  3 u32 ro             -            - Revision Number
1018  4 u32 ro             -            - Serial Number
1020  0 u8  ro             2            - Number of entries
1020  1 u32 rw             -            - Configuration Date
1020  2 u32 rw             -            - Configuration Time
1200  0 u8  ro             2            - Number of entries
1200  1 u32 ro      id+0x600            - SDO COB-ID Client->Server (rx)
1200  2 u32 ro      id+0x580            - SDO COB-ID Server->Client (tx)
2000  0 u8  rw        id+0x0            - Node ID
2001  0 u16 rw             -         0..7 CAN Bitrate
2002  0 u16 rw             -         0..5 RS232 Baudrate
2003  0 u8  const          5            - Number of entries
2003  1 u16 ro             -            - Software Version
2003  2 u16 ro             -            - Hardware Version
2003  3 u16 ro             -            - Application Number
2003  4 u16 ro             -            - Application Version
2003  5 u16 ro             -            - Basesector Version
2004  0 u64 const          -            - Serial Number
2005  0 u16 rw             -            - RS232 Frame Timeout
2006  0 u16 rw             -            - USB Frame Timeout
2008  0 u16 rw             -            - Miscellaneous Configuration
200A  0 u16 ro             -            - CAN Bitrate Display
200C  0 u8  const          4            - Number of entries
200C  1 u32 rw             0            - Custom persistent memory 1
200C  2 u32 rw             0            - Custom persistent memory 2
200C  3 u32 rw             0            - Custom persistent memory 3
200C  4 u32 rw             0            - Custom persistent memory 4
2020  0 u32 ro*            -            - Incremental Encoder 1 Counter
2021  0 u32 ro*            -            - Incremental Encoder 1 Counter at Index Pulse
2022  0 u16 ro*            -            - Hall Sensor Pattern
2027  0 i16 ro*            -            - Current Actual Value Averaged
2028  0 i32 ro*            -            - Velocity Actual Value Averaged
2029  0 i32 ro*            -            - Auxiliary Velocity Actual Value Averaged
2030  0 i16 rww*           -            - Current Mode Setting Value
2031  0 i16 ro*            -            - Current Demand Value
2062  0 i32 rww*           -            - Position Mode Setting Value
2069  0 i32 ro*            -            - Auxiliary Velocity Sensor Actual Value
206B  0 i32 rww*           -            - Velocity Mode Setting Value
206C  0 i32 ro*            -            - Auxiliary Velocity Actual Value
2070  0 u8  ro             9            - Number of entries
2070  1 u16 rw            15            - Configuration of Digital Input1
2070  2 u16 rw            14            - Configuration of Digital Input2
2070  3 u16 rw            13            - Configuration of Digital Input3
2070  4 u16 rw             2            - Configuration of Digital Input4
2070  5 u16 rw             1            - Configuration of Digital Input5
2070  6 u16 rw             0            - Configuration of Digital Input6
2070  7 u16 rw             9            - Configuration of Digital Input7
2070  8 u16 rw             8            - Configuration of Digital Input8
2070  9 u16 rw             7            - Configuration of Digital Input9
2071  0 u8  ro             4            - Number of entries
2071  1 u16 ro*            -            - Digital Input Functionalities State
2071  2 u16 rw         58247            - Digital Input Functionalities Mask
2071  3 u16 rw             0            - Digital Input Functionalities Polarity
2071  4 u16 rw             8            - Digital Input Functionalities Execution Mask
2074  0 u8  ro             6            - Number of entries
2074  1 i32 ro*            -            - Position Marker Captured Position
2074  2 u8  rw             0            - Position Marker Edge Type
2074  3 u8  rw             0            - Position Marker Mode
2074  4 u16 rw             -            - Position Marker Counter
2074  5 i32 ro             -            - Position Marker History (1)
2074  6 i32 ro             -            - Position Marker History (2)
2078  0 u8  ro             3            - Number of entries
2078  1 u16 rww*           -            - Digital Output State
2078  2 u16 rw             0            - Digital Output Mask
2078  3 u16 rw             0            - Digital Output Polarity
2079  0 u8  ro             5            - Number of entries
2079  1 u16 rw            15            - Configuration of Digital Output1
2079  2 u16 rw            14            - Configuration of Digital Output2
2079  3 u16 rw            13            - Configuration of Digital Output3
2079  4 u16 rw            12            - Configuration of Digital Output4
2079  5 u16 rw            11            - Configuration of Digital Output5
207A  0 u8  ro             5            - Number of entries
207A  1 u16 rww*           -            - Position Compare Configuration
207A  2 i32 rww*           -            - Position Compare Reference Position
207A  3 i32 rw             -            - Position Compare Interval Width
207A  4 u16 rw             -            - Position Compare Interval Repetitions
207A  5 u16 rw             -            - Position Compare Pulse Width
207B  0 u8  ro             2            - Number of entries
207B  1 u16 rw            15            - Configuration of Analog Input1
207B  2 u16 rw            14            - Configuration of Analog Input2
207C  0 u8  ro             2            - Number of entries
207C  1 i16 ro*            -            - Analog Input 1
207C  2 i16 ro*            -            - Analog Input 2
207D  0 u16 rw             0            - Analog Input Functionalities Execution Mask
2080  0 u16 rww*         500            - Current Threshold for Homing Mode
2081  0 i32 rww*           0            - Home Position
2082  0 i32 ro             -            - Home Position Displacement
20C1  0 u64 wo*            0            - Interpolation Data Record
20C4  0 u8  ro             3            - Number of entries
20C4  1 u16 ro*            -            - Interpolation Buffer Status
20C4  2 u16 rw             4        0..63 Interpolation Buffer Underflow Warning
20C4  3 u16 rw            60        1..64 Interpolation Buffer Overflow Warning
20F4  0 i16 ro*            -            - Following Error Actual Value
2100  0 u8  ro             3            - Number of entries
2100  1 u16 rw            10            - Brake Reaction Rise Time
2100  2 u16 rw            10            - Brake Reaction Fall Time
2100  3 u16 rw         65535            - Brake Timeout
2101  0 u8  ro             3            - Number of entries
2101  1 u16 rw            30            - Standstill Window
2101  2 u16 rw            50            - Standstill Window Time
2101  3 u16 rw          1000            - Standstill Timeout
2210  0 u8  ro             4            - Number of entries
2210  1 u32 rw           500 16..0x2625a0 Pulse Number Incremental Encoder 1
2210  2 u16 rw             1            - Position Sensor Type
2210  4 u16 rw             0            - Position Sensor Polarity
2211  0 u8  ro             4            - Number of entries
2211  1 u16 rw             -            - SSI Encoder Data Rate
2211  2 u16 rw             -            - SSI Encoder Number of Data Bits
2211  3 i32 ro             -            - SSI Encoder Actual Position
2211  4 u16 rw             -            - SSI Encoder Encoding Type
2212  0 u8  ro             3            - Number of entries
2212  1 u32 rw             - 16..0x2625a0 Incremental Encoder 2 Pulse Number
2212  2 u32 ro*            -            - Incremental Encoder 2 Counter
2212  3 u32 ro*            -            - Incremental Encoder 2 Counter at Index Pulse
2213  0 u8  ro             3            - Number of entries
2213  1 u32 rw             - 64..0x989680 Sinus Incremental Encoder 2 Resolution
2213  2 i32 ro             -            - Sinus Incremental Encoder 2 Actual Position
2220  0 u16 rw             0            - Controller Structure
2230  0 u8  ro             3            - Number of entries
2230  1 u32 rw             -            - Gear Ratio Numerator
2230  2 u16 rw             -            - Gear Ratio Denominator
2230  3 u32 rw             -            - Gear Maximal Speed
2300  0 u8  ro             5            - Number of entries
2300  1 i32 ro             -            - Digital Position Desired Value
2300  2 u16 rw             1            - Digital Position Scaling Numerator
2300  3 u16 rw             1            - Digital Position Scaling Denominator
2300  4 u8  rw             0            - Digital Position Polarity
2300  5 i32 rw             -            - Digital Position Offset
2301  0 u8  ro             4            - Number of entries
2301  1 i16 rw             -            - Analog Current Setpoint Scaling
2301  2 i16 rw             -            - Analog Current Setpoint Offset
2301  3 i8  rw             -            - Analog Current Setpoint Notation Index
2301  4 i16 ro             -            - Analog Current Setpoint
2302  0 u8  ro             4            - Number of entries
2302  1 i16 rw             -            - Analog Velocity Setpoint Scaling
2302  2 i32 rw             -            - Analog Velocity Setpoint Offset
2302  3 i8  rw             -            - Analog Velocity Setpoint Notation Index
2302  4 i32 ro             -            - Analog Velocity Setpoint
2303  0 u8  ro             4            - Number of entries
2303  1 i16 rw             -            - Analog Position Setpoint Scaling
2303  2 i32 rw             -            - Analog Position Setpoint Offset
2303  3 i8  rw             -            - Analog Position Setpoint Notation Index
2303  4 i32 ro             -            - Analog Position Setpoint
6007  0 i16 rw             -            - Abort Connection Option Code
6040  0 u16 rww*           -            - Controlword
6041  0 u16 ro*            -            - Statusword
605B  0 i16 rw             0            - Shutdown Option Code
605C  0 i16 rw             1            - Disable Operation Option Code
605E  0 i16 rw             2            - Fault Reaction Option Code
6060  0 i8  rww*           1            - Modes of Operation
6061  0 i8  ro*            -            - Modes of Operation Display
6062  0 i32 ro*            -            - Position Demand Value
6064  0 i32 ro*            -            - Position Actual Value
6065  0 u32 rww*        2000            - Max Following Error
6067  0 u32 rw    4294967295            - Position Window
6068  0 u16 rw             0            - Position Window Time
6069  0 i32 ro*            -            - Velocity Sensor Actual Value
606B  0 i32 ro*            -            - Velocity Demand Value
606C  0 i32 ro*            -            - Velocity Actual Value
606D  0 u32 rw             -            - Velocity Window
606E  0 u16 rw             0            - Velocity Window Time
6078  0 i16 ro*            -            - Current Actual Value
607A  0 i32 rww*           -            - Target Position
607C  0 i32 rww*           0            - Home Offset
607D  0 u8  const          2            - Number of entries
607D  1 i32 rw    -2147483648            - Min Position Limit
607D  2 i32 rw    2147483647            - Max Position Limit
607F  0 u32 rw         25000     0..25000 Max Profile Velocity
6081  0 u32 rww*        1000            - Profile Velocity
6083  0 u32 rww*       10000            - Profile Acceleration
6084  0 u32 rww*       10000            - Profile Deceleration
6085  0 u32 rww*       10000            - QuickStop Deceleration
6086  0 i16 rww*           0            - Motion Profile Type
6089  0 i8  rw             0            - Position Notation Index
608A  0 u8  rw           172            - Position Dimension Index
608B  0 i8  rw             0            - Velocity Notation Index
608C  0 u8  rw           164            - Velocity Dimension Index
608D  0 i8  rw             0            - Acceleration Notation Index
608E  0 u8  rw           164            - Acceleration Dimension Index
6098  0 i8  rww*           7            - Homing Method
6099  0 u8  const          2            - Number of entries
6099  1 u32 rww*         100            - Speed for Switch Search
6099  2 u32 rww*          10            - Speed for Zero Search
609A  0 u32 rww*        1000            - Homing Acceleration
60C0  0 i16 rw            -1       -1..-1 Interpolation Sub Mode Selection
60C2  0 u8  const          2            - Number of entries
60C2  1 u8  rw             1         1..1 Interpolation Time Periode Value
60C2  2 i8  rw            -3       -3..-3 Interpolation Time Index
60C4  0 u8  const          6            - Number of entries
60C4  1 u32 ro             -            - Maximum Buffer Size
60C4  2 u32 ro             -            - Actual Buffer Size
60C4  3 u8  rw             0         0..0 Buffer Organisation
60C4  4 u16 rw             0        0..64 Buffer Position
60C4  5 u8  wo             8         8..8 Size Of Data Record
60C4  6 u8  wo*            0         0..1 Buffer Clear
60C5  0 u32 rw    4294967295            - Max Acceleration
60F6  0 u8  const          2            - Number of entries
60F6  1 i16 rww*         300            - Current Regulator P-Gain
60F6  2 i16 rww*         100            - Current Regulator I-Gain
60F9  0 u8  const          5            - Number of entries
60F9  1 i16 rww*        1000            - Speed Regulator P-Gain
60F9  2 i16 rww*         100            - Speed Regulator I-Gain
60F9  4 u16 rww*           -            - Velocity Feedforward Factor in Speed Regulator
60F9  5 u16 rww*           -            - Acceleration Feedforward Factor in Speed Regulator
60FB  0 u8  const          5            - Number of entries
60FB  1 i16 rww*         150            - Position Regulator P-Gain
60FB  2 i16 rww*          10            - Position Regulator I-Gain
60FB  3 i16 rww*         200            - Position Regulator D-Gain
60FB  4 u16 rww*           0            - Velocity Feedforward Factor in Position Regulator
60FB  5 u16 rww*           0            - Acceleration Feedforward Factor in Position Regulator
60FF  0 i32 rww*           -            - Target Velocity
6402  0 u16 rw            10            - Motor Type
6410  0 u8  const          5            - Number of entries
6410  1 u16 rww*       10000     0..10000 Continuous Current Limit
6410  2 u16 rww*       25000     0..25000 Output Current Limit
6410  3 u8  rw             1            - Pole Pair Number
6410  4 u32 rww*       25000            - Maximal Motor Speed
6410  5 u16 rw            40      1..5400 Thermal Time Constant Winding
6502  0 u32 ro             -            - Supported Drive Modes
"""
