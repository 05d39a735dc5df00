"""A simulated device in a process of its own, with injectable faults of the wire."""
