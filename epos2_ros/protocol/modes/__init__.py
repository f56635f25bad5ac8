"""What an axis does while it moves, by mode of operation (CiA 402, 0x6060)."""
