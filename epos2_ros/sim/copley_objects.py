"""The object dictionary of a Copley Accelnet as its maker writes it down: one line per sub-object.

Facts from Copley's own EDS of 2016. There is no 0x1011, 0x1012, 0x1016 and 0x6007: the drive has no
way back to what it left the factory with, and watches its host by life guarding (0x100C, 0x100D).
0x1006 and 0x1013 exist. Left out is the updating of firmware (0x2001). The PDOs' records are in
`copley`, and so is what the EDS lacks and drives have: the compare module (0x2160 … 0x2165), and
the factors of newer firmware (0x608F, 0x6091, 0x6092).
"""

from __future__ import annotations

from functools import cache

from .maker_table import Row, parse


@cache
def rows() -> tuple[Row, ...]:
    """All of the dictionary, the PDOs' records aside."""
    return parse(_TABLE)


# index, sub-index, type, access (* PDO mappable), default, range, name
_TABLE = """
1000  0 u32   ro      459154                 - Device Type
1001  0 u8    ro*          -                 - Error Register
1002  0 u32   ro*          -                 - Amplifier event word
1003  0 u8    rw           -                 - Number of errors in error history
1003  1 u32   ro           -                 - Standard error field 1
1003  2 u32   ro           -                 - Standard error field 2
1003  3 u32   ro           -                 - Standard error field 3
1003  4 u32   ro           -                 - Standard error field 4
1003  5 u32   ro           -                 - Standard error field 5
1003  6 u32   ro           -                 - Standard error field 6
1003  7 u32   ro           -                 - Standard error field 7
1005  0 u32   rw         128                 - COB-ID SYNC message
1006  0 u32   rw           -                 - Communication Cycle Period
1008  0 str   ro           -                 - Amplifier model number
1009  0 str   ro           -                 - Hardware version string
100A  0 str   ro           -                 - Manufacturer Software Version
100C  0 u16   rw           0          0..65535 Node Guarding time
100D  0 u8    rw           0            0..255 Life Time Factor
1010  0 u8    ro           4                 - Number of Entries
1010  1 u32   rw           -                 - Save all parameters
1010  2 u32   rw           -                 - Save communication parameters
1010  3 u32   rw           -                 - Save application parameters
1010  4 u32   rw           -                 - Save manufacturer defined parameters
1013  0 u32   rw*          -                 - High resolution time stamp
1014  0 u32   rw           -                 - Emergency object ID
1015  0 u16   rw           -                 - Emergency object inhibit time
1017  0 u16   rw           0          0..65535 Heartbeat Time
1018  0 u8    ro           4                 - Number of Entries
1018  1 u32   ro         171                 - CANopen Vendor ID
1018  2 u32   ro           -                 - Product Code
1018  3 u32   ro           -                 - Revision Number
1018  4 u32   ro           -                 - Serial number
1200  0 u8    ro           2                 - Number of Entries
1200  1 u32   ro    id+0x600                 - SDO COB-ID Client->Server
1200  2 u32   ro    id+0x580                 - SDO COB-ID Server->Client
2000  0 u32   rw           -                 - Serial command handler
2002  0 u8    rw           -                 - PDO request object
2010  0 u64   rw*          -                 - PVT Buffer data
2011  0 u16   ro*          -                 - PVT buffer count
2012  0 u32   ro*          -                 - PVT buffer status
2013  0 u16   ro*          -                 - PVT segment ID
2080  0 u32   ro           -                 - Amplifier scaling info
2100  0 i32   rw*          -                 - Velocity loop acceleration limit
2101  0 i32   rw*          -                 - Velocity loop deceleration limit
2102  0 i32   rw*          -                 - Velocity loop e-stop decel limit
2103  0 i32   rw*          0      0..500000000 Velocity loop velocity limit
2104  0 i32   rw*          0      0..500000000 Velocity window
2105  0 u16   rw*          -                 - Velocity window time
2106  0 bytes rw           -                 - Velocity loop output filter coefficients
2107  0 i16   rw*          0              0..8 Hall velocity mode shift value
2108  0 bytes rw           -                 - Velocity loop command filter coefficients
2109  0 bytes rw           -                 - Analog reference input filter
2110  0 i16   rw*          -                 - Peak current limit
2111  0 i16   rw*          -                 - Continuous current limit
2112  0 u16   rw*          -                 - Time at peak current limit
2113  0 u32   rw*          -                 - Current max rate of change mA/sec
2114  0 i16   rw*          -                 - Period over which RMS current is calculated
2115  0 i16   ro*          -                 - RMS current
2116  0 i16   ro*          -                 - User current limit running sum
2117  0 i16   ro*          -                 - Amp current limit running sum
2120  0 i32   rw*          -                 - Tracking error distance
2121  0 i32   rw*          -                 - Profile target jerk
2122  0 i32   ro*          -                 - Trajectory generator destination position
2140  0 i16   rw*          -                 - PWM output mode and status bits
2141  0 u32   ro*          -                 - Amplifier time
2150  0 u16   rw*          -                 - Regen resistor resistance
2151  0 i16   rw*          -                 - Regen resistor continuous power
2152  0 i16   rw*          -                 - Regen resistor peak power
2153  0 u16   rw*          -                 - Regen resistor peak time
2154  0 i16   rw*          -                 - Regen turn on voltage
2155  0 i16   rw*          -                 - Regen turn off voltage
2156  0 str   rw           -                 - Regen resistor model number string
2157  0 i16   ro*          -                 - Regen flags
2180  0 u32   ro*          -                 - Sticky version of event status
2181  0 u32   rw*          -                 - Amplifier latched events
2182  0 u32   rw*          -                 - Latching fault mask
2183  0 u32   rw*          -                 - Latching faults
2184  0 u32   rw*          -                 - Event mask for CANopen status word drive limit bit
2190  0 u16   ro*          -                 - General purpose inputs
2191  0 u16   rw*          -                 - Input pull-up control mask
2192  0 u8    ro          16                 - Number of Entries
2192  1 u16   rw*          -                 - Input 0 configuration
2192  2 u16   rw*          -                 - Input 1 configuration
2192  3 u16   rw*          -                 - Input 2 configuration
2192  4 u16   rw*          -                 - Input 3 configuration
2192  5 u16   rw*          -                 - Input 4 configuration
2192  6 u16   rw*          -                 - Input 5 configuration
2192  7 u16   rw*          -                 - Input 6 configuration
2192  8 u16   rw*          -                 - Input 7 configuration
2192  9 u16   rw*          -                 - Input 8 configuration
2192 10 u16   rw*          -                 - Input 9 configuration
2192 11 u16   rw*          -                 - Input 10 configuration
2192 12 u16   rw*          -                 - Input 11 configuration
2192 13 u16   rw*          -                 - Input 12 configuration
2192 14 u16   rw*          -                 - Input 13 configuration
2192 15 u16   rw*          -                 - Input 14 configuration
2192 16 u16   rw*          -                 - Input 15 configuration
2193  0 u8    ro           8                 - Number of Entries
2193  1 bytes rw*          -                 - Output 0 configuration
2193  2 bytes rw*          -                 - Output 1 configuration
2193  3 bytes rw*          -                 - Output 2 configuration
2193  4 bytes rw*          -                 - Output 3 configuration
2193  5 bytes rw*          -                 - Output 4 configuration
2193  6 bytes rw*          -                 - Output 5 configuration
2193  7 bytes rw*          -                 - Output 6 configuration
2193  8 bytes rw*          -                 - Output 7 configuration
2194  0 u16   rw*          -                 - Output pin values
2195  0 u8    ro          16                 - Number of Entries
2195  1 u16   rw*          -                 - Input 0 debounce time
2195  2 u16   rw*          -                 - Input 1 debounce time
2195  3 u16   rw*          -                 - Input 2 debounce time
2195  4 u16   rw*          -                 - Input 3 debounce time
2195  5 u16   rw*          -                 - Input 4 debounce time
2195  6 u16   rw*          -                 - Input 5 debounce time
2195  7 u16   rw*          -                 - Input 6 debounce time
2195  8 u16   rw*          -                 - Input 7 debounce time
2195  9 u16   rw*          -                 - Input 8 debounce time
2195 10 u16   rw*          -                 - Input 9 debounce time
2195 11 u16   rw*          -                 - Input 10 debounce time
2195 12 u16   rw*          -                 - Input 11 debounce time
2195 13 u16   rw*          -                 - Input 12 debounce time
2195 14 u16   rw*          -                 - Input 13 debounce time
2195 15 u16   rw*          -                 - Input 14 debounce time
2195 16 u16   rw*          -                 - Input 15 debounce time
2196  0 u16   ro*          -                 - General purpose inputs without debouncing
2197  0 i16   ro*          -                 - Current state of the CAN ID selection switch
21A0  0 str   rw           -                 - Axis name string
21B0  0 i16   rw           -                 - CAN node ID configuration
21B1  0 i32   rw           -                 - Input pin mapping for CAN ID selection
21B2  0 u16   rw*          -                 - Node guarding error action
21B3  0 i16   rw           -                 - CAN bus protocol configuration
21C0  0 u16   rw*          0              0..6 Motor phasing mode
21C1  0 i16   rw*          -                 - Microstepping rate
21C2  0 i16   rw*          -                 - Max current for algorithmic phase init.
21C3  0 u16   rw*          -                 - Time for algorithmic phase init.
21C4  0 i16   rw*          -                 - Algorithmic phase init configuration
21D0  0 i16   rw*          -                 - Holding current for microstepping
21D1  0 u16   rw*          -                 - Run to hold time for microstepping
21D2  0 i16   rw*          -                 - Stepper detent scaling factor
21D5  0 u16   rw*          -                 - Hold current to voltage mode time for microstepping
21D6  0 i16   rw*          -                 - Stepper configuration
21D7  0 i16   rw*          -                 - KP gain for stepper encoder adjustment
21D8  0 i32   rw*          0      0..500000000 Max adjustment velocity for encoder outter loop
2200  0 u16   ro*          -                 - Reference A/D input
2201  0 i16   ro*          -                 - Bus voltage
2202  0 i16   ro*          -                 - Amplifier temperature A/D input
2203  0 i16   ro*          -                 - Actual current A/D reading, winding A
2204  0 i16   ro*          -                 - Actual current A/D reading, winding B
2205  0 u16   ro*          -                 - Analog encoder sine input
2206  0 u16   ro*          -                 - Analog encoder cosine input
2207  0 i16   ro*          -                 - A/D unit offset value (filtered)
2210  0 i16   rwr*         -                 - Winding A current reading offset value
2211  0 i16   rwr*         -                 - Winding B current reading offset value
2212  0 i16   ro*          -                 - X axis of calculated stator current vector
2213  0 i16   ro*          -                 - Y axis of calculated stator current vector
2214  0 i16   ro*          -                 - D axis of calculated rotor current vector
2215  0 i16   ro*          -                 - Q axis of calculated rotor current vector
2216  0 i16   ro*          -                 - D axis of commanded rotor current vector
2217  0 i16   ro*          -                 - Q axis of commanded rotor current vector
2218  0 i16   ro*          -                 - D axis of rotor commanded voltage vector
2219  0 i16   ro*          -                 - Q axis of rotor commanded voltage vector
221A  0 i16   ro*          -                 - X axis of stator output voltage vector
221B  0 i16   ro*          -                 - Y axis of stator output voltage vector
221C  0 i16   ro*          -                 - Actual motor current
221D  0 i16   ro*          -                 - Commanded current being sent to current loop
221E  0 i16   ro*          -                 - Limited version of commanded current
2220  0 i32   rw           -                 - Motor encoder wrap position
2221  0 i32   rw           -                 - Load encoder wrap position
2222  0 u32   rw           -                 - Motor encoder options
2223  0 u32   rw           -                 - Load encoder options
2230  0 i32   ro*          -                 - Limited version of commanded velocity
2231  0 i32   ro*          -                 - Load encoder velocity
2240  0 i32   rw*          -                 - Actual motor position
2241  0 i16   rw*          -                 - Buffered encoder output configuration
2242  0 i32   rw*          -                 - Position of load encoder
2250  0 i32   ro*          -                 - Velocity output from trajectory generator
2251  0 i32   ro*          -                 - Acceleration output from trajectory generator
2252  0 i16   ro*          -                 - Profile status
2253  0 i32   rw*          -                 - Software limit acceleration
2260  0 i16   rwr*         -                 - Phase Angle
2261  0 i16   ro*          -                 - Hall sensor state
2262  0 i16   rw*          -                 - Phase Angle
2263  0 i16   ro*          -                 - Motor encoder phase Angle
2300  0 u16   rw*          -                 - Desired amplifier state
2310  0 i32   rw*          -                 - Analog reference scaler
2311  0 u16   rw*          -                 - Analog reference input offset value
2312  0 u16   rw*          -                 - Analog reference calibration offset value
2313  0 u16   rw*          -                 - Analog reference deadband
2320  0 i16   rw*          -                 - PWM input configuration
2321  0 i32   rw*          -                 - PWM input scaling factor
2322  0 u16   rw*          -                 - PWM Input frequency
2323  0 i32   rw           -                 - Registration offset for step and direction mode
2330  0 i16   rw*          -                 - Function generator configuration
2331  0 u16   rw*          -                 - Function generator frequency
2332  0 i32   rw*          -                 - Function generator amplitude
2333  0 u16   rw*          -                 - Function generator duty cycle
2340  0 i16   rw*          -                 - Programmed current command used in amplifier state 1
2341  0 i32   rw*          -                 - Programmed velocity for mode 11
2350  0 i16   rw*          -                 - Homing current
2351  0 u16   rw*          -                 - Delay for hard stop homing mode
2352  0 i16   rw*          -                 - Homing configuration
2353  0 i32   ro*          -                 - Last home position adjustment
2360  0 i16   rw*          -                 - Camming mode configuration
2361  0 i16   rw*          -                 - Camming mode delay in forward direction
2362  0 i16   rw*          -                 - Camming mode delay in reverse direction
2363  0 i32   rw*          -                 - Camming mode virtual master velocity
2370  0 u32   rw*          -                 - Gain scheduling configuration
2371  0 str   rw*          -                 - Gain schedulong key parameter
2400  0 i16   rw*          -                 - Position capture control register
2401  0 i16   ro*          -                 - Position capture status register
2402  0 i32   ro*          -                 - Captured index position
2403  0 i32   ro*          -                 - Captured home position
2404  0 i32   rw*          -                 - Time (microseconds) of last high speed capture
2405  0 i32   ro*          -                 - Position of last high speed capture
2420  0 i32   rw*          -                 - Misclaneous amplifiers options
2421  0 str   rw           -                 - Reserved for CME2 software use
2422  0 u32   ro           -                 - Extended firmware version information
2500  0 u8    ro           -                 - Number of trace channels
2500  1 u16   rw           -                 - Trace channel 1 configuration
2500  2 u16   rw           -                 - Trace channel 2 configuration
2500  3 u16   rw           -                 - Trace channel 3 configuration
2500  4 u16   rw           -                 - Trace channel 4 configuration
2500  5 u16   rw           -                 - Trace channel 5 configuration
2500  6 u16   rw           -                 - Trace channel 6 configuration
2501  0 u16   ro*          -                 - Trace system status
2502  0 u32   ro           -                 - Trace reference period
2503  0 u16   ro*          -                 - Trace sample count
2504  0 u16   ro           -                 - Trace system maximum samples
2505  0 u16   rw           -                 - Trace period
2506  0 bytes rw           -                 - Trace trigger configuration
2507  0 i16   rw           -                 - Trace trigger delay
2508  0 u16   rw*          -                 - Trace start/stop control
2509  0 bytes ro           -                 - Trace data
250A  0 u16   rw*          -                 - Trace memory reserve size
250B  0 u16   rw*          -                 - Trace memory address
250C  0 bytes rw*          -                 - Trace memory access
2600  0 u8    ro           -                 - Number of indexer registers
2600  1 u32   rw*          -                 - Indexer register 0
2600  2 u32   rw*          -                 - Indexer register 1
2600  3 u32   rw*          -                 - Indexer register 2
2600  4 u32   rw*          -                 - Indexer register 3
2600  5 u32   rw*          -                 - Indexer register 4
2600  6 u32   rw*          -                 - Indexer register 5
2600  7 u32   rw*          -                 - Indexer register 6
2600  8 u32   rw*          -                 - Indexer register 7
2600  9 u32   rw*          -                 - Indexer register 8
2600 10 u32   rw*          -                 - Indexer register 9
2600 11 u32   rw*          -                 - Indexer register 10
2600 12 u32   rw*          -                 - Indexer register 11
2600 13 u32   rw*          -                 - Indexer register 12
2600 14 u32   rw*          -                 - Indexer register 13
2600 15 u32   rw*          -                 - Indexer register 14
2600 16 u32   rw*          -                 - Indexer register 15
2600 17 u32   rw*          -                 - Indexer register 16
2600 18 u32   rw*          -                 - Indexer register 17
2600 19 u32   rw*          -                 - Indexer register 18
2600 20 u32   rw*          -                 - Indexer register 19
2600 21 u32   rw*          -                 - Indexer register 20
2600 22 u32   rw*          -                 - Indexer register 21
2600 23 u32   rw*          -                 - Indexer register 22
2600 24 u32   rw*          -                 - Indexer register 23
2600 25 u32   rw*          -                 - Indexer register 24
2600 26 u32   rw*          -                 - Indexer register 25
2600 27 u32   rw*          -                 - Indexer register 26
2600 28 u32   rw*          -                 - Indexer register 27
2600 29 u32   rw*          -                 - Indexer register 28
2600 30 u32   rw*          -                 - Indexer register 29
2600 31 u32   rw*          -                 - Indexer register 30
2600 32 u32   rw*          -                 - Indexer register 31
6040  0 u16   rw*          -                 - Control word
6041  0 u16   ro*          -                 - Status word
605A  0 i16   rw*          -                 - Quick stop option code
605B  0 i16   rw*          -                 - Shutdown option code
605C  0 i16   rw*          -                 - Disable option code
605D  0 i16   rw*          -                 - Halt option code
6060  0 i8    rw*          -                 - Modes of operation
6061  0 i8    ro*          -                 - Modes of operation display
6062  0 i32   ro*          -                 - Commanded position
6063  0 i32   rw*          -                 - Actual motor position
6064  0 i32   rw*          -                 - Actual motor position
6065  0 i32   rw*          -                 - Tracking warning distance
6067  0 i32   rw*          -                 - Tracking window distance
6068  0 u16   rw*          -                 - Tracking window time
6069  0 i32   ro*          -                 - Actual motor velocity
606A  0 u16   rw*          -                 - Velocity sensor selection
606B  0 i32   ro*          -                 - Commanded velocity
606C  0 i32   ro*          -                 - Actual motor velocity
606D  0 u16   rw*          -                 - Velocity window (16-bit version)
606E  0 u16   rw*          -                 - Velocity window time
6071  0 i16   rw*          -                 - Target Torque
6074  0 i16   ro*          -                 - Torque demand value
6076  0 u32   rw           -                 - Motor rated torque
6077  0 i16   ro*          -                 - Torque actual value
607A  0 i32   rw*          -                 - Profile target position
607C  0 i32   rw*          -                 - Homing offset
607D  0 u8    ro           2                 - Number of Entries
607D  1 i32   rw*          -                 - Negative software limit position
607D  2 i32   rw*          -                 - Positive software limit position
6081  0 i32   rw*          0      0..500000000 Profile target velocity
6083  0 i32   rw*          -                 - Profile acceleration
6084  0 i32   rw*          -                 - Profile deceleration
6085  0 i32   rw*          -                 - Profile abort acceleration
6086  0 i16   rw*          -                 - Motion profile type
6087  0 u32   rw*          -                 - Torque slope
6088  0 i16   rw*          -                 - Torque profile type
6098  0 i8    rw*          -                 - Homing method
6099  0 u8    ro           2                 - Number of Entries
6099  1 i32   rw*          0      0..500000000 Homing velocity (fast)
6099  2 i32   rw*          0      0..500000000 Homing velocity (slow)
609A  0 i32   rw*          -                 - Homing acceleration
60B0  0 i32   rw*          -                 - Position offset
60B1  0 i32   rw*          -                 - Velocity offset
60B2  0 i16   rw*          -                 - Torque offset
60C0  0 i16   rw*          -                 - Interpolation submode select
60C1  0 u8    ro           3                 - Number of Entries
60C1  1 i32   rw*          0                 - Interpolated position value
60C1  2 u8    rw           0                 - Interpolated time value
60C1  3 i32   rw           0                 - Interpolated velocity value
60C2  0 u8    ro           2                 - Number of Entries
60C2  1 u8    rw           -                 - Interpolation time value
60C2  2 u8    ro           -                 - Interpolation time units
60F4  0 i32   ro*          -                 - Position loop error.
60F6  0 u8    ro           3                 - Number of Entries
60F6  1 i16   rw*          -                 - Proportional gain for current loop
60F6  2 i16   rw*          -                 - Integral gain for current loop
60F6  3 i16   rw*          -                 - Current offset value
60F8  0 i32   rw*          -                 - Tracking warning distance
60F9  0 u8    ro           4                 - Number of Entries
60F9  1 i16   rw*          -                 - Proportional gain for velocity loop
60F9  2 i16   rw*          -                 - Integral gain for velocity loop
60F9  3 i16   rw*          -                 - Velocity loop acceleration feed forward
60F9  4 i16   rw*          0            -2..10 Shift value for velocity loop gain
60FA  0 i32   ro*          -                 - Commanded velocity
60FB  0 u8    ro           4                 - Number of Entries
60FB  1 i16   rw*          -                 - Proportional gain for position loop
60FB  2 i16   rw*          -                 - Velocity feed forward for position loop
60FB  3 i16   rw*          -                 - Acceleration feed forward for position loop
60FB  4 u16   rw*        100          1..25000 Position loop scaling factor
60FC  0 i32   ro*          -                 - Commanded position
60FD  0 u32   ro*          -                 - Digital input line status
60FF  0 i32   rw*          -                 - Target velocity
6403  0 str   rw           -                 - Motor model number
6404  0 str   rw           -                 - Motor manufacturer
6410  0 u8    ro          34                 - Number of Entries
6410  1 u16   rw           -                 - Motor type
6410  2 i16   rw           -                 - Motor pole pairs
6410  3 u16   rw           -                 - Motor wiring reversed
6410  4 i16   rw           -                 - Motor hall type
6410  5 i16   rw           -                 - Motor hall wiring
6410  6 i16   rw           0         -180..180 Motor hall offset
6410  7 u16   rw           -                 - Motor resistance
6410  8 u16   rw           -                 - Motor inductance
6410  9 i32   rw           -                 - Motor intertia
6410 10 u32   rw           -                 - Motor back EMF constant
6410 11 i32   rw           0      0..500000000 Motor max velocity
6410 12 u32   rw           -                 - Motor torque constant
6410 13 i32   rw           -                 - Motor peak torque
6410 14 i32   rw           -                 - Motor continuous torque
6410 15 u16   rw           -                 - Motor has temp sensor
6410 16 u16   rw           -                 - Motor has brake
6410 17 u16   rw           -                 - Delay from error to brake active
6410 18 u16   rw           -                 - Delay from brake to PWM disable
6410 19 i32   rw           0      0..500000000 Velocity where brake may be activated without delay
6410 20 u16   rw           0              0..7 Motor encoder type
6410 21 i16   rw           -                 - Encoder units
6410 22 u16   rw           -                 - Encoder direction
6410 23 u32   rw           -                 - Encoder counts per rev
6410 24 i16   rw           -                 - Encoder resolution
6410 25 i32   rw           -                 - Encoder electrical distance (linear only)
6410 26 i32   rw           -                 - Encoder index pulse distance
6410 27 i16   rw           -                 - Motor Units
6410 28 i16   rw           0             0..10 Shift amount for analog encoder
6410 29 u32   rw           -                 - Microstepping resolution
6410 30 u16   rw           0              0..5 Load encoder type
6410 31 i16   rw           -                 - Load encoder direction
6410 32 i32   rw           1     1..2147483647 Load encoder resolution
6410 33 i32   rw           -                 - Motor gear ratio
6410 34 i16   rw           1              1..8 Resolver cycles / rev
6502  0 u32   ro        1005                 - Supported drive modes
6503  0 str   ro           -                 - Amplifier model number
6504  0 str   ro           -                 - Drive manufacturer
6505  0 str   ro           -                 - Drive manufacturer web address
6510  0 u8    ro          29                 - Number of Entries
6510  1 u32   ro           -                 - Serial number
6510  2 str   ro           -                 - Amplifier manufacturing info
6510  3 i16   ro           -                 - Amplifier peak current limit
6510  4 i16   ro           -                 - Amplifier continuous current limit
6510  5 u16   ro           -                 - Amplifer time at peak current
6510  6 i16   ro           -                 - Amplifier maximum voltage
6510  7 i16   ro           -                 - Amplifier minimum voltage
6510  8 i16   ro           -                 - Amplifier over voltage hysteresis
6510  9 i16   ro           -                 - Amplifier maximum temperature
6510 10 i16   ro           -                 - Amplifier temperature hysteresis
6510 11 u16   ro           -                 - Amplifier PWM period
6510 12 u16   ro           -                 - Amplifier Servo period
6510 13 i16   ro           -                 - Amplifier hardware type
6510 14 i16   ro           -                 - Amplifier current scaler
6510 15 i16   ro           -                 - Amplifier voltage scaler
6510 16 u16   ro           -                 - Analog reference scaling factor
6510 17 u16   ro           -                 - minimum PWM off time
6510 18 u16   ro           -                 - PWM Deadtime at continuous limit
6510 19 u16   ro           -                 - PWM Deadtime at zero current
6510 20 i16   ro           -                 - Regen transister peak current
6510 21 i16   ro           -                 - Regen transister continuous current
6510 22 u16   ro           -                 - Regen transister time at peak current
6510 23 u16   ro           -                 - Amplifier analog encoder scaling factor
6510 24 i16   ro           -                 - Firmware version number
6510 25 i16   ro           -                 - Max axes supported by amplifier
6510 26 i16   ro           -                 - Amp regen transistor current limit
6510 27 i16   ro           -                 - FPGA image version number
6510 28 u32   ro           -                 - NIOS processor firmware version
6510 29 u32   ro           -                 - Misc hardware options
67FF  0 u32   ro      459154                 - Device Type
"""
