"""Logs of the diagnosis: checks, motions, noise floor, sensor, choice of trials, identifiability of effects."""
