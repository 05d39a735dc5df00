"""The next motion: hypotheses that are open, the menu of safe motions, and the choice among them."""
