"""Identification: which chain of operators explains the trials, and with which numbers."""
