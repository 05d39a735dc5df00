"""Transports between control loop and device with a common interface."""
