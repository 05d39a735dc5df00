"""What is done in a run: its phases, experiments, recordings for identification, and the review afterwards."""
