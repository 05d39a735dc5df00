"""Inverses of models from their present memory: angle to command."""
