"""Live views of a run: the terminal view and the local page."""
