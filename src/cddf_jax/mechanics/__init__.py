"""The laws of a cross-section, and one solution along the body for given tensions and loads."""
