"""Effects: what a real device does beyond a simulator, each an operator that can be put on either side of a chain."""
