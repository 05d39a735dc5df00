"""What the loop talks to in a lab: transports, the loop itself, preparation, safe stop, recordings."""
