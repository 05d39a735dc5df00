"""Online learning of a model's error: basis functions, filters of their weights, predictor and estimator."""
