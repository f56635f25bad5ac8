"""The programs for the first hour with a real machine.

`scan` says who is on a bus and changes nothing. What it asks and hears is `survey` and `uploads`
(no I/O), what the answers mean `makers`, what is odd about them `oddities`; `wire` carries it out
on a CAN interface, `report` and `parameter_file` write it down.
"""
