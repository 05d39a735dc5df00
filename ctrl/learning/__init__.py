"""Learning on top of a model while the loop runs: a basis, filters of its weights, predictor and estimator."""
