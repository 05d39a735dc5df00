"""Tuning of controller settings by search over a set of plants with drawn effects.

`settings.TuneSettings` defines search and plants, `objective` is the cost, `optuna_` runs one trial, and
`run.run_tuning` the whole search with a check on held-out plants. `gains` searches PID gains on one plant.
"""
