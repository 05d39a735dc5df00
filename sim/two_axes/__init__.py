"""Closed loops of devices that bend in two planes: settings, plant, study, report."""
