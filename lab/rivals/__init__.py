"""The papers' rivals: models and identification methods that only a study uses, as plug-ins of hystmpc."""
