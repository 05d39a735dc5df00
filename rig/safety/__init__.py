"""Safety of a device: command gate, checks of measurements, watches of motion, stop and latch."""
