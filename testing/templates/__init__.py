"""Folders to begin with, each of a kind of class that a lab brings."""
