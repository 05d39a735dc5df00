"""Identification study: random devices are identified from logs, controlled, and compared with bars."""
