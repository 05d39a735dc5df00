"""The kinds of model that can be identified: one file each, and one list that the command line and the tests read."""
