"""Study `auto`: whether `fit auto` is as good as the best single kind, and one answer for one set of logs."""
