"""Safety of a device: command gate, checks of measurements, motion monitors, stop and latch."""
