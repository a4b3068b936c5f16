"""Change one operator, number or branch of the flight software at a time, and run the tests that should notice.

    nice -n 10 python benchmarks/mutate_flight_software.py --places 60 --keep mutants.jsonl
    nice -n 10 python benchmarks/mutate_flight_software.py --places 20 --only onboard/link

The seed draws places from the C and Python sources of the groups below; each mutant is a copy of the sources with one
change, against which the tests of its group run until the first failure. The answers: noticed, missed, or no build
(the compiler refuses it: noticed too). A missed one is read by a person: it is equivalent, or a test is missing.
Resumes with --keep.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src/mufly"
TIMEOUT_S = 900.0
_SAFETY, _MISSION = "test_board_safety.py", "test_mission_c.py"
# Folder or file pattern under src/mufly, and the tests that answer for it.
GROUPS = {
    "firmware/sources/onboard/drivers/**/*.c": ["test_drivers.py", "test_sd_card.py"],
    "firmware/sources/onboard/receiver/*.c": ["test_rc.py", "-k", "not emulated"],
    "firmware/sources/onboard/storage/*.c": ["test_storage.py", "test_settings.py", _SAFETY, "-k", "not supervisor"],
    "firmware/sources/onboard/log/*.c": ["test_flight_log.py"],
    "firmware/sources/onboard/link/**/*.c": ["test_board_link.py", "test_board_bytes.py", "-k", "not emulated"],
    "firmware/sources/onboard/supervisor/*.c": [_SAFETY],
    "firmware/sources/boards/stm32/*.c": ["test_stm32.py", "test_i2c.py", "-k", "not image"],
    "firmware/sources/boards/board.c": [
        "test_emulated.py",
        _SAFETY,
        "test_rc.py",
        "-k",
        "loop or memories or reset or kept or lost or arm_switch",
    ],
    "firmware/sources/mission/machine/*phases.c": [_MISSION],
    "firmware/sources/mission/machine/mission*.c": [_MISSION],
    "firmware/sources/estimate/estimator.c": [_MISSION],
    "firmware/sources/flight/[efo]*.c": [_MISSION],
    "firmware/sources/control/cascade.c": ["test_firmware.py"],
    "firmware/sources/flight/controllers.c": ["test_firmware.py"],
    "mission/machine/*.py": [_MISSION],
    "flight/flight_software.py": [_MISSION],
}
CHANGES = [
    (r"(?<![<>=\-!])<(?![<=])", "<="), (r"(?<![<>=\-])>(?![>=])", ">="), (r"<=", "<"), (r">=", ">"),
    (r"==", "!="), (r"!=", "=="), (r"&&", "||"), (r"\|\|", "&&"), (r" and ", " or "), (r" or ", " and "),
    (r"(?<=[\w)\]]) \+ (?=[\w(])", " - "), (r"(?<=[\w)\]]) - (?=[\w(])", " + "), (r"(?<=[\w)\]]) \* (?=[\w(])", " / "),
    (r"\btrue\b", "false"), (r"\bfalse\b", "true"), (r"\bTrue\b", "False"), (r"\bFalse\b", "True"),
    (r"(?<![\w.])[1-9]\d*U?(?![\w.])", "{0} + 1"), (r"REAL\((\d+\.\d+)\)", "REAL(1.25) * {0}"),
    (r"\bif \((?=\w)", "if (!"), (r"\bif (?=\w+:)", "if not "),
]  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One change: file under src/mufly, offset, the text there, and its replacement."""

    file: str
    at: int
    before: str
    after: str


def read_code(text: str, is_c: bool) -> str:
    """Return the text with comments, strings and lines of the preprocessor blanked, at the same offsets."""
    patterns = [r"/\*.*?\*/", r'"(?:\\.|[^"\\])*"', r"^#[^\n]*"] if is_c else [r'""".*?"""', r"#[^\n]*", r'"[^"\n]*"']
    code = text
    for pattern in patterns:
        code = re.sub(pattern, lambda m: re.sub(r"[^\n]", " ", m[0]), code, flags=re.DOTALL | re.MULTILINE)
    return code


def find_mutants(pattern: str) -> Iterator[Mutant]:
    """Return all changes of the files of a group."""
    for path in sorted(PACKAGE.glob(pattern)):
        text = path.read_text(encoding="utf-8")
        code = read_code(text, path.suffix == ".c")
        if path.suffix == ".py":
            code = re.sub(r"^(from|import) [^\n]*", lambda m: " " * len(m[0]), code, flags=re.MULTILINE)
        for change, into in CHANGES:
            for m in re.finditer(change, code):
                yield Mutant(str(path.relative_to(PACKAGE)), m.start(), m[0], into.format(m[0]))


def judge_mutant(mutant: Mutant, tests: list[str], folder: Path) -> str:
    """Run the tests against a copy of the sources with the change; return the answer."""
    path = folder / "src/mufly" / mutant.file
    text = path.read_text(encoding="utf-8")
    assert text[mutant.at : mutant.at + len(mutant.before)] == mutant.before
    path.write_text(text[: mutant.at] + mutant.after + text[mutant.at + len(mutant.before) :], encoding="utf-8")
    files = [str(ROOT / "tests/firmware" / t) if t.endswith(".py") else t for t in tests]
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", *files]
    environment = {**os.environ, "PYTHONPATH": str(folder / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return "noticed (time limit)"
    finally:
        path.write_text(text, encoding="utf-8")
    if done.returncode == 0:
        return "missed"
    failed = re.search(r"(?:FAILED|ERROR) \S+::(\S+)", done.stdout)
    return f"noticed ({failed[1] if failed else done.stdout.strip()[-80:]})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--places", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="groups with this in their pattern")
    parser.add_argument("--keep", type=Path, help="file of answers (JSON lines)")
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    groups = {p: list(find_mutants(p)) for p in GROUPS if given.only in p}
    drawn = []
    for n in range(given.places):  # each group in turn
        pattern = list(groups)[n % len(groups)]
        drawn.append((pattern, groups[pattern][int(rng.integers(len(groups[pattern])))]))
    answers = {}
    if given.keep and given.keep.exists():
        answers = {d["place"]: d["answer"] for d in map(json.loads, given.keep.read_text().splitlines())}
    with tempfile.TemporaryDirectory(prefix="mufly-mutants-") as temporary:
        folder = Path(temporary)
        shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
        for pattern, m in drawn:
            text = (PACKAGE / m.file).read_text(encoding="utf-8")
            line = text.count("\n", 0, m.at) + 1
            place = f"{m.file}:{line}: {text.splitlines()[line - 1].strip()[:90]}  [{m.before.strip()} -> {m.after}]"
            if place not in answers:
                answers[place] = judge_mutant(m, GROUPS[pattern], folder)
                if given.keep:
                    with given.keep.open("a") as kept:
                        kept.write(json.dumps({"place": place, "answer": answers[place]}) + "\n")
            print(f"{answers[place]}: {place}", flush=True)
    count = Counter(a.split(" ")[0] for a in answers.values())
    print(", ".join(f"{n} {what}" for what, n in count.items()))


if __name__ == "__main__":
    main()
