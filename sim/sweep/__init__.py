"""Closed-loop studies over grids and random draws, with one table row per run.

`settings.SweepSettings` defines the variation, `plan` makes and runs rows, `table` stores them, `run.run_sweep` runs
the whole sweep, and `run.reproduce` repeats one row.
"""
