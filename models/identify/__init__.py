"""The identification engine: candidates, cross-validation, selection, least squares and the other methods."""
