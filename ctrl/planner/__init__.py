"""What `TipController` is made of: its settings, references that can be changed in motion, reach, and assembly."""
