"""Parts of a run: ramps, rests, checks, excitations, tracking, the safe stop."""
