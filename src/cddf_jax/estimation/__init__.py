"""Least squares for any model: estimates, intervals, and what the data determine. It knows no manipulator."""
