"""ROS 2 driver for synchronised motion with CANopen servo drives."""
