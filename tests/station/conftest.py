"""Makes the mock vehicle beside these tests importable by name; tests are imported by path."""

import importlib.util
import sys
from pathlib import Path

if "mock_vehicle" not in sys.modules:
    _spec = importlib.util.spec_from_file_location("mock_vehicle", Path(__file__).with_name("mock_vehicle.py"))
    assert _spec is not None
    assert _spec.loader is not None
    _module = importlib.util.module_from_spec(_spec)
    sys.modules["mock_vehicle"] = _module
    _spec.loader.exec_module(_module)
