"""Training: the loop, its settings, and all that a run writes."""
