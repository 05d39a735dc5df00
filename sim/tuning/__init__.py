"""Controller settings by search over a set of plants with drawn effects.

`settings.TuneSettings` says what is searched on which plants, `objective` is the cost, `optuna_` does one trial of the
search, `run.run_tuning` the whole with a check on held-out plants. `gains` searches PID gains on one plant.
"""
