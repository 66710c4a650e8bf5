"""Tendons with a history: pulled, released and pulled again."""
