"""nrbench: a benchmark for near-regular texture synthesis."""

import lazy_loader

from nrbench.source_tree import add_plugin_folders

add_plugin_folders(__path__)
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
