"""What a model leaves over, learned while the loop runs."""
