"""The commissioning study: devices drawn at random, commissioned, and controlled where something has changed."""
