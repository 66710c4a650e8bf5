"""Numerics without mechanics: arrays, elements with Gauss nodes, the fixed point with implicit derivatives."""
