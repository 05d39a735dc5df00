"""Public benchmarks: the data of others, their test, their figures beside ours."""
