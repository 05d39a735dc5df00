"""Identification from trials: candidates, cross-validation, selection, least squares and other methods."""
