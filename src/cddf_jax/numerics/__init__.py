"""Numerics without mechanics: arrays, implicit derivatives, the fixed-point iteration, quadrature on panels."""
