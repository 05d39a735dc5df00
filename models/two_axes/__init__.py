"""Devices that bend in two planes: two models of one axis, and the matrices that join them."""
