"""What the loop talks to in a lab: transports, replay, watchdog. Empty so far."""
