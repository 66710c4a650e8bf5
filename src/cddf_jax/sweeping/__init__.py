"""Parameter studies: axes, samples, and labelled results of many solves."""
