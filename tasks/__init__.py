"""Tasks of the package: functions from files or objects to a result, for Python and the command line alike.

Options have one meaning in all of them: `layout` is that of the logs, `out` what is written, `force` replaces an older
file of the same kind, `report` and `figures` are the page and its figures, `progress` is called as the work goes on,
and `say` with every note and warning, one line each. A refusal names the option as the command line spells it.
"""
