"""Identification of models from recorded trials."""
