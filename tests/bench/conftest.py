"""Makes the emulated devices of this folder importable as ``bench_emulators``, where there are pseudo-terminals."""

import importlib.util
import os
import sys
from pathlib import Path

if os.name == "posix" and "bench_emulators" not in sys.modules:
    _spec = importlib.util.spec_from_file_location("bench_emulators", Path(__file__).with_name("emulators.py"))
    _module = importlib.util.module_from_spec(_spec)
    sys.modules["bench_emulators"] = _module
    _spec.loader.exec_module(_module)
