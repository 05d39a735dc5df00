"""The closed experiment: record what tells most about a simulator's gap, diagnose, and ask the next question itself."""
