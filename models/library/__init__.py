"""Small identified models that ship with the package (`builtin:NAME`); none of them has seen real data."""
