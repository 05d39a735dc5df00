"""Many jobs in this process, in a pool of processes or on a Dask cluster.

`runner.run_jobs` does them, `runner.backend_for` chooses where. A worker that dies is replaced, its job is done again.
"""
