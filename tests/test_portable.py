"""It runs where it was not written: nothing that only POSIX has, and no text in whatever encoding a machine prefers."""

import ast
from pathlib import Path

import pytest

import mufly

_PACKAGE = Path(mufly.__file__).parent
_MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "termios", "tty"}
_NAMES = {
    "os": {"fork", "forkpty", "getuid", "geteuid", "killpg", "mkfifo", "nice", "setsid", "uname"},
    "signal": {"SIGALRM", "SIGHUP", "SIGKILL", "SIGQUIT", "SIGUSR1", "SIGUSR2", "alarm", "pause", "setitimer"},
    "socket": {"AF_UNIX", "SO_REUSEPORT"},
}  # fmt: skip
_PLACES = ("/tmp", "/dev/shm", "/proc")
_AS_TEXT = {"read_text": 0, "write_text": 1}


def trees() -> list[tuple[Path, ast.Module]]:
    return [(p, ast.parse(p.read_text(encoding="utf-8"))) for p in sorted(_PACKAGE.rglob("*.py"))]


@pytest.fixture(scope="module")
def sources() -> list[tuple[Path, ast.Module]]:
    return trees()


def done_without(tree: ast.AST) -> set[ast.AST]:
    """Imports that may fail: ``except ImportError`` says what is done without them."""
    tries = (node for node in ast.walk(tree) if isinstance(node, ast.Try))
    return {
        line
        for node in tries
        if any(isinstance(h.type, ast.Name) and h.type.id == "ImportError" for h in node.handlers)
        for line in node.body
    }


def only_posix(tree: ast.AST) -> list[str]:
    found = []
    spared = done_without(tree)
    for node in ast.walk(tree):
        if node in spared:
            continue
        if isinstance(node, ast.Import):
            found += [a.name for a in node.names if a.name.split(".")[0] in _MODULES]
        elif isinstance(node, ast.ImportFrom) and node.module in _MODULES:
            found.append(node.module)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.attr in _NAMES.get(node.value.id, ()):
                found.append(f"{node.value.id}.{node.attr}")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith(_PLACES):
            found.append(node.value)
    return found


def without_encoding(tree: ast.AST) -> list[int]:
    """Lines that read or write text without saying in which encoding."""
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or any(k.arg in ("encoding", None) for k in node.keywords):
            continue
        f = node.func
        if isinstance(f, ast.Attribute) and f.attr in _AS_TEXT and len(node.args) <= _AS_TEXT[f.attr]:
            found.append(node.lineno)
        opens = isinstance(f, ast.Name) and f.id == "open"
        opens = opens or (
            isinstance(f, ast.Attribute) and f.attr == "open" and isinstance(f.value, ast.Name | ast.Attribute)
        )
        if opens:
            modes = [a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
            modes += [k.value.value for k in node.keywords if k.arg == "mode" and isinstance(k.value, ast.Constant)]
            texts = [m for m in modes if set(m) <= set("rwax+t") and len(m) <= 3]
            if texts and not any("b" in m for m in modes):
                found.append(node.lineno)
    return found


def test_nothing_is_called_that_only_posix_has(sources):
    assert {str(p.relative_to(_PACKAGE)): found for p, t in sources if (found := only_posix(t))} == {}


def test_text_is_read_and_written_in_a_stated_encoding(sources):
    assert {str(p.relative_to(_PACKAGE)): found for p, t in sources if (found := without_encoding(t))} == {}


def test_both_would_be_seen():
    assert set(only_posix(ast.parse("import fcntl, os\nos.fork()\nopen('/tmp/x')"))) == {
        "fcntl",
        "os.fork",
        "/tmp/x",
    }
    assert without_encoding(ast.parse("p.read_text()\nopen(p, 'w')\np.open('rb')\np.write_text(s)")) == [
        1,
        2,
        4,
    ]
    assert without_encoding(ast.parse("p.read_text(encoding='utf-8')\nopen(p, 'r', encoding='ascii')")) == []
