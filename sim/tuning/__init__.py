"""Controller settings by search over a set of plants with drawn effects.

`settings.TuneSettings` says what is searched on which plants, `objective` what is good, `optuna_` does one trial of the
search, `run.run_tuning` the whole with a check on plants that the search has not seen.
"""
