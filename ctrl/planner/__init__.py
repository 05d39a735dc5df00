"""Interface for motion planners: `TipController`, its settings, references, reach and memory."""
