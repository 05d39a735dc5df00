"""Models as systems of python-control, linear parts of a chain, and describing functions.

`control` is imported at the call: by nothing that a control loop needs.
"""
