"""Command line of the package: its verbs call the functions of `tasks` and print the results."""
