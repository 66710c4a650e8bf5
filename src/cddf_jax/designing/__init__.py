"""Bodies shaped by gradient: objectives, limits, load cases, the constrained search, and its results."""
