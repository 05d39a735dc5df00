"""Diagnosis of a device of two axes: what joins them anew, then each axis as a device of its own."""
