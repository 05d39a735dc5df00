"""Simulated devices by name: the tendon catheter of S2, and devices of installed packages.

They are not made of the operators that are identified on them (`models.operators`).
"""
