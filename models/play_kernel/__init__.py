"""The play-kernel model: parallel plays and a monotone additive regression on them."""
