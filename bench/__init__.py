"""Work at a device, stage by stage: from a device to a verified controller, from a gap of a simulator to its cause."""
