"""The equilibrium: which directions, loads and targets it meets, and what follows from it."""
