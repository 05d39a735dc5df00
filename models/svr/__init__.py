"""Support-vector regression on the last commands: weights, reference step and step graph."""
