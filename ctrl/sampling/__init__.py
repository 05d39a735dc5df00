"""The sampling controller: smooth noise, and path integral control or the cross-entropy method with it."""
