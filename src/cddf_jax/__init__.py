"""Curvature-dependent distributed friction in tendon-driven continuum manipulators (Liu et al., IROS 2020).

The public names stand in `__init__.pyi`. They are loaded on first use, so that importing the package starts nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__version__ = "0.1.0"
