"""Work at a bench: phases of a run, experiments, recordings for identification, the review after a run."""
