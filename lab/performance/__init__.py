"""Same-run comparison of the controllers with public peers and with the matrix-product limit of the machine.

Every claim is a ratio of two medians that were measured alternately; absolute times only give the scale. The sections
are in `kernels`, `controllers` and `growth`; `run` executes them.
"""
