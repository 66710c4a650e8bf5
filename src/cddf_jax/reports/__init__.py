"""Results as files: fit report, tables, data sets, the figures of the paper."""
