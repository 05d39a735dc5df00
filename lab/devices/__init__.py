"""One family of devices drawn at random (capstan, Dahl, rod, muscle): for the blind check, `identify`, `commission`."""
