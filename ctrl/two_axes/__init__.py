"""Controllers of devices that bend in two planes: one controller for each axis, one program where limits join them."""
