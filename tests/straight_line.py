"""Thirty readings of a straight line, where everything of a fit has a closed form; one model, compiled once for all."""

import jax.numpy as jnp
import numpy as np

X = np.linspace(0.0, 3.0, 30)
SIGMA = 0.05
NOISY = 2.0 + 0.5 * X + SIGMA * np.random.default_rng(1).normal(size=X.size)
DESIGN = np.stack([np.ones_like(X), X], axis=1)
COVARIANCE = np.linalg.inv(DESIGN.T @ DESIGN)  # over sigma^2
A_HAT, B_HAT = np.linalg.lstsq(DESIGN, NOISY, rcond=None)[0]
RSS = np.sum((NOISY - DESIGN @ [A_HAT, B_HAT]) ** 2)
START = {"a": 1.0, "b": 1.0}


def line(p):
    return p["a"] + p["b"] * X


def line_beside(p):
    """A line, and a parameter c without effect."""
    return line(p) + 0 * p["c"]


def decay(p):
    return p["height"] * jnp.exp(-p["rate"] * X) + p["floor"]


def without_a_number(p):
    return jnp.log(-(p["a"] ** 2)) * X


def posterior_with(mean, deviation):
    """Estimate and covariance of the line with a Gaussian prior on its slope: the conjugate posterior."""
    precision = DESIGN.T @ DESIGN / SIGMA**2 + np.diag([0.0, 1 / deviation**2])
    estimate = np.linalg.solve(precision, DESIGN.T @ NOISY / SIGMA**2 + [0.0, mean / deviation**2])
    return estimate, np.linalg.inv(precision)
