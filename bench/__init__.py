"""Work at a device in stages: from a device to a verified controller, from a simulator's gap to its cause."""
