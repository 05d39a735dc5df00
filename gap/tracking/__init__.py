"""The tracking gap: how far the closed-loop error falls with the corrected simulator, expected and measured."""
