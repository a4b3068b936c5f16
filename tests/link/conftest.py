"""Makes the helpers of this folder importable: ``link_channel`` and ``link_rig``."""

import importlib.util
import sys
from pathlib import Path

for _name in ("channel", "rig"):
    _full = f"link_{_name}"
    if _full not in sys.modules:
        _spec = importlib.util.spec_from_file_location(_full, Path(__file__).with_name(f"{_name}.py"))
        _module = importlib.util.module_from_spec(_spec)
        sys.modules[_full] = _module
        _spec.loader.exec_module(_module)
