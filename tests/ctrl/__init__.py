"""Tests of the ctrl room; a package so that they can share `plays`."""
