"""Phases of a run, experiments, recordings for identification, and the review of a run."""
