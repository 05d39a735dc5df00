"""Same-run comparison of the controllers with public peers and with the matrix-product limit of the machine.

Every claim is a ratio of two medians that were taken in turns; absolute times only give the scale. One section a
file: `kernels`, `linearised`, `sampling`, `programs`; `run` goes through them.
"""
