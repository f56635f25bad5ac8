"""The programs for the first hour with a real machine.

`scan` says who is on a bus and changes nothing. What it asks and hears is `survey` and `uploads`
(no I/O), what the answers mean `makers`, what is odd about them `oddities`; `wire` carries it out
on a CAN interface, `report` and `parameter_file` write it down.

`check` is the first motion of a joint: `first_motion` has the steps, `dialogue` the questions; the
motion itself is the driver's.

`drive` writes down what a drive stores and sets another to it: `stored` says what that is,
`parameter_access` reads and writes it, `drive_file` is the file.
"""
