"""Public benchmarks: external data, their tests, and published results for comparison."""
