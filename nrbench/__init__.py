"""nrbench: a benchmark for near-regular texture synthesis."""

import lazy_loader

from nrbench.names import keep_public

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
keep_public(__name__)
