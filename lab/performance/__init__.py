"""Same-run comparison of the controllers with public peers and with the matrix-product limit of the machine.

Every claim is a ratio of two medians that were taken in turns; absolute times only give the scale. Sections stand in
`kernels`, `controllers` and `growth`; `run` goes through them.
"""
