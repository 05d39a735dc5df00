"""Competing models and identification methods of the papers, used only by studies, as plug-ins of hystmpc."""
