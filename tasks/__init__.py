"""Tasks of the package: functions from files or objects to a result, for Python and the command line alike.

Options have one meaning in all of them: `layout` of the logs, `out` for output, `force` to replace an older file of the
same kind, `report` and `figures` for the page and its figures, `progress` and `say` as callbacks. Errors name the
option as on the command line.
"""
