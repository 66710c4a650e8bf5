"""Friction and modulus from measurements: the bench as a model, its fit, the verdict, the next experiment."""
