"""What a person beside the bench looks at while a run goes on: a terminal view and a local page."""
