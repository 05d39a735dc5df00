"""Small identified models in the package (`builtin:NAME`); none of them was identified from real data."""
