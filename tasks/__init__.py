"""The tasks of the package, one function a file: files or objects in, result out, the same for Python and command line.

Options have one meaning in all of them: `layout` is that of the logs, `out` what is written, `force` replaces an older
file of the same kind, `report` and `figures` are the page and its figures, `progress` is called as the work goes on,
and `say` with every note and warning, one line each. A refusal names the option as the command line spells it.
"""
