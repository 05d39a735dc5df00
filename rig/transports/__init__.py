"""Transports between control loop and device, behind one protocol."""
