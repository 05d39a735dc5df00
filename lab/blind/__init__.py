"""Blind check of the diagnosis: sealed cases, their diagnosis, their score."""
