"""TODO: rig/commission."""
