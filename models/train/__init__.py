"""Training: networks in PyTorch, their settings and data, and support-vector regression by scikit-learn."""
