"""A device that bends in two planes, of a physics that no operator has, and the study of controllers on it."""
