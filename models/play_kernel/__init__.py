"""The play-kernel model: a bank of plays and a monotone additive regression on them."""
