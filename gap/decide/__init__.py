"""Decision of the diagnosis: causes, their certainty, the share of the gap that they close, and the verdict."""
