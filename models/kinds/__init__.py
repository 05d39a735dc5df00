"""Kinds of model that can be identified."""
