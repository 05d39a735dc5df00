"""Simulated devices by name: the tendon catheter of S2, and those that installed packages add.

They are not made of the operators that are identified on them (`models.operators`).
"""
