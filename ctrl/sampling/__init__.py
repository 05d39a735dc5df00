"""The sampling controller: smooth noise, and path integral control with it."""
