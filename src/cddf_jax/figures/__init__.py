"""Every drawing function, in one style: `from cddf_jax import figures`.

Functions named `draw_` take and return Matplotlib axes, so that they can be combined: `draw_shape(robot, equilibrium,
axes=axes)` draws into axes of yours, in your style, and `draw_shape(robot, equilibrium)` makes a figure as wide as a
column of a page, in the house style, which `axes.figure.savefig("shape.pdf")` writes. Functions named `_figure` make a
whole figure with its legends. Every axis says its unit: mm, N, deg, MPa, 1/m and per cent, what engineers write. No
display is needed, and neither pyplot nor any global setting of Matplotlib is touched.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
