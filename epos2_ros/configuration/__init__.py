"""What the driver is told: parameters, their files, and the values they make."""
