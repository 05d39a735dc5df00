"""The next motion of a diagnosis: open hypotheses, the menu of safe motions, and the choice among them."""
