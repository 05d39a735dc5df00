"""Closed-loop studies over grids and draws: every run a row of one table.

`settings.SweepSettings` says what is varied, `plan` turns it into rows and does one of them, `table` keeps the
rows, `run.run_sweep` does the whole and `run.reproduce` repeats one row.
"""
