"""The planner's side: `TipController`, its settings, references, reach and memory."""
