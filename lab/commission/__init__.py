"""Commissioning study: random devices are commissioned, then controlled unchanged and after a change."""
