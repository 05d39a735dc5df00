"""The kinds of model that can be identified, and the one list of them that the command line and the tests read."""
