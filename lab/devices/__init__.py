"""Family of random devices (capstan, Dahl, rod, muscle) for the blind check, `identify` and `commission`."""
