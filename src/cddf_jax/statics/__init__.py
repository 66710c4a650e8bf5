"""The equilibrium of a manipulator for given tensions, loads and targets, and what follows from it."""
