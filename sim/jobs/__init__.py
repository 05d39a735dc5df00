"""Many calls of one function, in this process, in a pool of processes or on a Dask cluster.

`backend.Backend` is what all of them are; a worker that dies is replaced and its call made again.
"""
