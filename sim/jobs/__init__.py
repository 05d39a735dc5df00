"""Resumable plans of jobs, done in this process, in a pool of processes or on a Dask cluster.

`runner` keeps what is finished, does the rest and chooses the back end; `backend.Backend` is where jobs are done: a
worker that dies is replaced and its job made again.
"""
